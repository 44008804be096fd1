"""Residual over noise, by channel and by time, as strips of colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from sysid.report.numbers import TIMES, shown_unit, significant

if TYPE_CHECKING:
    from sysid.fit.result import ChannelError, Series

LEVELS = (1.5, 3.0, 6.0, 12.0, 25.0)
"""Edges between the colours, as root-mean-square residual over noise."""

BINS = 80
"""Cells of a strip."""


@dataclass(frozen=True)
class Cell:
    """A stretch of one colour. ``start``, ``width``: in cells; ``level``: 0 for noise, 5 for the worst."""

    start: int
    width: int
    level: int


@dataclass(frozen=True)
class Strip:
    """One channel and quantity over the time of a run. ``before``: None where there is only one model;
    ``words``: the largest residual, for those who do not see the colours."""

    label: str
    before: list[Cell] | None
    after: list[Cell]
    words: str


def noise_of(errors: Sequence[ChannelError], series: Series) -> float | None:
    """Noise [unit of the series] of the channel that a series belongs to, None where it is not known."""
    fitting = [e for e in errors if e.channel == series.channel and shown_unit(e.unit) == shown_unit(series.unit)]
    fitting.sort(key=lambda e: (e.run != series.run, e.held_out != series.held_out))
    for e in fitting:
        if e.noise is not None and np.isfinite(e.noise) and e.noise > 0.0:
            return float(e.noise)
    return None


def residual_strips(columns: Sequence[Series], errors: Sequence[ChannelError], both: bool) -> list[Strip]:
    """Strips of one run, a row for each channel and quantity that has a known noise."""
    begin = min(float(s.t[0]) for s in columns)
    end = max(float(s.t[-1]) for s in columns)
    rows: dict[tuple[str, str], list[Series]] = {}
    for s in columns:
        rows.setdefault((s.channel, s.unit), []).append(s)
    quantities = {(e.channel, shown_unit(e.unit)): e.quantity for e in errors}
    out = []
    for (channel, unit), members in rows.items():
        noise = noise_of(errors, members[0])
        if noise is None:
            continue
        after = _binned(members, False, noise, begin, end)
        if not np.isfinite(after).any():
            continue
        worst = int(np.nanargmax(after))
        at = begin + (worst + 0.5) * (end - begin) / BINS
        quantity = quantities.get((channel, shown_unit(unit)), "")
        out.append(
            Strip(
                f"{channel} {quantity}".strip(),
                _cells(_binned(members, True, noise, begin, end)) if both else None,
                _cells(after),
                f"at most {significant(float(after[worst]), 2)}{TIMES} at {significant(at, 2)} s",
            )
        )
    return out


def _binned(members: Sequence[Series], before: bool, noise: float, begin: float, end: float) -> np.ndarray:
    """Root-mean-square residual over noise in each cell, NaN where nothing was measured."""
    total, number = np.zeros(BINS), np.zeros(BINS)
    width = (end - begin) or 1.0
    for s in members:
        measured = np.array([np.nan if v is None else v for v in s.measured], dtype=float)
        predicted = np.array([np.nan if v is None else v for v in (s.before if before else s.after)], dtype=float)
        r = (measured - predicted) / noise
        good = np.isfinite(r)
        cell = np.clip(((np.asarray(s.t) - begin) / width * BINS).astype(int), 0, BINS - 1)[good]
        np.add.at(total, cell, r[good] ** 2)
        np.add.at(number, cell, 1.0)
    out = np.full(BINS, np.nan)
    has = number > 0
    out[has] = np.sqrt(total[has] / number[has])
    # Channels slower than the cells would leave gaps: a cell between two samples shows the earlier one.
    filled = np.flatnonzero(has)
    for a, b in pairwise(filled.tolist()):
        if b - a <= max(2, 3 * BINS // max(len(filled), 1)):
            out[a + 1 : b] = out[a]
    return out


def _cells(values: np.ndarray) -> list[Cell]:
    levels = np.where(np.isfinite(values), np.searchsorted(LEVELS, np.nan_to_num(values), side="right"), -1)
    edges = np.flatnonzero(np.diff(levels)) + 1
    starts = [0, *edges.tolist()]
    stops = [*edges.tolist(), len(levels)]
    return [Cell(a, b - a, int(levels[a])) for a, b in zip(starts, stops, strict=True) if levels[a] >= 0]
