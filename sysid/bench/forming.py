"""A hollow gel finger forms a card on a table (rig ``forming``): steps per second.

The finger comes down until it squeezes the free end of the card on the table, then draws it along, in
steps of 5 ms that all converge, with friction between gel and card and between card and table.
"""

from __future__ import annotations

import os
import platform
import time
from dataclasses import dataclass

import numpy as np

from sim_core.core.covers import covers
from sim_core.rigs import load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.scene.scene import Scene
from sim_core.simulate import simulate
from sim_core.threads import worker_threads
from sysid.bench.machine import machine_name

DOWN_M, ALONG_M = 6.5e-3, 1.0e-2
DOWN_STEPS, ALONG_STEPS = 60, 60


@dataclass(frozen=True)
class Benchmark:
    """Figures of one run. Times in seconds of wall clock, but ``cpu_s``, those of all steps but the first; ``path``:
    the compiled core, or why it was not."""

    rig: str
    path: str
    unknowns: int
    steps: int
    steps_per_s: float
    cpu_steps_per_s: float
    iterations_per_step: float
    factorisations_per_step: float
    most_contacts: int
    contact_steps: int
    build_s: float
    settle_s: float
    wall_s: float
    cpu_s: float
    machine: str
    cores: int
    python: str


def workload(scene: Scene, down_steps: int, along_steps: int) -> tuple[dict[str, PoseTrajectory], np.ndarray]:
    """Poses of the finger, and the instants of the steps [s]."""
    origin, rotation = scene.start["finger"]
    k = np.arange(down_steps + along_steps + 1)
    shift = np.zeros((len(k), 3))
    shift[:, 0] = ALONG_M * np.maximum(0, k - down_steps) / max(along_steps, 1)
    shift[:, 2] = -DOWN_M * np.minimum(1.0, k / down_steps)
    times = np.asarray(scene.rig.solver.dt_s * k, dtype=np.float64)
    turns = np.repeat(rotation.as_quat()[None], len(k), axis=0)
    return {"finger": PoseTrajectory.from_samples(times, origin + shift, turns)}, times


def measure(down_steps: int = DOWN_STEPS, along_steps: int = ALONG_STEPS) -> Benchmark:
    """Run the workload. Raises ``ConvergenceError`` if a step does not converge."""
    rig = load_rig("forming")
    start = time.perf_counter()
    scene = build_scene(rig)
    built = time.perf_counter()
    poses, times = workload(scene, down_steps, along_steps)
    simulate(scene, poses, times[:2])  # kernels are compiled, and what is laid out once a scene is
    begin = time.perf_counter(), time.thread_time()
    simulate(scene, poses, times[:2])
    settled = time.perf_counter(), time.thread_time()
    reports = simulate(scene, poses, times).reports
    end = time.perf_counter(), time.thread_time()
    # The start and the first step are in both.
    settle, wall, cpu = settled[0] - begin[0], *(e - 2.0 * s + b for e, s, b in zip(end, settled, begin, strict=True))
    steps = len(reports) - 1
    return Benchmark(
        rig=rig.name,
        path=covers(scene) or "compiled core",
        unknowns=scene.system.n_unknowns,
        steps=len(reports),
        steps_per_s=steps / wall,
        cpu_steps_per_s=steps / cpu,
        iterations_per_step=float(np.mean([r.iterations for r in reports])),
        factorisations_per_step=float(np.mean([r.factorisations for r in reports])),
        most_contacts=max(r.contacts for r in reports),
        contact_steps=sum(r.contacts > 0 for r in reports),
        build_s=built - start,
        settle_s=settle,
        wall_s=wall,
        cpu_s=cpu,
        machine=machine_name(),
        cores=os.cpu_count() or 1,
        python=platform.python_version(),
    )


def measure_side_by_side(threads: int | None = None) -> tuple[int, float]:
    """Number of threads (default: one a core) that ran the workload at the same time, and their steps/s together."""
    count = threads or os.cpu_count() or 1
    with worker_threads(count) as pool:
        found = [future.result() for future in [pool.submit(measure) for _ in range(count)]]
    return count, sum(each.steps_per_s for each in found)
