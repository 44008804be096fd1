"""Steps per second of the manipulation scenes of ``config``: every rig with the experiment that it was made for."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.rigs import load_rig
from sim_core.rigs.motion import compile_experiment, load_experiment
from sim_core.scene import build_scene
from sim_core.simulate import simulate, step_times
from sysid.bench.scale import Published

THINSHELLLAB = "Wang et al., Thin-Shell Object Manipulations With Differentiable Physics Simulations, ICLR 2024"

SCENES: tuple[tuple[str, str, Published | None], ...] = (
    (
        "lifting",
        "lift",
        Published("ThinShellLab Lifting, RTX 4060", "runs by github SairajLoke/ThinShellLab", 1.1),
    ),
    ("separating", "separate", None),
    ("separating", "follow", None),
    (
        "folding",
        "fold",
        Published("ThinShellLab Folding, RTX 4060", "runs by github SairajLoke/ThinShellLab", 3.85),
    ),
    ("pick_folding", "pick_fold", None),
    ("forming", "form", Published("ThinShellLab Forming, RTX 4090", THINSHELLLAB, 2.74)),
    ("sliding", "push_off", None),
    ("bouncing", "fall", None),
    ("card_flip", "flip_card", None),
    ("balancing", "balance", None),
    ("balancing", "throw", None),
)
"""Rig, experiment, and what is published for the scene of which it has the sizes."""


@dataclass(frozen=True)
class SceneRun:
    """Figures of one experiment on one rig. ``halvings``: of steps that did not converge at once."""

    rig: str
    experiment: str
    unknowns: int
    steps: int
    steps_per_s: float
    cpu_steps_per_s: float
    iterations_per_step: float
    most_iterations: int
    factorisations_per_step: float
    most_contacts: int
    halvings: int
    smallest_gap_m: float
    published: Published | None = None


def measure_scene(
    rig_name: str, experiment: str, published: Published | None = None, most_steps: int | None = None
) -> SceneRun:
    """Run a scene once. Raises ``ConvergenceError`` when a step does not converge even in parts."""
    rig, plan = load_rig(rig_name), load_experiment(experiment)
    poses = compile_experiment(plan, rig)
    scene = build_scene(rig)
    end = max([plan.duration_s or 0.0, *(p.times[-1] for p in poses.values())])
    times = step_times(0.0, float(end), rig.solver.dt_s)[: None if most_steps is None else most_steps + 1]
    simulate(scene, poses, times[:2])  # kernels are compiled, and what is laid out once a scene is
    cpu, begin = time.process_time(), time.perf_counter()
    reports = simulate(scene, poses, times).reports
    wall, cpu = time.perf_counter() - begin, time.process_time() - cpu
    return SceneRun(
        rig=rig_name,
        experiment=experiment,
        unknowns=scene.system.n_unknowns,
        steps=len(reports),
        steps_per_s=len(reports) / wall,
        cpu_steps_per_s=len(reports) / cpu,
        iterations_per_step=float(np.mean([r.iterations for r in reports])),
        most_iterations=max(r.iterations for r in reports),
        factorisations_per_step=float(np.mean([r.factorisations for r in reports])),
        most_contacts=max(r.contacts for r in reports),
        halvings=sum(r.parts - 1 for r in reports),
        smallest_gap_m=min(r.min_gap_m for r in reports),
        published=published,
    )


def measure_scenes(on_scene: Callable[[SceneRun], None] | None = None) -> tuple[SceneRun, ...]:
    """Run all scenes, one after the other."""
    found = []
    for rig, experiment, published in SCENES:
        found.append(measure_scene(rig, experiment, published))
        if on_scene is not None:
            on_scene(found[-1])
    return tuple(found)


def scene_lines(found: Sequence[SceneRun]) -> list[str]:
    """One line a scene."""
    lines = [
        f"{'scene':<26}{'unknowns':>9}{'steps':>7}{'steps/s':>9}{'CPU':>7}{'its':>6}{'most':>6}{'fact.':>7}"
        f"{'points':>8}{'halved':>8}{'gap um':>8}"
    ]
    for run in found:
        line = (
            f"{run.rig + ' ' + run.experiment:<26}{run.unknowns:>9}{run.steps:>7}{run.steps_per_s:>9.1f}"
            f"{run.cpu_steps_per_s:>7.1f}{run.iterations_per_step:>6.1f}{run.most_iterations:>6}"
            f"{run.factorisations_per_step:>7.1f}{run.most_contacts:>8}{run.halvings:>8}"
            f"{1e6 * run.smallest_gap_m:>8.1f}"
        )
        if run.published is not None:
            times = run.steps_per_s / run.published.steps_per_s
            line += f"  {run.published.name}: {run.published.steps_per_s:g} steps/s, here {times:.2g} times as many"
        lines.append(line)
    return lines
