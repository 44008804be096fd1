"""Single readings of a force sensor that are mistakes: bits lost on the way, electric pulses.

Least squares believes every reading, and one that is 100 noise deviations off counts 10^4 times. A component of a
wrench is looked at in its miss (measured minus predicted). A reading is a spike where it is off the straight line
through the four samples before and the four after by more than :data:`FAR` noise deviations, and by more than
:data:`LONE` times as much as any of these eight: it is sampled once, and nothing goes before or comes after. It is kept
where it may be contact all the same:

- the line is broken: the level afterwards is another, in any component, as when something lands, lets go or slips;
- the prediction has an event there that is a tenth as large;
- as many as :data:`ALIKE_FROM` spikes of the recording push alike, as a body does that bounces.

Ring-downs last for more than one sample, and impacts that a sensor resolves do. What remains in doubt is a lone impact
that is over within one sample and changes nothing; two glitches within four samples of each other are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sysid.observations.observations import Measured

FAR = 10.0
"""Distance, in noise deviations, below which nothing is a spike."""

LONE = 10.0
"""A spike is this many times as far from the line as its neighbours are."""

SIDE = 4
"""Samples before and after that a reading is compared with."""

STEP = 6.0
"""Change of level across a reading, in noise deviations, from which it is an event (its own deviation is 1.7)."""

PREDICTED = 0.1
"""Share of a spike from which an event of the prediction explains it."""

ALIKE, ALIKE_FROM = 0.5, 3
"""Spikes are alike that differ by less than this share of the longer one; as many are no accident."""

_OFFSETS = np.concatenate([np.arange(-SIDE, 0), np.arange(1, SIDE + 1)]).astype(float)


def spikes(measured: Measured, predicted: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Which readings of a wrench are spikes ``(n, 6)``; ``predicted`` ``(n, 6)``, ``sigma`` ``(6,)``: their noise."""
    off, spread, step = _about(measured.values - predicted)
    expected, _, _ = _about(predicted)
    broken = (np.abs(step) > STEP * sigma).any(axis=1, keepdims=True)
    explained = np.abs(expected) > PREDICTED * np.abs(off)
    found = (np.abs(off) > FAR * sigma) & (np.abs(off) > LONE * spread) & ~broken & ~explained
    return np.asarray(found & ~_alike(np.where(found, off / sigma, 0.0))[:, None])


def _about(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each reading ``(n, m)``: distance from the straight line through its neighbours, the largest of their own, and
    the step between the lines before and after. Not finite (the distance and the spread) where a neighbour is missing,
    0 for a step that is not known."""
    edge = np.full((SIDE, values.shape[1]), np.nan)
    window = sliding_window_view(np.concatenate([edge, values, edge]), 2 * SIDE + 1, axis=0)
    about = np.delete(window, SIDE, axis=2)
    level = about.mean(axis=2)
    slope = about @ _OFFSETS / (_OFFSETS @ _OFFSETS)
    spread = np.abs(about - level[:, :, None] - slope[:, :, None] * _OFFSETS).max(axis=2)
    before, after = about[:, :, :SIDE], about[:, :, SIDE:]
    within = _OFFSETS[SIDE:] - _OFFSETS[SIDE:].mean()
    steep = 0.5 * (before + after) @ within / (within @ within)
    step = after.mean(axis=2) - before.mean(axis=2) - (SIDE + 1) * steep
    return values - level, spread, np.nan_to_num(step)


def _alike(off: np.ndarray) -> np.ndarray:
    """Times ``(n,)`` whose spikes ``off`` ``(n, m)`` as many others are like."""
    at = np.flatnonzero(off.any(axis=1))
    vectors = off[at]
    size = np.linalg.norm(vectors, axis=1)
    apart = np.linalg.norm(vectors[:, None] - vectors[None], axis=2)
    out = np.zeros(len(off), dtype=bool)
    out[at] = (apart < ALIKE * np.maximum(size[:, None], size[None])).sum(axis=1) >= ALIKE_FROM
    return out
