"""A hollow gel finger forms a card on a table (rig ``forming``): steps per second and what they go into.

The finger comes down until it squeezes the free end of the card on the table, then draws it along, in
steps of 5 ms that all converge, with friction between gel and card and between card and table.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_core.batch import worker_pool
from sim_core.bench.machine import machine_name
from sim_core.rigs import load_rig
from sim_core.scene import build_scene
from sim_core.scene.scene import Scene
from sim_core.simulate import Simulation
from sim_core.solve.step import StepReport

DOWN_M, ALONG_M = 6.5e-3, 1.0e-2
DOWN_STEPS, ALONG_STEPS = 60, 60


@dataclass(frozen=True)
class Benchmark:
    """Figures of one run. Times in seconds of wall clock, but ``cpu_s``; ``parts_s``: what the ``clocked_s`` of a
    second run went into, which clocks slow down a little."""

    rig: str
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
    clocked_s: float
    parts_s: dict[str, float]
    machine: str
    cores: int
    python: str


class _Clock:
    """Adds up the time spent in calls, each second counted once (in the innermost part)."""

    def __init__(self) -> None:
        self.parts: dict[str, float] = {}
        self._inner = 0.0

    def wrap(self, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
        self.parts.setdefault(part, 0.0)

        def timed(*given: Any, **named: Any) -> Any:
            outer, self._inner = self._inner, 0.0
            start = time.perf_counter()
            try:
                return function(*given, **named)
            finally:
                spent = time.perf_counter() - start
                self.parts[part] += spent - self._inner
                self._inner = outer + spent

        return timed


def _instrument(scene: Scene, clock: _Clock) -> None:
    """Time the parts of a step: every term, the factorisation, the solve and the search for contact."""
    system: Any = scene.system
    for term in system.terms:
        instance: Any = term
        for method in ("add_energy", "add_gradient", "add_hessian", "foresee"):
            if hasattr(instance, method):
                setattr(instance, method, clock.wrap(f"assembly: {term.name}", getattr(instance, method)))
        part = "contact search" if term.name.startswith("contact.") else f"assembly: {term.name}"
        for method in ("prepare", "begin_step", "end_step", "outran"):
            if hasattr(instance, method):
                setattr(instance, method, clock.wrap(part, getattr(instance, method)))
    plain = system.factor_data

    def factor_data(data: np.ndarray, definite: bool) -> Any:
        factor = plain(data, definite)
        if not getattr(factor, "timed", False):
            factor.solve, factor.timed = clock.wrap("solve", factor.solve), True
        return factor

    system.factor_data = clock.wrap("factorisation", factor_data)
    system._pattern.renew = clock.wrap("contact search", system._pattern.renew)
    system._pattern.data = clock.wrap("gathering the matrix", system._pattern.data)
    system._inertia_energy = clock.wrap("assembly: inertia", system._inertia_energy)
    system._inertia_gradient = clock.wrap("assembly: inertia", system._inertia_gradient)


def _work(simulation: Simulation, down_steps: int, along_steps: int) -> tuple[list[StepReport], float, float]:
    """Make the steps from where the scene starts; the seconds of wall clock and of the processor."""
    origin, rotation = simulation.scene.start["finger"]
    reports: list[StepReport] = []
    cpu, begin = time.process_time(), time.perf_counter()
    for k in range(1, down_steps + along_steps + 1):
        shift = np.array(
            [ALONG_M * max(0, k - down_steps) / max(along_steps, 1), 0.0, -DOWN_M * min(1.0, k / down_steps)]
        )
        reports.append(simulation.step({"finger": (origin + shift, rotation)}, simulation.scene.rig.solver.dt_s))
    return reports, time.perf_counter() - begin, time.process_time() - cpu


def measure(down_steps: int = DOWN_STEPS, along_steps: int = ALONG_STEPS) -> Benchmark:
    """Run the workload, and again to see what it goes into. Raises ``ConvergenceError`` if a step does not converge."""
    rig = load_rig("forming")
    start = time.perf_counter()
    scene = build_scene(rig)
    built = time.perf_counter()
    simulation = Simulation(scene)
    scene.system.hessian_data()  # the first launch of a kernel loads its code
    settled = time.perf_counter()
    reports, wall, cpu = _work(simulation, down_steps, along_steps)
    clock = _Clock()
    _instrument(scene, clock)
    simulation.reset()
    scene.system.forget()
    clock.parts = dict.fromkeys(clock.parts, 0.0)
    _, clocked, _ = _work(simulation, down_steps, along_steps)
    parts = dict(sorted(clock.parts.items(), key=lambda item: -item[1]))
    parts["rest"] = clocked - sum(parts.values())
    return Benchmark(
        rig=rig.name,
        unknowns=scene.system.n_unknowns,
        steps=len(reports),
        steps_per_s=len(reports) / wall,
        cpu_steps_per_s=len(reports) / cpu,
        iterations_per_step=float(np.mean([r.iterations for r in reports])),
        factorisations_per_step=float(np.mean([r.factorisations for r in reports])),
        most_contacts=max(r.contacts for r in reports),
        contact_steps=sum(r.contacts > 0 for r in reports),
        build_s=built - start,
        settle_s=settled - built,
        wall_s=wall,
        cpu_s=cpu,
        clocked_s=clocked,
        parts_s=parts,
        machine=machine_name(),
        cores=os.cpu_count() or 1,
        python=platform.python_version(),
    )


def measure_side_by_side(processes: int | None = None) -> tuple[int, float]:
    """Number of processes (default: one a core) that ran the workload at the same time, and their steps/s together."""
    count = processes or os.cpu_count() or 1
    with worker_pool(count) as pool:
        found = [future.result() for future in [pool.submit(measure) for _ in range(count)]]
    return count, sum(each.steps_per_s for each in found)
