"""Draw, simulate and write the cases; seal the truths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from sim_core.effects import effect_by_name
from sim_core.errors import ConvergenceError
from sim_core.rigs import Rig, rig_to_yaml
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sysid.progress.callback import Progress
from sysid.proof.generator import bench
from sysid.proof.generator.concealed import MIN_SIGNAL, Amplitudes, draw_amplitudes
from sysid.proof.generator.noise import ColouredNoise
from sysid.proof.generator.plan import RIGS, plan_cases
from sysid.proof.generator.signal import Sight
from sysid.proof.seal import write_seal
from sysid.proof.truths.make import make_case as make_independent
from sysid.simulate import write_trace

REFINE = 2
"""The truth has twice as many cells in each direction ..."""

STEP_SHARE = 0.5
"""... and half the time step of the rig that is handed out."""

MAX_DRAWS = 20
"""Draws of amplitudes, and of whole cases that the simulator cannot follow, before giving up."""


@dataclass(frozen=True)
class _Case:
    truth: dict[str, Any]
    rig: Rig
    nominal: Rig
    poses: dict[str, dict[str, PoseTrajectory]]
    noise: dict[str, ColouredNoise]


def make_cases(
    out: Path,
    *,
    cases: int,
    seed: int,
    rigs: Sequence[str] = RIGS,
    fast: bool = False,
    on_progress: Progress | None = None,
) -> str:
    """Write ``cases`` folders into ``out`` and seal what they conceal; the returned text says what was made.

    ``rigs``: those that take turns; ``fast``: fewer and shorter recordings of rigs with an independent truth.
    """
    root = np.random.SeedSequence(seed)
    order, salt, *seeds = root.spawn(cases + 2)
    plan = plan_cases(np.random.default_rng(order), cases, rigs)
    out.mkdir(parents=True, exist_ok=True)
    truths = []
    for k, (planned, own) in enumerate(zip(plan, seeds, strict=True)):
        name = f"case_{k + 1:02d}"

        def report(share: float, k: int = k, name: str = name) -> None:
            if on_progress is not None:
                on_progress((k + share) / cases, name)

        report(0.0)
        if planned.rig == "bench":
            truths.append(make_case(out / name, planned.effects, own, report))
        else:
            truths.append(
                make_independent(out / name, planned.rig, own, effects=planned.effects, fast=fast, on_progress=report)
            )
    truth = {"seed": seed, "refine": REFINE, "step_share": STEP_SHARE, "fast": fast, "cases": truths}
    digest = write_seal(out, truth, salt=salt.generate_state(8).tobytes().hex())
    return f"{out}: {cases} cases on {', '.join(rigs)}.\nSealed: {digest}"


def make_case(
    folder: Path, effects: Sequence[str], seed: np.random.SeedSequence, report: Callable[[float], None]
) -> dict[str, Any]:
    """One case on the bench. Drawn again, with new random numbers, where the simulator does not converge."""
    for own in seed.spawn(MAX_DRAWS):
        try:
            case = _draw(folder.name, effects, own)
            traces = []
            for k, run in enumerate(case.poses):
                report((k + 1) / (len(case.poses) + 1))
                traces.append(_trace(case.rig, case.poses[run]))
        except ConvergenceError:
            continue
        folder.mkdir()
        for run, trace in zip(case.poses, traces, strict=True):
            write_trace(case.rig, trace, case.poses[run], folder / run, case.noise[run])
        (folder / "rig.yaml").write_text(rig_to_yaml(case.nominal))
        roles = {"training": list(bench.TRAINING), "held_out": list(bench.HELD_OUT)}
        (folder / "case.yaml").write_text(yaml.safe_dump(roles, sort_keys=False))
        return case.truth
    raise ConvergenceError(f"{folder.name}: no draw could be simulated.", "Use another seed.")


def _draw(name: str, effects: Sequence[str], seed: np.random.SeedSequence) -> _Case:
    """Everything random of a case. What is concealed has random numbers of its own, so that nothing else
    depends on it."""
    for_materials, for_motion, for_noise, for_guess, for_effect = seed.spawn(5)
    rng = np.random.default_rng(for_materials)
    materials, levels = bench.draw_materials(rng), bench.draw_noise(rng)
    rig = bench.true_rig(materials)
    motion = np.random.default_rng(for_motion)
    poses = {run: bench.draw_poses(motion, rig, kind) for run, kind in bench.KINDS.items()}
    nominal = bench.told_rig(np.random.default_rng(for_guess), rig, levels)
    concealed = []
    if effects:
        rng = np.random.default_rng(for_effect)
        sight = Sight(rig, [poses[r] for r in bench.TRAINING], levels)
        for effect in effects:
            amplitudes, signal = _visible(rng, effect, sight)
            slot = effect_by_name(effect).slot
            concealed.append(
                {"name": effect, "slot": slot, "in_library": True, "parameters": amplitudes, "signal": signal}
            )
        rig = rig.model_copy(update={"effects": {str(e["name"]): e["parameters"] for e in concealed}})
    streams = dict(zip(bench.KINDS, for_noise.spawn(len(bench.KINDS)), strict=True))
    truth = {
        "case": name,
        "rig": "bench",
        "truth": "simulator",
        "effects": concealed,
        "materials": materials,
        "noise": {k: asdict(n) for k, n in levels.items()},
    }
    noise = {run: ColouredNoise(rig, levels, stream) for run, stream in streams.items()}
    return _Case(truth, rig, nominal, poses, noise)


def _visible(rng: np.random.Generator, effect: str, sight: Sight) -> tuple[Amplitudes, float]:
    """Amplitudes that stand out from the noise, and by how much."""
    for _ in range(MAX_DRAWS):
        amplitudes = draw_amplitudes(rng, effect)
        signal = sight.signal(effect, amplitudes)
        if signal >= MIN_SIGNAL:
            return amplitudes, signal
    raise ConvergenceError(f"No amplitude of {effect} stands out from the noise.", "Use another seed.")


def _trace(rig: Rig, poses: dict[str, PoseTrajectory]) -> Any:
    end = max(float(p.times[-1]) for p in poses.values())
    return simulate(build_scene(rig, REFINE), poses, step_times(0.0, end, STEP_SHARE * rig.solver.dt_s))
