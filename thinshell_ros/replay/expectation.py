"""What one sensor is expected to read while a trajectory is replayed, and what is odd about what it reads. No ROS.

Readings are compared as changes since before the replay, so that an offset of the sensor is none of its faults. A robot
may be behind its commands and a reading older than its stamp, so a reading is held against all that is predicted within
the time from which it can be.
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


class Table:
    """Even times [s] from 0 to the end of a trajectory, and values at them."""

    def __init__(self, band: Band) -> None:
        end = float(band.times[-1])
        count = min(max(math.ceil(end / TABLE_S), 1), max(MAX_VALUES // band.mean.shape[1], len(band.times)))
        self.step_s = end / count
        self._given, self._times = band.times, np.linspace(0.0, end, count + 1)

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values ``(n, c)`` at the times of the band, at those of the table."""
        return np.column_stack([np.interp(self._times, self._given, column) for column in values.T])

    def row(self, time_s: float) -> int:
        """Number of the row of a time, from which on its values hold until the next one."""
        return int(min(max(math.ceil(time_s / self.step_s - 1e-6), 0), len(self._times) - 1))


class Changes:
    """Readings ``(c,)`` as changes since before a replay."""

    def __init__(self) -> None:
        self._before: list[np.ndarray] = []
        self.baseline: np.ndarray | None = None
        self.count = 1
        """Number of readings that changes are counted from."""

    def take_before(self, values: np.ndarray) -> None:
        """A reading before the replay, or while nothing has moved."""
        self._before = [*self._before[-(BASELINE - 1) :], values]

    def begin(self) -> None:
        """Changes are counted from what was read before; without any, from the first reading."""
        self.baseline = self._mean_of(self._before)
        self.count = max(len(self._before), 1)

    @staticmethod
    def _mean_of(readings: list[np.ndarray]) -> np.ndarray | None:
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
            self.baseline, self.count = values, 1
        return np.asarray(values - self.baseline)


class Expectation(Changes):
    """The bounds of one sensor's readings ``(c,)`` at each time of a trajectory [s], with all that a model may err.

    ``within_s``: a reading may belong to any time so far back.
    """

    def __init__(self, band: Band, within_s: float) -> None:
        super().__init__()
        self._table = Table(band)
        self.mean = self._table.of(band.mean - band.mean[0])
        spread = self._table.of(band.spread + band.slack) + band.spread[0]
        size = math.ceil(within_s / self._table.step_s) + 2
        self.upper = lagged(maximum_filter1d, self.mean + spread, size)
        self.lower = lagged(minimum_filter1d, self.mean - spread, size)
        self.noise = band.noise
        self.slack = band.slack

    def excess(self, change: np.ndarray, time_s: float) -> np.ndarray:
        """By how much a change is beyond what is expected at a time ``(c,)``: 0 or less where it is not."""
        row = self._table.row(time_s)
        noise = self.noise * math.sqrt(1.0 + 1.0 / self.count)
        return np.asarray(np.maximum(change - self.upper[row], self.lower[row] - change) - noise)

    def row(self, time_s: float) -> int:
        """Number of the row of bounds at a time."""
        return self._table.row(time_s)

    def expected(self, time_s: float) -> np.ndarray:
        """Predicted change at a time ``(c,)``."""
        return np.asarray(self.mean[self.row(time_s)])


def lagged(kind: Callable[..., np.ndarray], values: np.ndarray, size: int) -> np.ndarray:
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
