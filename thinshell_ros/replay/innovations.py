"""What one sensor reads next in a replay, given all that it has read: what of its change is left unexplained. No ROS.

A channel's change since before the replay is y(t) = m(t) + h(t) z + d(t) + e: m is what is predicted, e white noise of
the standard deviation s, and z what is not known and stays the same throughout a replay:

- weights of lags. A robot that follows its commands, and a sensor whose readings are older than their stamps, read
  sum_j w_j m(t - s_j) with weights that are not negative and sum up to one: columns m(t - s_j) - m(t), norm of w at
  most 1. No weights make more or less of what is predicted once it rests: a scale is no lag.
- shares of relaxations. A simulation by implicit Euler with steps dt of x' = f - x / tau is off by
  e = dt/2 (x' - <x'>), where <x'> is the mean of x' until t with weights exp(-(t - s) / tau) / tau (modified
  equation; Hairer, Lubich and Wanner, Geometric Numerical Integration, sec. IX.1): columns dt/2 (m' - <m'>) of some
  tau, norm of the shares at most 1.
- the mean of the readings before the replay, from n of them: normal, s / sqrt(n).

d is bounded, |d| <= D, and may be another one in each reading: the spread that is left by open parameters, T s(t)
(:mod:`sim_core.trajectories.expected`), the curvature of m between samples and between the lags s_j, and half of a
control period of a command that is held.

Recursive least squares (a Kalman filter of a constant state) with the variances v = s^2 + D^2 and the prior P_0 = 1 has
the innovation nu = y - m - h z_, z_ the estimate from all earlier readings, P its covariance. Of g groups with norms of
at most 1, the following holds for whatever z and d are:

- By Cauchy and Schwarz all that is bounded makes at most r sqrt(h P h) of an innovation besides d, r^2 = g + sum_k
  D_k^2 / v_k, and the rest is normal with at most the variance s^2 + h P h. Where N normal values are within Z standard
  deviations, |nu| <= D + Z sqrt(s^2 + h P h) + r sqrt(h P h).
- The Mahalanobis distance of the whole deviation up to now, S = sum nu^2 / (v + h P h), is the least of
  sum (y - m - h z)^2 / v + |z|^2 over all z, so at most what it is at the true ones: g, the square of a normal number
  for the mean before the replay, and (d + e)^2 / v of each reading, which have at most the exponential moments of chi^2
  with one degree of freedom (their derivatives by s^2 / v are not negative). So of n - 1 readings
  S <= g + n + 2 sqrt(n x) + 2 x with the probability 1 - exp(-x) at least (Laurent and Massart, Adaptive estimation of
  a quadratic functional by model selection, lemma 1).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d
from scipy.signal import lfilter

from sim_core.trajectories.expected import Band
from thinshell_ros.replay.expectation import Changes, Table, lagged

LAGS = 12
"""Most lags that are distinguished: their distance is an interval of the prediction, or the longest over this."""

RELAXATION_RATIO = 4.0
"""Ratio of the relaxation times that are distinguished, from the step of the simulation to the length of the motion."""


class Innovations(Changes):
    """The channels ``(c,)`` of one sensor in a replay. Times are those of the trajectory [s]."""

    def __init__(
        self,
        band: Band,
        factors: tuple[float, float],
        lag_s: float,
        held_s: float = 0.0,
        step_s: float | None = None,
    ) -> None:
        """``factors``: Z and x; ``lag_s``: how much older readings may be than their times; ``held_s``: for how long a
        command is held; ``step_s``: of the simulation that predicted, None where that is not known: the samples are its
        steps."""
        super().__init__()
        self._factor, self._exponent = factors
        self._variance = np.square(band.noise / self._factor)
        self._table = Table(band)
        self._mean, tick = self._table.of(band.mean - band.mean[0]), self._table.step_s
        rates = np.diff(self._mean, axis=0, prepend=self._mean[:1]) / tick
        gap = float(np.diff(band.times).max())
        count = min(math.ceil(lag_s / gap), LAGS)
        apart = lag_s / count if count else 0.0
        self._back = np.round(np.arange(1, count + 1) * apart / tick).astype(int)
        self._off_in_steps = _off_in_steps(rates, tick, gap if step_s is None else step_s)
        bend = _range(rates, math.ceil((gap + apart) / tick) + 1)
        off = self._table.of(band.spread) + 0.25 * (gap + apart) * bend + 0.5 * held_s * np.abs(rates)
        self._bound = lagged(maximum_filter1d, off, math.ceil(lag_s / tick) + 2) + band.spread[0]
        self._groups = 2 if count else 1

    def begin(self) -> None:
        """Changes are counted from what was read before; without any, from the first reading."""
        super().begin()
        channels, columns = len(self._variance), 1 + len(self._back) + len(self._off_in_steps)
        self._estimate = np.zeros((channels, columns))
        self._covariance = np.tile(np.eye(columns), (channels, 1, 1))
        self._covariance[:, 0, 0] = self._variance / self.count
        self._systematic = np.full(channels, float(self._groups))
        self._distance, self._terms = np.zeros(channels), np.ones(channels)
        self._predicted = np.zeros(channels)

    def _columns(self, row: int) -> np.ndarray:
        """Derivatives by what stays the same in a replay ``(c, 1 + lags + relaxations)``."""
        mean = self._mean[row]
        late = self._mean[np.maximum(row - self._back, 0)] - mean
        return np.asarray(np.vstack([np.ones_like(mean)[None], late, self._off_in_steps[:, row]]).T)

    def excess(self, change: np.ndarray, time_s: float) -> np.ndarray:
        """By what share a change ``(c,)`` at a time, given all before, or the distance of all up to now is larger than
        it may be: 0 or less where it is not, NaN where there was no reading. From a change that is too large nothing is
        learnt."""
        row = self._table.row(time_s)
        columns, bound = self._columns(row), self._bound[row]
        gains = np.einsum("cij,cj->ci", self._covariance, columns)
        unknown = np.maximum(np.einsum("ci,ci->c", columns, gains), 0.0)
        self._predicted = self._mean[row] + np.einsum("ci,ci->c", columns, self._estimate)
        innovation = change - self._predicted
        expected = bound + self._factor * np.sqrt(self._variance + unknown) + np.sqrt(self._systematic * unknown)
        single = np.abs(innovation) / expected - 1.0
        known = single <= 0.0
        variance = self._variance + bound**2
        total = np.where(known, variance + unknown, np.inf)
        innovation = np.where(known, innovation, 0.0)
        self._estimate += gains * (innovation / total)[:, None]
        self._covariance -= gains[:, :, None] * (gains / total[:, None])[:, None, :]
        self._systematic += known * bound**2 / variance
        self._distance += innovation**2 / total
        self._terms += known
        most = self._groups + self._terms + 2.0 * np.sqrt(self._terms * self._exponent) + 2.0 * self._exponent
        return np.where(np.isnan(single), np.nan, np.maximum(single, self._distance / most - 1.0))

    def expected(self) -> np.ndarray:
        """The change that was expected of the last reading ``(c,)``."""
        return self._predicted


def _off_in_steps(rates: np.ndarray, tick_s: float, step_s: float) -> np.ndarray:
    """What steps of time make of relaxations ``(q, n, c)``, of rates ``(n, c)`` at even times."""
    length = max(len(rates) * tick_s / step_s, 1.0)
    found = []
    for k in range(math.ceil(math.log(length, RELAXATION_RATIO)) + 1):
        kept = math.exp(-tick_s / (step_s * RELAXATION_RATIO**k))
        found.append(0.5 * step_s * (rates - lfilter([1.0 - kept], [1.0, -kept], rates, axis=0)))
    return np.array(found)


def _range(values: np.ndarray, size: int) -> np.ndarray:
    """Largest less least value within so many rows around each."""
    most, least = (kind(values, size=size, axis=0, mode="nearest") for kind in (maximum_filter1d, minimum_filter1d))
    return np.asarray(most - least)
