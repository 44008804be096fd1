"""The adjoint on the workload of :mod:`sim_core.bench.forming`: steps per second backwards, and memory by horizon.

The loss is a sum of all readings at all times with random weights. Times are of the processor, so that they mean
something on a machine that is shared. Long horizons repeat the workload to and fro.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from sim_core.bench.forming import ALONG_M, ALONG_STEPS, DOWN_M, DOWN_STEPS
from sim_core.bench.machine import machine_name
from sim_core.gradients import Backward, Tape, directions
from sim_core.rigs import list_parameters, load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.scene.scene import Scene

HORIZONS = (125, 250, 500, 1000, 2000)


@dataclass(frozen=True)
class Horizon:
    """Memory [MB] of a tape of so many ``steps``: all of them kept, and made again from checkpoints."""

    steps: int
    kept_mb: float
    checkpoints_mb: float


@dataclass(frozen=True)
class GradientBenchmark:
    """Steps per second of the processor: ``forward`` with recording; ``backward``: by poses and start alone, and by
    ``parameters`` parameters besides; ``again``: backwards with the steps made again from checkpoints."""

    unknowns: int
    steps: int
    parameters: int
    forward: float
    backward: float
    backward_parameters: float
    backward_again: float
    horizons: tuple[Horizon, ...]
    machine: str


def path(scene: Scene, steps: int, dt: float) -> tuple[dict[str, PoseTrajectory], np.ndarray]:
    """The finger comes down, draws the card along, and goes on to and fro; and the times of the steps."""
    origin, rotation = scene.start["finger"]
    k = np.arange(steps + 1)
    along = np.abs((np.maximum(0, k - DOWN_STEPS) + ALONG_STEPS) % (2 * ALONG_STEPS) - ALONG_STEPS) / ALONG_STEPS
    shift = np.column_stack([ALONG_M * along, np.zeros(len(k)), -DOWN_M * np.minimum(1.0, k / DOWN_STEPS)])
    quaternions = np.tile(rotation.as_quat(), (len(k), 1))
    times = np.arange(0.0, steps + 0.5) * dt
    return {"finger": PoseTrajectory(times, origin + shift, quaternions)}, times


def measure_gradients(steps: int = DOWN_STEPS + ALONG_STEPS, horizons: Sequence[int] = HORIZONS) -> GradientBenchmark:
    """Run the workload forwards and backwards, then the horizons forwards."""
    rig = load_rig("forming")
    scene = build_scene(rig)
    poses, times = path(scene, steps, rig.solver.dt_s)
    names = [p.name for p in list_parameters(rig) if p.value is not None]
    along = directions(rig, names)
    _gradient(Backward(Tape(scene, poses, times[:8]), along))  # the first launch of a kernel loads its code
    begun = time.process_time()
    tape = Tape(scene, poses, times)
    forward = time.process_time() - begun
    again = Tape(scene, poses, times, memory_mb=0.0)
    spent = []
    for backward in (Backward(tape, []), Backward(tape, along), Backward(again, [])):
        begun = time.process_time()
        _gradient(backward)
        spent.append(time.process_time() - begun)
    longest = Tape(scene, *path(scene, max(horizons), rig.solver.dt_s), memory_mb=0.0)
    found = [horizon(longest.sizes_bytes[:count]) for count in horizons]
    return GradientBenchmark(
        unknowns=scene.system.n_unknowns,
        steps=steps,
        parameters=len(names),
        forward=steps / forward,
        backward=steps / spent[0],
        backward_parameters=steps / spent[1],
        backward_again=steps / spent[2],
        horizons=tuple(found),
        machine=machine_name(),
    )


def horizon(sizes_bytes: Sequence[int]) -> Horizon:
    """Memory of a horizon from what its steps take; a checkpoint takes as much as the step after it."""
    count = len(sizes_bytes)
    length = math.ceil(math.sqrt(count))
    points = sum(sizes_bytes[::length])
    most = max(sum(sizes_bytes[k : k + length]) for k in range(0, count, length))
    return Horizon(count, 1e-6 * (points + sum(sizes_bytes)), 1e-6 * (points + most))


def _gradient(backward: Backward) -> None:
    outputs = backward.trace.outputs
    rng = np.random.default_rng(0)
    backward.gradient(0.0, {c: rng.standard_normal(v.shape) for c, v in outputs.items()})


def run_gradient_benchmark(as_json: bool = False) -> str:
    """Measure, and say it."""
    found = measure_gradients()
    return json.dumps(asdict(found), indent=2) if as_json else "\n".join(gradient_lines(found))


def gradient_lines(found: GradientBenchmark) -> list[str]:
    lines = [
        f"forming, {found.unknowns} unknowns, {found.steps} steps; steps per second of the processor:",
        f"  forward, recorded              {found.forward:7.1f}",
        f"  backward, poses and start      {found.backward:7.1f}  ({found.backward / found.forward:.1f} times forward)",
        f"  and {found.parameters:2d} parameters              {found.backward_parameters:7.1f}",
        f"  backward, steps made again     {found.backward_again:7.1f}",
        "",
        f"{'steps':>7}{'all kept [MB]':>16}{'checkpoints [MB]':>18}",
    ]
    lines += [f"{h.steps:>7}{h.kept_mb:>16.1f}{h.checkpoints_mb:>18.2f}" for h in found.horizons]
    return [*lines, f"on {found.machine}, one core"]
