"""CPU time of a rollout along the motion of a recording, all readings included."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from sim_core.core.library import load
from sim_core.core.rollout import CoreRollout
from sim_core.errors import ConfigError
from sim_core.gradients import directions, simulate_tangent
from sim_core.rigs import Rig, list_parameters
from sim_core.scene import build_scene
from sim_core.simulate import simulate
from sim_core.solve.step import NewtonSettings
from sysid.model.load import load_run
from sysid.model.marker_registration import placed
from sysid.model.time_span import rollout_times


@dataclass(frozen=True)
class Speed:
    """``cpu_ms_per_step``: readings included, ``cpu_ms_per_step_with_columns``: with derivatives by ``columns``
    parameters. ``compile_s``: until the compiled core was there, next to nothing where it was compiled before."""

    steps: int
    unknowns: int
    cpu_ms_per_step: float
    columns: int
    cpu_ms_per_step_with_columns: float | None
    factorisations_per_step: float
    residuals_per_step: float
    compile_s: float


def measure_recording(rig: Rig, bag: Path, columns: int = 0) -> Speed:
    """Simulate the motion of a recording, and once more with derivatives by the first ``columns`` parameters of the rig
    that have a value. Raises ``ConfigError`` where it has not as many."""
    run = load_run(rig, bag)
    scene = build_scene(rig)
    rig = placed(scene, run.firsts)
    scene.use(rig)
    names = [p.name for p in list_parameters(rig) if p.value is not None and not p.name.endswith("latency_s")]
    if columns > len(names):
        raise ConfigError(
            f"--columns is {columns}, and {rig.name} has {len(names)} parameters with a value.",
            f"Give at most {len(names)}.",
        )
    along = directions(rig, names[:columns])
    times = rollout_times([rig, *(end for d in along for end in (d.low, d.high))], run, rig.solver.dt_s)
    steps = len(times) - 1
    simulate(scene, run.poses, times[:3])  # kernels are compiled at their first use
    begin = time.process_time()
    trace = simulate(scene, run.poses, times)
    forward = time.process_time() - begin
    with_columns = None
    if columns:
        simulate_tangent(scene, run.poses, times[:3], along)
        begin = time.process_time()
        simulate_tangent(scene, run.poses, times, along)
        with_columns = 1e3 * (time.process_time() - begin) / steps
    rollout = CoreRollout(scene, run.poses, times, NewtonSettings())
    rollout.settle()
    for _ in rollout.run():
        pass
    return Speed(
        steps=steps,
        unknowns=scene.system.n_unknowns,
        cpu_ms_per_step=1e3 * forward / steps,
        columns=columns,
        cpu_ms_per_step_with_columns=with_columns,
        factorisations_per_step=float(np.mean([r.factorisations for r in trace.reports])),
        residuals_per_step=float(rollout.counts["residuals"].mean()),
        compile_s=load().compile_s,
    )


def run_recording_benchmark(rig: Rig, bag: Path, columns: int, as_json: bool) -> str:
    """Measure, and say it."""
    found = measure_recording(rig, bag, columns)
    if as_json:
        return json.dumps(asdict(found), indent=2)
    lines = [
        f"{found.steps} steps of {found.unknowns} unknowns",
        f"{found.cpu_ms_per_step:.3g} ms of CPU a step, readings included",
        f"{found.factorisations_per_step:.2f} factorisations a step",
    ]
    if found.cpu_ms_per_step_with_columns is not None:
        lines.insert(2, f"{found.cpu_ms_per_step_with_columns:.3g} ms with {found.columns} derivatives")
    lines.append(f"{found.residuals_per_step:.2f} residuals a step")
    return "\n".join([*lines, f"the compiled core was there after {found.compile_s:.3g} s"])
