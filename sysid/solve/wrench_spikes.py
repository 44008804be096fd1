"""Single readings of a force sensor that are mistakes: bits lost on the way, electric pulses.

Least squares trusts every reading, and one that is 100 noise deviations off counts 10^4 times. A component of a
wrench is looked at in its miss (measured minus predicted). A reading is a spike where it is off the straight line
through the samples before and after (``SOLVE.spike_side_samples`` each) by more than ``SOLVE.spike_sd`` noise
deviations, and by more than ``SOLVE.lone_spike_ratio`` times as much as any of these: it is sampled once, and nothing
goes before or comes after. It is kept where it may be contact all the same:

- the line is broken: the level afterwards is another, in any component, as when something lands, lets go or slips;
- the prediction has an event there that is a tenth as large;
- as many as ``SOLVE.alike_spikes`` spikes of the recording push alike, as a body does that bounces.

Ring-downs last for more than one sample, and impacts that a sensor resolves do. What remains in doubt is a lone impact
that is over within one sample and changes nothing; two glitches within four samples of each other are kept.
"""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sysid.observations.observations import Measured
from sysid.settings.solve import SOLVE

_OFFSETS = np.concatenate([np.arange(-SOLVE.spike_side_samples, 0), np.arange(1, SOLVE.spike_side_samples + 1)]).astype(
    float
)


def spikes(measured: Measured, predicted: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """Which readings of a wrench are spikes ``(n, 6)``; ``predicted`` ``(n, 6)``, ``sigma`` ``(6,)``: their noise."""
    off, spread, step = _about(measured.values - predicted)
    expected, _, _ = _about(predicted)
    broken = (np.abs(step) > SOLVE.level_change_sd * sigma).any(axis=1, keepdims=True)
    explained = np.abs(expected) > SOLVE.predicted_spike_share * np.abs(off)
    found = (
        (np.abs(off) > SOLVE.spike_sd * sigma) & (np.abs(off) > SOLVE.lone_spike_ratio * spread) & ~broken & ~explained
    )
    return np.asarray(found & ~_alike(np.where(found, off / sigma, 0.0))[:, None])


def _about(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each reading ``(n, m)``: distance from the straight line through its neighbours, the largest of their own, and
    the step between the lines before and after. Not finite (the distance and the spread) where a neighbour is missing,
    0 for a step that is not known."""
    edge = np.full((SOLVE.spike_side_samples, values.shape[1]), np.nan)
    window = sliding_window_view(np.concatenate([edge, values, edge]), 2 * SOLVE.spike_side_samples + 1, axis=0)
    about = np.delete(window, SOLVE.spike_side_samples, axis=2)
    level = about.mean(axis=2)
    slope = about @ _OFFSETS / (_OFFSETS @ _OFFSETS)
    spread = np.abs(about - level[:, :, None] - slope[:, :, None] * _OFFSETS).max(axis=2)
    before, after = about[:, :, : SOLVE.spike_side_samples], about[:, :, SOLVE.spike_side_samples :]
    within = _OFFSETS[SOLVE.spike_side_samples :] - _OFFSETS[SOLVE.spike_side_samples :].mean()
    steep = 0.5 * (before + after) @ within / (within @ within)
    step = after.mean(axis=2) - before.mean(axis=2) - (SOLVE.spike_side_samples + 1) * steep
    return values - level, spread, np.nan_to_num(step)


def _alike(off: np.ndarray) -> np.ndarray:
    """Times ``(n,)`` whose spikes ``off`` ``(n, m)`` as many others are like."""
    at = np.flatnonzero(off.any(axis=1))
    vectors = off[at]
    size = np.linalg.norm(vectors, axis=1)
    apart = np.linalg.norm(vectors[:, None] - vectors[None], axis=2)
    out = np.zeros(len(off), dtype=bool)
    out[at] = (apart < SOLVE.alike_spike_share * np.maximum(size[:, None], size[None])).sum(
        axis=1
    ) >= SOLVE.alike_spikes
    return out
