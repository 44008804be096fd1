"""When time-stamped poses were taken: at their stamps, or at the ticks of a clock about which the stamps jitter.

A robot controller takes poses at a fixed rate, and a message may be stamped a millisecond later or earlier. A hand that
turns by 1 rad/s has then moved by a milliradian, many times the noise of its encoders, and a curve through such poses
shakes whatever the hand holds. Poses of a smooth motion tell which it is: each is predicted by the cubic through its
four neighbours, at the stamps and at the ticks, and the ticks are taken where they leave less beyond chance (Vuong's
test, Econometrica 57, 1989, on means of five poses, which have neighbours in common). What stamps are off the ticks has
to be jitter: a clock whose rate wanders is off for many ticks in a row, and smooth motions are as smooth along it.

Ticks are counted by the interval between them, which is found from stamps ever farther apart, since the number of
intervals between two of them is known once the interval is to within half of one over that number. Stamp i is of tick
i + m_i where m_i, the ticks without a pose before it, never falls: the least-squares monotone m_i, rounded.
"""

from __future__ import annotations

import numpy as np

from sim_core.rigs.fields import FloatArray

FEWEST_TICKS = 40
"""Poses from which a clock is looked for."""

CHANCE = 1e-3
"""Chance at which a test says what is not so."""

BLOCK = 20
"""Stamps in a row of which the mean says whether a clock wanders."""

STAMP_ROUNDING_S = 1e-6
"""Difference [s] of stamps and ticks that is rounding: drivers write microseconds."""


def taken_at(times: FloatArray, positions: FloatArray, quaternions: FloatArray) -> FloatArray:
    """Times [s] ``(n,)`` at which poses with the stamps ``times``, of ``positions`` ``(n, 3)`` and ``quaternions``
    ``(n, 4)``, were taken: the stamps, or the ticks of the clock through them, of which some may have no pose. The
    first and the last span no less than the stamps: what was measured between these is not outside of all poses."""
    from scipy.special import ndtri

    if len(times) < FEWEST_TICKS:
        return times
    ticks = _ticks(times)
    interval, first = np.polyfit(ticks, times, 1)
    regular = np.asarray(first + interval * ticks)
    if np.abs(regular - times).max() <= STAMP_ROUNDING_S or _wanders(times - regular):
        return times
    more = np.zeros(len(times) - 4)
    for values in (positions, quaternions):
        by_stamps, by_clock = (_unpredicted(at, values) for at in (times, regular))
        more += (by_stamps - by_clock) / max(float(np.mean(by_stamps + by_clock)), 1e-300)
    blocks = np.array([part.mean() for part in np.array_split(more, len(more) // 5)])
    if not blocks.mean() > -ndtri(CHANCE) * blocks.std(ddof=1) / np.sqrt(len(blocks)):
        return times
    regular[0], regular[-1] = min(regular[0], times[0]), max(regular[-1], times[-1])
    return regular


def _ticks(times: FloatArray) -> FloatArray:
    """Which tick each stamp is of ``(n,)``, counted from the first."""
    from scipy.optimize import isotonic_regression

    n, apart = len(times), 1
    interval = float(np.median(np.diff(times)))
    while apart < n // 2:
        away = times[apart:] - times[:-apart]
        interval = float(np.median(away / np.maximum(np.round(away / interval), 1.0)))
        apart *= 2
    phase = float(np.angle(np.mean(np.exp(2j * np.pi * (times - times[0]) / interval)))) / (2.0 * np.pi)
    lost = (times - times[0]) / interval - phase - np.arange(n)
    ticks = np.arange(n) + np.round(isotonic_regression(lost).x)
    return np.asarray(ticks - ticks[0])


def _wanders(off: FloatArray) -> bool:
    """Whether means of stamps in a row are off the ticks by more than jitter makes them."""
    from scipy.special import chdtri

    blocks = off[: len(off) // BLOCK * BLOCK].reshape(-1, BLOCK)
    jitter = float(np.mean(blocks.var(axis=1, ddof=1)))
    squares = BLOCK * float(np.sum(blocks.mean(axis=1) ** 2))
    return squares > float(chdtri(len(blocks), CHANCE)) * jitter


def _unpredicted(times: FloatArray, values: FloatArray) -> FloatArray:
    """Squares ``(n - 4,)`` of what cubics through four neighbours miss of values ``(n, m)``, in units of the variance
    that white noise of unit variance has there."""
    at = np.arange(2, len(times) - 2)
    near = at[:, None] + np.array([-2, -1, 1, 2])
    t, own = times[near], times[at]
    weights = np.ones(t.shape)
    for j in range(4):
        for m in range(4):
            if m != j:
                weights[:, j] *= (own - t[:, m]) / (t[:, j] - t[:, m])
    missed = values[at] - (weights[..., None] * values[near]).sum(axis=1)
    return np.asarray((missed**2).sum(axis=1) / (1.0 + (weights**2).sum(axis=1)))
