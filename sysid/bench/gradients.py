"""The adjoint on the workload of :mod:`sysid.bench.forming`, and on a strip that is shaken: what going back costs
compared with going forwards, and the memory of a tape.

The loss is a sum of all readings at all times with random weights. Times are those of the processor; everything is done
three times, one thing after the other, and the shortest times count.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sim_core.gradients import Backward, Direction, Tape, directions
from sim_core.rigs import list_parameters, load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.scene.scene import Scene
from sim_core.simulate import simulate
from sysid.bench.forming import ALONG_M, ALONG_STEPS, DOWN_M, DOWN_STEPS
from sysid.bench.machine import machine_name

REPEATS = 3
"""How often everything is timed, of which the fastest counts."""

SHAKEN_M, SHAKEN_STEPS = 0.004, 40
"""How far the strip is drawn to one side, and in how many steps from there to the other."""


@dataclass(frozen=True)
class GradientBenchmark:
    """CPU time of a step [ms]. ``forward``: without recording; ``recorded``: with the steps kept; ``backward``: from
    there, by poses and start alone, by ``parameters`` parameters besides, and by all fields over elements and shapes at
    rest; ``kept_kb``: memory of a step on the tape."""

    scene: str
    unknowns: int
    steps: int
    parameters: int
    forward: float
    recorded: float
    backward: float
    backward_parameters: float
    backward_fields: float
    kept_kb: float
    machine: str

    @property
    def backward_to_forward(self) -> float:
        """CPU time of going back, by parameters too, over that of a rollout."""
        return self.backward_parameters / self.forward


def pressed(scene: Scene, steps: int) -> tuple[dict[str, PoseTrajectory], np.ndarray]:
    """The finger comes down, draws the card along, and goes on to and fro; and the times of the steps."""
    k = np.arange(steps + 1)
    along = np.abs((np.maximum(0, k - DOWN_STEPS) + ALONG_STEPS) % (2 * ALONG_STEPS) - ALONG_STEPS) / ALONG_STEPS
    shift = np.column_stack([ALONG_M * along, np.zeros(len(k)), -DOWN_M * np.minimum(1.0, k / DOWN_STEPS)])
    return _path(scene, "finger", shift)


def shaken(scene: Scene, steps: int) -> tuple[dict[str, PoseTrajectory], np.ndarray]:
    """The hands of a strip go to and fro; and the times of the steps."""
    along = SHAKEN_M * np.sin(np.pi * np.arange(steps + 1) / SHAKEN_STEPS)
    return _path(scene, next(iter(scene.rig.end_effectors)), along[:, None] * [0.3, 0.0, 1.0])


def _path(scene: Scene, mount: str, shift: np.ndarray) -> tuple[dict[str, PoseTrajectory], np.ndarray]:
    origin, rotation = scene.start[mount]
    times = np.asarray(np.arange(len(shift)) * scene.rig.solver.dt_s, dtype=np.float64)
    quaternions = np.tile(rotation.as_quat(), (len(shift), 1))
    return {mount: PoseTrajectory(times, np.asarray(origin + shift, dtype=float), quaternions)}, times


SCENES: dict[str, tuple[Callable[..., Any], int]] = {
    "forming": (pressed, DOWN_STEPS + ALONG_STEPS),
    "strip_coarse": (shaken, 4 * SHAKEN_STEPS),
}
"""Rigs with their motions, and how many steps these have."""


def measure_gradients(name: str, steps: int = 0) -> GradientBenchmark:
    """Run one of the :data:`SCENES` forwards and backwards; ``steps``: 0: all."""
    motion, usual = SCENES[name]
    steps = steps or usual
    rig = load_rig(name)
    scene = build_scene(rig)
    poses, times = motion(scene, steps)
    names = [p.name for p in list_parameters(rig) if p.value is not None]
    spent, kept = _shortest(scene, poses, times, directions(rig, names))
    return GradientBenchmark(
        scene=name,
        unknowns=scene.system.n_unknowns,
        steps=steps,
        parameters=len(names),
        kept_kb=1e-3 * kept / steps,
        machine=machine_name(),
        **{name: 1e3 * seconds / steps for name, seconds in spent.items()},
    )


def _shortest(
    scene: Scene, poses: Mapping[str, PoseTrajectory], times: np.ndarray, along: Sequence[Direction]
) -> tuple[dict[str, float], int]:
    """Shortest CPU time [s] of everything that is timed, and the memory of the tape [B]."""
    tape = Tape(scene, poses, times)
    plain, by_all = Backward(tape, []), Backward(tape, along)
    by_fields = Backward(tape, [], scene.fields.names)
    rng = np.random.default_rng(0)
    weights = {c: rng.standard_normal(v.shape) for c, v in tape.trace.outputs.items()}
    work: dict[str, Callable[[], Any]] = {
        "forward": lambda: simulate(scene, poses, times),
        "recorded": lambda: Tape(scene, poses, times),
        "backward": lambda: plain.gradient(0.0, weights),
        "backward_parameters": lambda: by_all.gradient(0.0, weights),
        "backward_fields": lambda: by_fields.gradient(0.0, weights),
    }
    spent = dict.fromkeys(work, math.inf)
    for _ in range(REPEATS):
        for name, do in work.items():
            begun = time.process_time()
            do()
            spent[name] = min(spent[name], time.process_time() - begun)
    return spent, tape.rollout.kept_bytes


def run_gradient_benchmark(as_json: bool = False) -> str:
    """Measure all scenes, and say it."""
    found = [measure_gradients(name) for name in SCENES]
    if as_json:
        return json.dumps([asdict(one) for one in found], indent=2)
    return "\n".join(line for one in found for line in [*gradient_lines(one), ""]) + f"on {machine_name()}"


def gradient_lines(found: GradientBenchmark) -> list[str]:
    """The figures of a scene as a table."""

    def line(name: str, spent: float) -> str:
        return f"  {name:<52}{spent:9.3f}{spent / found.forward:10.2f}"

    by_all = f"  and {found.parameters} parameters"
    return [
        f"{found.scene}, {found.unknowns} unknowns, {found.steps} steps",
        f"  {'CPU time of a step':<52}{'[ms]':>9}{'/forward':>10}",
        line("forward", found.forward),
        line("the same, recorded", found.recorded),
        line("backward from there: poses and start", found.backward),
        line(by_all, found.backward_parameters),
        line("  and all fields over elements, shapes at rest too", found.backward_fields),
        f"  The tape keeps {found.kept_kb:.1f} kB a step.",
    ]
