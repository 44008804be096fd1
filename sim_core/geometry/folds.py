"""Sheets that are folded or curved at rest: a flat mesh bent about lines across its length, without stretch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.errors import ConfigError

MOST_AT_A_LINE = np.deg2rad(150.0)
"""Largest angle between neighbouring strips [rad]: beyond, a hinge is near the end of what it can measure."""


@dataclass(frozen=True)
class Fold:
    """A bend about a line along y at ``at`` [m] by ``angle`` [rad], towards +z what lies beyond (larger x).

    ``over``: arc length [m] over which the angle is spread evenly; 0 for a crease.
    """

    at: float
    angle: float
    over: float = 0.0


def folded(nodes: np.ndarray, lines: np.ndarray, folds: Sequence[Fold]) -> np.ndarray:
    """Positions [m] ``(n, 3)`` of the nodes of a flat mesh when the sheet is folded; the end of least x stays.

    ``lines``: places along x [m], ascending, from the first to the last, where lines of edges cross the whole sheet.
    The strips between them stay flat and turn against each other by what each line has of the folds: of an arc,
    the share between the middles of the two strips that meet there. So no triangle is stretched.
    """
    turns = np.zeros(len(lines) - 2)
    bounds = np.concatenate([[lines[0]], 0.5 * (lines[1:-2] + lines[2:-1]), [lines[-1]]])
    for fold in folds:
        if fold.over > 0.0:
            inside = np.clip(bounds, fold.at - 0.5 * fold.over, fold.at + 0.5 * fold.over)
            turns += fold.angle * np.diff(inside) / fold.over
        else:
            turns[int(np.argmin(np.abs(lines[1:-1] - fold.at)))] += fold.angle
    if np.abs(turns).max(initial=0.0) > MOST_AT_A_LINE:
        raise ConfigError(
            f"The folds of a sheet turn neighbouring cells by {np.rad2deg(np.abs(turns).max()):.0f} deg against each "
            f"other, more than {np.rad2deg(MOST_AT_A_LINE):.0f}.",
            "Spread them over a longer arc (over_m), or give the sheet more cells along its length.",
        )
    heading = np.concatenate([[0.0], np.cumsum(turns)])
    along, up = np.cos(heading), np.sin(heading)
    widths = np.diff(lines)
    x = np.concatenate([[lines[0]], lines[0] + np.cumsum(widths * along)])
    z = np.concatenate([[0.0], np.cumsum(widths * up)])
    return np.column_stack([np.interp(nodes[:, 0], lines, x), nodes[:, 1], np.interp(nodes[:, 0], lines, z)])
