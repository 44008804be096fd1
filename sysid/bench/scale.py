"""Time and memory of a step against the number of unknowns: a ball presses a card, held along one side, and rubs it.

Each size runs in a process of its own, so that its peak memory is its own. Two of the sizes are those of
published simulations: the scenes are not theirs, so that comparison is of orders of magnitude only.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.processes import worker_pool
from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sim_core.solve.report import StepReport
from sysid.bench.machine import peak_memory_mb

SETTLING_STEPS, TIMED_STEPS = 8, 8
"""Steps in which the ball comes down on the card, and steps that are timed after them."""


@dataclass(frozen=True)
class Published:
    """What another simulator reports for as many unknowns."""

    name: str
    source: str
    steps_per_s: float


@dataclass(frozen=True)
class Mesh:
    """Cells of the card and their pattern; one with a ``published`` counterpart has no part in the exponent."""

    cells: tuple[int, int]
    pattern: str
    published: Published | None = None


DIFFCLOTH = Published("DiffCloth", "Li et al., ACM Trans. Graph. 42 (2022)", 7.14)
C_IPC = Published("C-IPC", "Li, Kaufman & Jiang, ACM Trans. Graph. 40 (2021)", 0.024)

MESHES = (
    Mesh((25, 23), "regular"),
    Mesh((26, 16), "crossed", DIFFCLOTH),
    Mesh((42, 40), "regular"),
    Mesh((56, 55), "crossed", C_IPC),
    Mesh((83, 81), "regular"),
    Mesh((142, 140), "regular"),
)


@dataclass(frozen=True)
class Size:
    """Figures of one size; times a step [s], of wall clock and of the processor."""

    unknowns: int
    step_s: float
    cpu_step_s: float
    iterations_per_step: float
    factorisations_per_step: float
    contacts: int
    peak_memory_mb: float
    published: Published | None


@dataclass(frozen=True)
class Scaling:
    """All sizes. Processor time a step grows like unknowns to the power of ``exponent`` over those without a
    published counterpart."""

    sizes: tuple[Size, ...]
    exponent: float


def card_rig(mesh: Mesh) -> Rig:
    """A square card, held along one side, and a ball on an end effector over its middle."""
    sheet = {"type": "rectangle", "length_m": 0.1, "width_m": 0.1, "cells": mesh.cells, "pattern": mesh.pattern}
    return parse_rig(
        {
            "name": "ball_on_card",
            "gravity_m_s2": [0.0, 0.0, -9.81],
            "solver": {"dt_s": 0.005},
            "bodies": {
                "card": {
                    "type": "sheet",
                    "shape": sheet,
                    "pose": {"position_m": [0.0, 0.0, -0.002]},
                    "material": {"preset": "card_200gsm"},
                },
                "ball": {"type": "rigid", "shape": {"type": "sphere", "radius_m": 0.02}, "mount": "arm"},
            },
            "clamps": [{"body": "card", "region": {"x_m": [-0.05, -0.05 + 0.1 / mesh.cells[0]]}, "mount": "world"}],
            "end_effectors": {"arm": {"start": {"position_m": [0.0, 0.0, 0.0184]}}},
            "contacts": [{"between": ["card", "ball"], "friction": 0.3}],
        },
        "benchmark",
    )


def measure_size(mesh: Mesh, settling_steps: int = SETTLING_STEPS, timed_steps: int = TIMED_STEPS) -> Size:
    """Run one size in this process. Raises ``ConvergenceError`` when a step does not converge."""
    rig = card_rig(mesh)
    scene = build_scene(rig)
    origin, rotation = scene.start["arm"]
    simulation = Simulation(scene)

    def step(k: int) -> StepReport:
        shift = np.array([2e-4 * max(0, k - settling_steps), 0.0, -4e-4 * k])
        return simulation.step({"arm": (origin + shift, rotation)}, rig.solver.dt_s)

    for k in range(1, settling_steps + 1):
        step(k)
    cpu, begin = time.process_time(), time.perf_counter()
    reports = [step(settling_steps + k) for k in range(1, timed_steps + 1)]
    wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
    return Size(
        unknowns=scene.system.n_unknowns,
        step_s=wall / timed_steps,
        cpu_step_s=cpu / timed_steps,
        iterations_per_step=float(np.mean([r.iterations for r in reports])),
        factorisations_per_step=float(np.mean([r.factorisations for r in reports])),
        contacts=max(r.contacts for r in reports),
        peak_memory_mb=peak_memory_mb(),
        published=mesh.published,
    )


def measure_sizes(meshes: Sequence[Mesh], on_size: Callable[[Size], None] | None = None) -> list[Size]:
    """Run sizes, one after the other, each in a fresh process."""
    sizes = []
    for mesh in meshes:
        with worker_pool(1) as pool:
            sizes.append(pool.submit(measure_size, mesh).result())
        if on_size is not None:
            on_size(sizes[-1])
    return sizes


def measure_scaling(meshes: Sequence[Mesh] = MESHES, on_size: Callable[[Size], None] | None = None) -> Scaling:
    """Run all sizes; at least two without a published counterpart."""
    sizes = measure_sizes(meshes, on_size)
    return Scaling(tuple(sizes), growth([s for s in sizes if s.published is None]))


def growth(sizes: Sequence[Size]) -> float:
    """Power of the number of unknowns with which the processor time of a step grows, by least squares."""
    unknowns, times = (np.log([getattr(s, name) for s in sizes]) for name in ("unknowns", "cpu_step_s"))
    return float(np.polyfit(unknowns, times, 1)[0])
