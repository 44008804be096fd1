"""The page of a table of tasks by methods: one file with the table, curves, and an animation of the best motion."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

from sim_core.optimise.run import TRACE
from sim_core.rigs import load_rig
from sim_core.tasks.load import MadeTask, load_task
from sysid.bench.tasks import HEADS, Row, cells, results_of, run_folder
from sysid.progress.callback import Progress
from sysid.report.optimisation_curve import draw_curves
from sysid.report.page import embedded_json, write_page
from sysid.show.animation import animate
from sysid.show.colouring import chosen, colourings
from sysid.show.subject import of_trace

PAGE = "table.html"
MOTION = "motion.gif"


def write_benchmark_page(
    folder: Path, tasks: Sequence[str], methods: Sequence[str], rows: Sequence[Row], say: Progress
) -> Path:
    """Write the page of a table into its folder. Animations that are there already are not made again."""
    seeds = rows[0].seeds if rows else 0
    sections = []
    for number, name in enumerate(tasks):
        made = load_task(name)
        own = [row for row in rows if row.task == made.name]

        def tell(share: float, words: str, at: int = number, what: str = name) -> None:
            say((at + share) / len(tasks), f"{what}: {words}")

        sections.append(_section(folder, made, methods, own, seeds, tell))
    return write_page(
        "benchmark.html.j2",
        folder / PAGE,
        level="",
        heads=HEADS,
        rows=[cells(row) for row in rows],
        tasks=sections,
        made=sum(row.made for row in rows),
        wanted=sum(row.seeds for row in rows),
        provenance={"versions": [("thinshell_ros", version("thinshell_ros"))]},
        data=embedded_json([dict(zip(HEADS, cells(row), strict=True)) for row in rows]),
    )


def _section(
    folder: Path,
    made: MadeTask,
    methods: Sequence[str],
    rows: Sequence[Row],
    seeds: int,
    say: Progress,
) -> dict[str, Any]:
    runs = [
        (method, result, run_folder(folder, made, method, seed))
        for method in methods
        for seed, result in enumerate(results_of(folder, made, method, seeds))
    ]
    found: dict[str, Any] = {
        "anchor": made.name.replace(":", "-"), "name": made.name, "title": made.task.title,
        "words": made.variant.words, "least": f"{made.variant.success:g}", "curve": "", "motion": "", "run": "",
        "failures": [f"{row.method}: {words}" for row in rows for words in row.failures],
    }  # fmt: skip
    if runs:
        curves = [(f"{method} {place.name[-1]}", result["curve"]) for method, result, place in runs]
        buffer = io.BytesIO()
        draw_curves(buffer, curves, made)
        found["curve"] = _embedded(buffer.getvalue(), "png")
    shown = [run for run in runs if (run[2] / TRACE).exists()]
    if shown:
        best = max(shown, key=lambda run: (run[1]["success"], run[1]["reward"]))
        found["motion"] = _embedded(_motion(best[2], say), "gif")
        found["run"] = f"{best[2].name}: {'success' if best[1]['success'] else 'no success'}"
    return found


def _motion(place: Path, say: Progress) -> bytes:
    """The animation of a run, made where it is not there yet."""
    path, trace = place / MOTION, place / TRACE
    if not path.exists() or path.stat().st_mtime < trace.stat().st_mtime:
        subject = of_trace(load_rig(str(place / "rig.yaml")), trace)
        animate(subject, chosen(subject, colourings(subject), None), path, say)
    return path.read_bytes()


def _embedded(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
