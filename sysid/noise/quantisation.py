"""The steps in which a sensor reads, from its readings.

A converter with few bits, or a file with few digits, rounds every reading to a multiple of a step, counted from the
tare of its column. At rest such a reading may not change at all, and nothing but the step tells how far it can be off:
step / sqrt(12), the standard deviation of what is uniform within one step.

A step is looked for column by column, since each has a tare of its own. It is the smallest difference of the values
that a column reads, or of those that it reads more than once, so that single values which were interpolated do not
hide it. Such a difference there always is. It is a step where readings in a row are multiples of it, which three
readings of a sensor without steps are once in a thousand times, and where they go up or down by different numbers of
steps: what a simulator without noise reads of an even motion is made of multiples of what it does in one sample.
"""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median_high

import numpy as np

from sysid.settings.noise import NOISE


def common_step(columns: Iterable[np.ndarray]) -> float:
    """Step of columns of a kind ``(n,)`` of one sensor, of all recordings of it, in their units; 0 where it has none.

    The median of those columns that change: a sensor has one step, and neither a recording that was smoothed nor a
    column of few readings that happens to show another one decides. Of two in the middle the larger one counts.
    """
    found = [step for step in map(step_of, columns) if step is not None]
    return median_high(found) if found else 0.0


def step_of(values: np.ndarray) -> float | None:
    """Step of one column ``(n,)``, NaN where missing; 0 where it has none, None where it does not change enough to
    tell."""
    values = values[np.isfinite(values)]
    order = np.argsort(values, kind="stable")
    rises = np.diff(values[order], prepend=values[order[:1]]) > NOISE.same_value_share * np.max(
        np.abs(values), initial=0.0
    )
    level = np.empty(len(values), dtype=int)
    level[order] = np.cumsum(rises)
    changes = np.diff(level) != 0
    if np.count_nonzero(changes) < NOISE.fewest_changes:
        return None
    count = np.bincount(level)
    levels = np.bincount(level, values) / count
    step = 0.0
    for known in (levels, levels[count > 1]):
        apart = np.diff(known)
        if not len(apart):
            continue
        least = float(np.mean(apart[apart < (1.0 + NOISE.multiple_tolerance) * apart.min()]))
        multiple = ((levels - levels[np.argmax(count)]) / least)[level]
        whole = np.rint(multiple)
        on = np.abs(multiple - whole) < NOISE.multiple_tolerance
        by = np.abs(np.diff(whole))
        uneven = np.count_nonzero((by[1:] != by[:-1]) & on[2:] & on[1:-1] & on[:-2])
        if uneven >= max(NOISE.fewest_changes, NOISE.uneven_triples_share * np.count_nonzero(changes)):
            step = max(step, least)
    return step
