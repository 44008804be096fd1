"""Environment-steps per second of a GPU: sheets that land on a table and rub on it, each with numbers of its own."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.gpu.engine import Device, Gpu, Run
from sim_core.gpu.problem import Problem
from sim_core.rigs import Rig, parse_rig, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory

BATCHES = (1, 64, 1024, 4096)
"""Rollouts at once."""
CELLS = ((10, 4), (25, 10), (30, 19))
"""Of the meshes: 156, 792 and 1,740 unknowns with two rows of nodes held."""
COMPARED = 8
"""Rollouts of a mesh that are made on the CPU too."""
DT_S, END_S, HEIGHT_M = 0.005, 0.4, 0.12


@dataclass(frozen=True)
class GpuRun:
    """One batch. ``env_steps_per_s``: without the start; ``failed``: rollouts with a step that was not found;
    ``off_cpu_m``: largest distance from the CPU's rollouts at the end of the path, of those that were compared (nan:
    none were)."""

    unknowns: int
    rollouts: int
    steps: int
    env_steps_per_s: float
    iterations_per_step: float
    most_iterations: int
    factorisations_per_step: float
    residuals_per_step: float
    halved: int
    failed: int
    most_contacts: int
    off_cpu_m: float
    window_is_shared: bool


def sheet_rig(cells: tuple[int, int]) -> Rig:
    """A sheet of 250 mm x 100 mm in a gripper above a table, held by two rows of nodes."""
    length = 0.25
    half = 0.5 * length / cells[0]
    return parse_rig(
        {
            "name": "sheet_on_table",
            "gravity_m_s2": [0.0, 0.0, -9.81],
            "solver": {"dt_s": DT_S, "inertia": True, "integrator": "bdf2"},
            "bodies": {
                "sheet": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": length, "width_m": 0.1, "cells": list(cells)},
                    "pose": {"position_m": [0.5 * length - half, 0.0, HEIGHT_M]},
                    "material": {
                        "E_pa": 4.0e9,
                        "nu": 0.3,
                        "thickness_m": 4e-4,
                        "density_kg_m3": 1200.0,
                        "stiffness_damping_s": 1e-3,
                        "mass_damping_per_s": 0.5,
                    },
                },
                "table": {"type": "rigid", "shape": {"type": "plane"}, "pose": {"position_m": [0.0, 0.0, 0.0]}},
            },
            "clamps": [
                {"name": "jaws", "body": "sheet", "region": {"x_m": [-1.5 * half, 1.5 * half]}, "mount": "gripper"}
            ],
            "end_effectors": {"gripper": {"start": {"position_m": [0.0, 0.0, HEIGHT_M]}}},
            "contacts": [{"between": ["sheet", "table"], "friction": 0.3}],
        },
        "sheet on a table",
    )


def landing() -> dict[str, PoseTrajectory]:
    """The gripper comes down until the sheet lies on the table, and draws it along."""
    return {
        "gripper": PoseTrajectory.from_samples(
            np.array([0.0, 0.2, 0.3, END_S]),
            np.array([0.0, 0.0, HEIGHT_M])
            + np.array([[0, 0, 0], [0, 0, -0.08], [-0.01, 0.004, -0.09], [-0.03, 0.0, -0.09]]),
            Rotation.from_rotvec([[0, 0, 0], [0, 8, 0], [0, 10, 3], [0, 8, 0]], degrees=True).as_quat(),
        )
    }


def sheets(count: int) -> list[dict[str, float]]:
    """Numbers of so many sheets, the same in every run."""
    random = np.random.default_rng(7)
    spread = {
        "sheet.E_pa": (4.0e9, 0.3),
        "sheet.thickness_m": (4e-4, 0.1),
        "sheet.density_kg_m3": (1200.0, 0.1),
        "sheet.mass_damping_per_s": (0.5, 0.5),
        "contacts.sheet-table.friction": (0.3, 0.5),
    }
    return [{name: mean * (1.0 + by * random.uniform(-1.0, 1.0)) for name, (mean, by) in spread.items()}
            for _ in range(count)]  # fmt: skip


def measure_batch(problem: Problem, device: Device, ends: np.ndarray) -> GpuRun:
    """Make the rollouts of a problem. ``ends``: where the CPU has the first ones at the end [m] ``(m, nodes, 3)``."""
    count = len(problem.times) - 1
    run = Run(problem, device)
    start = run.steps(0, 0)
    settling_s = run.device_s
    found = run.steps(0, count)
    compared = min(len(ends), problem.rollouts)
    counts, ended = found.counts, ~found.failed & ~start.failed
    return GpuRun(
        unknowns=int(problem.plan["unknowns"]),
        rollouts=problem.rollouts,
        steps=count,
        env_steps_per_s=float(found.made.clip(0).sum() / (run.device_s - settling_s)) if run.device_s else float("nan"),
        iterations_per_step=float(counts["iterations"].mean()),
        most_iterations=int(counts["iterations"].max()),
        factorisations_per_step=float(counts["factorisations"].mean()),
        residuals_per_step=float(counts["residuals"].mean()),
        halved=int((counts["parts"] > 1).sum()),
        failed=int((~ended).sum()),
        most_contacts=int(counts["contacts"].max()),
        off_cpu_m=float(np.abs(found.last[:compared] - ends[:compared]).max()) if compared else float("nan"),
        window_is_shared=run.window_is_shared,
    )


def sheets_problem(
    cells: tuple[int, int], count: int, on_variant: Callable[[int, int], None] | None = None
) -> tuple[Problem, np.ndarray]:
    """Sheets of a mesh as a problem, and where the CPU has the first :data:`COMPARED` of them at the end."""
    from sim_core.gpu.variants import problem_of
    from sim_core.scene import build_scene
    from sim_core.simulate import simulate, step_times

    rig, variants, times = sheet_rig(cells), sheets(count), step_times(0.0, END_S, DT_S)
    ends = []
    for variant in variants[:COMPARED]:
        trace = simulate(build_scene(with_parameters(rig, variant)), landing(), times, keep_path=True)
        assert trace.path is not None
        ends.append(trace.path.positions[-1])
    return problem_of(rig, variants, landing(), times, on_variant=on_variant), np.stack(ends)


def run_gpu_benchmark(as_json: bool = False, on_variant: Callable[[int, int], None] | None = None) -> str:
    """Measure all meshes and batches, and say it. Raises ``ConfigError`` where there is no GPU."""
    device = Gpu()
    runs = []
    for cells in CELLS:
        problem, ends = sheets_problem(cells, max(BATCHES), on_variant)
        runs += [measure_batch(problem.part(n), device, ends) for n in BATCHES]
    if as_json:
        return json.dumps({"gpu": device.name, "runs": [asdict(r) for r in runs]}, indent=2)
    return "\n".join([f"on {device.name}", "", *gpu_lines(runs)])


def gpu_lines(runs: Sequence[GpuRun]) -> list[str]:
    """One line a batch."""
    lines = [
        f"{'unknowns':>8}{'rollouts':>9}{'env-steps/s':>13}{'its':>6}{'most':>6}{'fact.':>7}{'resid.':>8}{'halved':>8}"
        f"{'failed':>8}{'points':>8}{'off the CPU m':>15}"
    ]
    for r in runs:
        lines.append(
            f"{r.unknowns:>8}{r.rollouts:>9}{r.env_steps_per_s:>13.0f}{r.iterations_per_step:>6.1f}"
            f"{r.most_iterations:>6}{r.factorisations_per_step:>7.2f}{r.residuals_per_step:>8.1f}{r.halved:>8}"
            f"{r.failed:>8}{r.most_contacts:>8}{r.off_cpu_m:>15.1e}"
            + ("" if r.window_is_shared else "  factor's window in global memory")
        )
    return lines
