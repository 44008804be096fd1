"""When time-stamped poses were taken: at their stamps, or at the ticks of a clock about which the stamps jitter.

A robot controller takes poses at a fixed rate, and a message may be stamped a millisecond later or earlier. A hand that
turns by 1 rad/s has then moved by a milliradian, many times the noise of its encoders, and a curve through such poses
shakes whatever the hand holds. Poses of a smooth motion tell which it is: each is predicted by the cubic through its
four neighbours, at the stamps and at the ticks, and the times that leave less are taken.
"""

from __future__ import annotations

import numpy as np

from sim_core.rigs.fields import FloatArray

FEWEST_TICKS = 20
"""Poses from which a clock is looked for."""


def taken_at(times: FloatArray, positions: FloatArray, quaternions: FloatArray) -> FloatArray:
    """Times [s] ``(n,)`` at which poses with the stamps ``times``, of ``positions`` ``(n, 3)`` and ``quaternions``
    ``(n, 4)``, were taken: the stamps, or the ticks of the clock through them, of which some may have no pose. The
    first and the last span no less than the stamps: what was measured between these is not outside of all poses."""
    n = len(times)
    if n < FEWEST_TICKS:
        return times
    steps = np.diff(times)
    ticks = np.concatenate([[0.0], np.cumsum(np.maximum(np.round(steps / np.median(steps)), 1.0))])
    regular = np.polyval(np.polyfit(ticks, times, 1), ticks)
    left = [_unpredicted(at, values) for values in (positions, quaternions) for at in (regular, times)]
    by_clock, by_stamps = (np.log(np.maximum(left[k::2], 1e-300)).sum() for k in (0, 1))
    if by_clock >= by_stamps:
        return times
    regular[0], regular[-1] = min(regular[0], times[0]), max(regular[-1], times[-1])
    return regular


def _unpredicted(times: FloatArray, values: FloatArray) -> float:
    """Mean square of what cubics through four neighbours miss of values ``(n, m)``, in units of the variance that white
    noise of unit variance has there."""
    at = np.arange(2, len(times) - 2)
    near = at[:, None] + np.array([-2, -1, 1, 2])
    t, own = times[near], times[at]
    weights = np.ones(t.shape)
    for j in range(4):
        for m in range(4):
            if m != j:
                weights[:, j] *= (own - t[:, m]) / (t[:, j] - t[:, m])
    missed = values[at] - (weights[..., None] * values[near]).sum(axis=1)
    return float(np.mean((missed**2).sum(axis=1) / (1.0 + (weights**2).sum(axis=1))))
