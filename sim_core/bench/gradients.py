"""The adjoint on the workload of :mod:`sim_core.bench.forming`: steps per second backwards, and memory by horizon.

The loss is a sum of all readings at all times with random weights. Times are those of a clock on the wall: forwards one
core is busy, and backwards a second one factorises what the first will solve with. Everything that is timed is done
three times, one thing after the other, and the shortest times count. Long horizons repeat the workload to and fro.
Recording a step includes linearising it, so the way back has the factorisation and the back-substitution, and the
products left to do.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from sim_core.bench.forming import ALONG_M, ALONG_STEPS, DOWN_M, DOWN_STEPS
from sim_core.bench.machine import machine_name
from sim_core.gradients import Backward, Direction, Tape, directions
from sim_core.rigs import list_parameters, load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.scene.scene import Scene
from sim_core.simulate import simulate

REPEATS = 3
"""How often everything is timed, of which the fastest counts."""

HORIZONS = (125, 250, 500, 1000, 2000)


@dataclass(frozen=True)
class Horizon:
    """Memory [MB] of a tape of so many ``steps``: all kept with how they are linearised; only the states; and made
    again from checkpoints, one segment at a time."""

    steps: int
    kept_mb: float
    states_mb: float
    checkpoints_mb: float


@dataclass(frozen=True)
class GradientBenchmark:
    """Steps per second. ``forward``: without recording; ``recorded``: with states and linearised steps
    kept; ``backward``: from there, by poses and start alone, and by ``parameters`` parameters besides;
    ``backward_states``: from the states alone; ``backward_again``: with the steps made again from checkpoints, that
    included; ``recorded_factors``, ``backward_factors``: with the factorisations kept too."""

    unknowns: int
    steps: int
    parameters: int
    forward: float
    recorded: float
    backward: float
    backward_parameters: float
    backward_states: float
    backward_again: float
    recorded_factors: float
    backward_factors: float
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
    _gradient(Backward(Tape(scene, poses, times[: DOWN_STEPS // 2]), along))  # the first launch of a kernel loads it
    spent = _shortest(scene, poses, times, along)
    return GradientBenchmark(
        unknowns=scene.system.n_unknowns,
        steps=steps,
        parameters=len(names),
        horizons=measure_horizons(scene, horizons),
        machine=machine_name(),
        **{name: steps / seconds for name, seconds in spent.items()},
    )


def _shortest(
    scene: Scene, poses: Mapping[str, PoseTrajectory], times: np.ndarray, along: Sequence[Direction]
) -> dict[str, float]:
    """Shortest time [s] of everything that is timed."""
    tape = Tape(scene, poses, times, memory_mb=math.inf)
    states = Tape(scene, poses, times, memory_mb=math.inf)
    for interval in states.everything():
        interval.forget()
    again = Tape(scene, poses, times, memory_mb=0.0)
    factors = Tape(scene, poses, times, memory_mb=math.inf, factors=True)
    work: dict[str, Callable[[], Any]] = {
        "forward": lambda: simulate(scene, poses, times),
        "recorded": lambda: Tape(scene, poses, times, memory_mb=math.inf),
        "backward": partial(_gradient, Backward(tape, [])),
        "backward_parameters": partial(_gradient, Backward(tape, along)),
        "backward_states": partial(_gradient, Backward(states, [])),
        "backward_again": partial(_gradient, Backward(again, [])),
        "recorded_factors": lambda: Tape(scene, poses, times, memory_mb=math.inf, factors=True),
        "backward_factors": partial(_gradient, Backward(factors, [])),
    }
    spent = dict.fromkeys(work, math.inf)
    for _ in range(REPEATS):
        for name, do in work.items():
            spent[name] = min(spent[name], _timed(do))
    return spent


def measure_horizons(scene: Scene, horizons: Sequence[int]) -> tuple[Horizon, ...]:
    """Memory by horizon, from what the steps of the longest take; a checkpoint takes as much as a state."""
    tape = Tape(scene, *path(scene, max(horizons, default=1), scene.rig.solver.dt_s), memory_mb=0.0)
    sizes = np.array([(i.size_bytes(), i.state_bytes()) for i in tape.everything()])
    found = []
    for count in horizons:
        length = math.ceil(math.sqrt(count))
        whole, states = 1e-6 * sizes[:count].T
        points = states[::length].sum()
        segment = max(whole[k : k + length].sum() for k in range(0, count, length))
        found.append(Horizon(count, points + whole.sum(), points + states.sum(), points + segment))
    return tuple(found)


def _timed(work: Callable[[], Any]) -> float:
    """Time [s]."""
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def _gradient(backward: Backward) -> None:
    outputs = backward.trace.outputs
    rng = np.random.default_rng(0)
    backward.gradient(0.0, {c: rng.standard_normal(v.shape) for c, v in outputs.items()})


def run_gradient_benchmark(as_json: bool = False) -> str:
    """Measure, and say it."""
    found = measure_gradients()
    return json.dumps(asdict(found), indent=2) if as_json else "\n".join(gradient_lines(found))


def gradient_lines(found: GradientBenchmark) -> list[str]:
    def line(name: str, rate: float) -> str:
        return f"  {name:<44}{rate:7.1f}{rate / found.forward:9.1f}"

    lines = [
        f"forming, {found.unknowns} unknowns, {found.steps} steps",
        f"  {'steps per second':<44}{'':>7}{'/forward':>9}",
        line("forward", found.forward),
        line("forward, recorded and linearised", found.recorded),
        line("backward from there: poses and start", found.backward),
        line(f"  and {found.parameters} parameters", found.backward_parameters),
        line("backward from states alone", found.backward_states),
        line("backward, steps made again from checkpoints", found.backward_again),
        line("forward, factorised and all kept", found.recorded_factors),
        line("backward from there: poses and start", found.backward_factors),
        "",
        f"{'steps':>7}{'all kept [MB]':>16}{'states [MB]':>16}{'checkpoints [MB]':>18}",
    ]
    lines += [f"{h.steps:>7}{h.kept_mb:>16.1f}{h.states_mb:>16.1f}{h.checkpoints_mb:>18.1f}" for h in found.horizons]
    return [*lines, f"on {found.machine}, one core forwards and two backwards, where there are two"]
