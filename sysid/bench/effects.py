"""What a step costs with each effect, along a recording."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from sim_core.effects import all_effects
from sim_core.effects.hooks import BodyForce, FieldMap, FrictionLaw, MaterialLaw, MechanicsMap, NormalLaw, RigMap
from sim_core.errors import ConvergenceError
from sim_core.rigs import Rig
from sim_core.scene import Scene, build_scene
from sim_core.simulate import simulate
from sysid.model.load import load_run
from sysid.model.marker_registration import placed
from sysid.model.time_span import rollout_times

MECHANICAL = (BodyForce, FieldMap, FrictionLaw, MaterialLaw, MechanicsMap, NormalLaw, RigMap)
"""Interfaces of effects on the mechanics; those on commands and readings leave the path of a step as it is."""

STEPS = 60
"""Of a recording, with which each effect is measured."""


@dataclass(frozen=True)
class EffectSpeed:
    """CPU time of a step with an effect at its example values [ms], readings included; None where a step does not
    converge."""

    effect: str
    cpu_ms_per_step: float | None


def measure_effects(rig: Rig, bag: Path) -> list[EffectSpeed]:
    """Of all effects on the mechanics that can act on the rig, one at a time."""
    recorded = load_run(rig, bag)
    scene = build_scene(rig)
    rig = placed(scene, recorded.firsts)
    times = rollout_times([rig], recorded, rig.solver.dt_s)[: STEPS + 1]
    found = []
    for name, effect in all_effects().items():
        if not isinstance(effect, MECHANICAL) or not effect.targets(rig):
            continue
        with_effect = build_scene(rig.model_copy(update={"effects": {**rig.effects, name: dict(effect.example)}}))

        def rollout(made: Scene = with_effect) -> None:
            simulate(made, recorded.poses, times)

        found.append(EffectSpeed(name, _cpu_ms(rollout, len(times) - 1)))
    return found


def _cpu_ms(rollout: Callable[[], None], steps: int) -> float | None:
    """CPU time of a step, the second time; None where one does not converge."""
    try:
        rollout()
        begin = time.process_time()
        rollout()
    except ConvergenceError:
        return None
    return 1e3 * (time.process_time() - begin) / steps


def run_effects_benchmark(rig: Rig, bag: Path, as_json: bool) -> str:
    """Measure, and say it."""
    found = measure_effects(rig, bag)
    if as_json:
        return json.dumps([asdict(row) for row in found], indent=2)
    lines = [f"{'effect':26} {'CPU ms a step':>13}"]
    for row in found:
        lines.append(f"{row.effect:26} " + (f"{row.cpu_ms_per_step:13.3g}" if row.cpu_ms_per_step else f"{'-':>13}"))
    return "\n".join(lines)
