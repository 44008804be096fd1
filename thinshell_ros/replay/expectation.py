"""What one sensor is expected to read while a trajectory is replayed, and what is odd about what it reads. No ROS.

Readings are compared as changes since before the replay, so that an offset of the sensor is none of its faults. A robot
may be behind its commands and a reading older than its stamp, so a reading is held against all that is predicted within
the time from which it can be.

A prediction is made in steps of time, and its stamps are known to half a step. What follows its cause with a relaxation
time tau, x' = f - x / tau, has the error e of implicit Euler with steps h to first order in h (modified equation;
Hairer, Lubich and Wanner, Geometric Numerical Integration, sec. IX.1):

    e' = -e / tau + h/2 x'',  e(t) = h/2 (x'(t) - <x'>),

<x'>: the mean of x' until t with weights exp(-(t - s) / tau) / tau, which sum up to 1 at most. So |e| is at most h/2
times the range of the rates until t, 0 among them, whatever tau is: what moves on at v is v h/2 off. Between samples
g apart a kink of the rate by r is missed by g/4 r at most.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from sim_core.trajectories.expected import Band

TABLE_S = 0.002
"""Interval [s] of the table of what is expected, ..."""

MAX_VALUES = 2_000_000
"""... and most values in it: it is coarser for many markers and long replays."""

BASELINE = 32
"""Readings before a replay, at most, of which the mean is what changes are counted from."""


class Expectation:
    """The bounds of one sensor's readings ``(c,)`` at each time of a trajectory [s].

    ``within_s``: a reading may belong to any time so far back; ``slack``: whether all that a model may err is allowed
    for, or only what its steps of time make.
    """

    def __init__(self, band: Band, within_s: float, slack: bool, step_s: float | None = None) -> None:
        """``step_s``: of the simulation that predicted [s]; None where that is not known: the samples are its steps."""
        end = float(band.times[-1])
        count = min(max(math.ceil(end / TABLE_S), 1), max(MAX_VALUES // band.mean.shape[1], len(band.times)))
        self._step = end / count
        times = np.linspace(0.0, end, count + 1)
        self.mean = _interpolated(times, band.times, band.mean - band.mean[0])
        spread = _interpolated(times, band.times, band.spread) + band.spread[0]
        model = np.broadcast_to(band.slack, band.mean.shape) if slack else in_steps(band, step_s)
        spread = spread + _interpolated(times, band.times, model)
        size = math.ceil(within_s / self._step) + 2
        self.upper = _lagged(maximum_filter1d, self.mean + spread, size)
        self.lower = _lagged(minimum_filter1d, self.mean - spread, size)
        self.noise = band.noise
        self.slack = band.slack
        self._before: list[np.ndarray] = []
        self.baseline: np.ndarray | None = None

    def take_before(self, values: np.ndarray) -> None:
        """A reading before the replay, or while nothing has moved."""
        self._before = [*self._before[-(BASELINE - 1) :], values]

    def begin(self) -> None:
        """Changes are counted from what was read before; without any, from the first reading."""
        self.baseline = self._mean(self._before)
        self._count = max(len(self._before), 1)

    @staticmethod
    def _mean(readings: list[np.ndarray]) -> np.ndarray | None:
        if not readings:
            return None
        stacked = np.stack(readings)
        known = np.isfinite(stacked)
        counts = known.sum(axis=0)
        sums = np.where(known, stacked, 0.0).sum(axis=0)
        return np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)

    def change(self, values: np.ndarray) -> np.ndarray:
        """A reading as a change since before the replay ``(c,)``; NaN where there was no reading before."""
        if self.baseline is None:
            self.baseline, self._count = values, 1
        return np.asarray(values - self.baseline)

    def excess(self, change: np.ndarray, time_s: float) -> np.ndarray:
        """By how much a change is beyond what is expected at a time ``(c,)``: 0 or less where it is not."""
        row = self.row(time_s)
        noise = self.noise * math.sqrt(1.0 + 1.0 / self._count)
        return np.asarray(np.maximum(change - self.upper[row], self.lower[row] - change) - noise)

    def row(self, time_s: float) -> int:
        """Number of the row of a time, from which on bounds hold until the next one."""
        return int(min(max(math.ceil(time_s / self._step - 1e-6), 0), len(self.upper) - 1))

    def expected(self, time_s: float) -> np.ndarray:
        """Predicted change at a time ``(c,)``."""
        return np.asarray(self.mean[self.row(time_s)])


def in_steps(band: Band, step_s: float | None) -> np.ndarray:
    """Error of a prediction by the steps [s] in which it was made and by the intervals of its samples ``(n, c)``."""
    apart = np.diff(band.times)
    rates = np.diff(band.mean, axis=0) / apart[:, None]
    rates = np.concatenate([np.zeros_like(rates[:1]), rates])
    highest, lowest = (kind.accumulate(rates, axis=0) for kind in (np.maximum, np.minimum))
    # A sample bounds the interval that begins with it, too.
    span = np.concatenate([(highest - lowest)[1:], (highest - lowest)[-1:]])
    gap = float(apart.max())
    return np.asarray((0.5 * (gap if step_s is None else step_s) + 0.25 * gap) * span)


def _interpolated(times: np.ndarray, given: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(times, given, column) for column in values.T])


def _lagged(kind: Callable[..., np.ndarray], values: np.ndarray, size: int) -> np.ndarray:
    """Largest or least value within ``size`` rows, of which each row is the last."""
    padded = np.concatenate([np.repeat(values[:1], size, axis=0), values])
    filtered = kind(padded, size=size, axis=0, mode="nearest")
    # scipy centres windows: [k - size // 2, k - size // 2 + size - 1]. The wanted one ends with k.
    at = np.arange(len(values)) + size - (size - 1 - size // 2)
    return np.asarray(filtered[at])


class Repeats:
    """Readings that repeat each other exactly, which a sensor with noise does not do for long.

    With a share p of repeats before the replay (of n pairs, (r + 1) / (n + 2)) k repeats in a row have the probability
    p^k; from :data:`UNLIKELY` on the sensor is taken to have stopped.
    """

    UNLIKELY = 1e-9

    def __init__(self) -> None:
        self._pairs = self._same = 0
        self._last: np.ndarray | None = None
        self.count = 0
        """Repeats in a row, up to now."""
        self.since_s = 0.0
        """Time [s] of the trajectory of the first of them."""

    def take(self, values: np.ndarray, time_s: float, running: bool) -> None:
        """A reading has come."""
        same = self._last is not None and bool(np.array_equal(values, self._last, equal_nan=True))
        if self._last is not None and not running:
            self._pairs, self._same = self._pairs + 1, self._same + same
        if same:
            self.count += 1
        else:
            self.count, self.since_s = 0, time_s
        self._last = values

    def begin(self) -> None:
        """A replay begins: repeats before it do not count as its own."""
        self.count, self.since_s = 0, -math.inf

    def stopped(self) -> bool:
        """Whether so many repeats are too unlikely."""
        share = (self._same + 1) / (self._pairs + 2)
        return self._pairs >= 2 and self.count > 0 and share**self.count < self.UNLIKELY
