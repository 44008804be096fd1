"""A picture of how searches went: the best reward so far against rollouts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import IO

from sim_core.tasks import MadeTask

Curve = Sequence[tuple[int, float, str]]
"""Rollouts, best fitness so far, and what the method was doing."""


def draw_curves(to: Path | IO[bytes], curves: Sequence[tuple[str, Curve]], made: MadeTask) -> None:
    """Draw labelled curves of searches for one task as a PNG. Rollouts that ended early are not drawn."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.5, 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for label, curve in curves:
        points = [(count, best) for count, best, _ in curve if best > -1e8]
        if points:
            axes.step(*zip(*points, strict=True), where="post", label=label, linewidth=1.2)
    axes.axhline(made.variant.success, color="0.4", linewidth=0.8, linestyle="--", label="success from here on")
    axes.set_xlabel("rollouts")
    axes.set_ylabel("best reward so far")
    axes.set_title(made.name, fontsize=9)
    axes.legend(fontsize=8)
    figure.savefig(to, dpi=130, format="png")
