"""The figures as text or as JSON."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import asdict

from sim_core.errors import ConfigError
from sysid.bench.forming import Benchmark, measure, measure_side_by_side
from sysid.bench.machine import machine_name
from sysid.bench.scale import MESHES, Scaling, Size, measure_scaling, measure_sizes
from sysid.bench.scenes import SceneRun, measure_scenes, scene_lines

PUBLISHED = "Published: on their authors' machines, with their scenes; only the number of unknowns is the same."


def run_benchmarks(
    as_json: bool = False,
    quick: bool = False,
    scenes: bool = False,
    on_scene: Callable[[SceneRun], None] | None = None,
) -> str:
    """Measure, and say it. ``quick``: the forming rig in one process only; ``scenes``: only the scenes, and the sizes
    of published simulations. ``on_scene`` is called after each scene."""
    if quick and scenes:
        raise ConfigError("--quick and --scenes each leave out what the other measures.", "Give one of the two.")
    if scenes:
        runs = measure_scenes(on_scene)
        sizes = tuple(measure_sizes([mesh for mesh in MESHES if mesh.published is not None]))
        if as_json:
            figures = {"scenes": [asdict(r) for r in runs], "published_sizes": [asdict(s) for s in sizes]}
            return json.dumps({**machine(), **figures}, indent=2)
        return "\n".join([machine_line(), "", *scene_lines(runs), "", *size_lines(sizes), PUBLISHED])
    forming = measure()
    if quick:
        return json.dumps(asdict(forming), indent=2) if as_json else "\n".join(forming_lines(forming))
    threads, together = measure_side_by_side()
    scaling, runs = measure_scaling(), measure_scenes(on_scene)
    if as_json:
        found = {
            **asdict(forming),
            "side_by_side": {"threads": threads, "steps_per_s": together},
            "scaling": asdict(scaling),
            "scenes": [asdict(r) for r in runs],
        }
        return json.dumps(found, indent=2)
    side = f"{threads} threads side by side: {together:.1f} steps/s together"
    return "\n".join([*forming_lines(forming), "", side, "", *scaling_lines(scaling), "", *scene_lines(runs)])


def machine() -> dict[str, str | int]:
    """What it was measured on."""
    return {"machine": machine_name(), "cores": os.cpu_count() or 1, "python": platform.python_version()}


def machine_line() -> str:
    return "on {machine}, {cores} cores (one used), Python {python}".format(**machine())


def forming_lines(found: Benchmark) -> list[str]:
    return [
        f"{found.rig}: {found.unknowns} unknowns, {found.steps} steps of which {found.contact_steps} in contact "
        f"(at most {found.most_contacts} points), all converged",
        f"{found.steps_per_s:.1f} steps/s ({found.cpu_steps_per_s:.1f} per second of CPU); a step takes "
        f"{found.iterations_per_step:.1f} Newton iterations and {found.factorisations_per_step:.1f} factorisations",
        f"start-up: {found.build_s:.1f} s to build the scene, {found.settle_s:.1f} s to the first equilibrium and step",
        f"path: {found.path}",
        machine_line(),
    ]


def scaling_lines(found: Scaling) -> list[str]:
    title = f"ball on a card, one core: processor time of a step ~ unknowns^{found.exponent:.2f}"
    return [title, *size_lines(found.sizes), PUBLISHED]


def size_lines(sizes: Sequence[Size]) -> list[str]:
    lines = [
        f"{'unknowns':>9}{'s/step':>9}{'CPU s':>9}{'steps/s':>9}{'its':>6}{'fact.':>6}{'points':>8}{'peak MB':>9}",
    ]
    for size in sizes:
        line = (
            f"{size.unknowns:>9}{size.step_s:>9.3f}{size.cpu_step_s:>9.3f}{1.0 / size.step_s:>9.2f}"
            f"{size.iterations_per_step:>6.1f}{size.factorisations_per_step:>6.1f}{size.contacts:>8}"
            f"{size.peak_memory_mb:>9.0f}"
        )
        if size.published is not None:
            theirs = size.published.steps_per_s
            times = 1.0 / (size.step_s * theirs)
            line += f"  {size.published.name}: {theirs:g} steps/s, here {times:.2g} times as many"
        lines.append(line)
    return lines
