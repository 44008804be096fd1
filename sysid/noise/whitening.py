"""Residuals in units of the innovations of first-order autoregressive noise, in which least squares are right."""

from __future__ import annotations

from copy import copy

import numpy as np

from sysid.noise.estimate import ChannelNoise
from sysid.noise.sampling_interval import in_sampling_intervals


def whiten(residual: np.ndarray, noise: ChannelNoise, t: np.ndarray) -> np.ndarray:
    """Residuals ``(n, m, ...)`` at the times ``t`` [s] ``(n,)`` in units of the noise's innovations
    (:class:`Whitening`); NaN stays NaN."""
    good = np.isfinite(residual)
    return np.where(good, Whitening(noise, good, t)(np.where(good, residual, 0.0)), np.nan)


class Whitening:
    """The map of residuals to units of the noise's innovations, for samples ``(n, m, ...)`` at the times ``t`` [s]
    ``(n,)`` that are ``good``.

    First-order autoregressive noise that goes on between samples (Ornstein & Uhlenbeck): over d usual intervals it is
    correlated by a = rho^d, so that a sample is (r_k - a r_b) / (sigma sqrt(1 - a^2)), b being the last good one of its
    column. Whether those between were never recorded or are not good makes no difference. The first of a column is
    divided by sigma alone. Others than good ones have no part in it, and are 0 afterwards. ``weights``: further factors
    on the samples afterwards.
    """

    def __init__(self, noise: ChannelNoise, good: np.ndarray, t: np.ndarray, weights: np.ndarray | float = 1.0) -> None:
        shape = (1, -1, *([1] * (good.ndim - 2)))
        rho, at = noise.rho.reshape(shape), in_sampling_intervals(t)
        next_to = rho ** np.diff(at).reshape(-1, *([1] * (good.ndim - 1)))
        alike = np.where(good[1:] & good[:-1], next_to, 0.0)
        self._now = weights * good / noise.sigma.reshape(shape)
        self._now[1:] /= np.sqrt(1.0 - alike**2)
        self._before = alike * self._now[1:]
        self._after, self._last = _across(good)
        beyond = noise.rho[self._after[1]] ** (at[self._after[0]] - at[self._last[0]])
        self._now[self._after] /= np.sqrt(1.0 - beyond**2)
        self._long_before = beyond * self._now[self._after]

    def of_column(self, j: int) -> Whitening:
        """The same for one column alone ``(n, 1)``."""
        column, of_it = copy(self), self._after[1] == j
        column._now, column._before = self._now[:, [j]], self._before[:, [j]]
        none = np.zeros(np.count_nonzero(of_it), dtype=int)
        column._after, column._last = (self._after[0][of_it], none), (self._last[0][of_it], none)
        column._long_before = self._long_before[of_it]
        return column

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Values ``(n, m, ...)``, finite everywhere, whitened."""
        now, before, long_before = self._factors(values)
        white = np.asarray(now * values)
        white[1:] -= before * values[:-1]
        white[self._after] -= long_before * values[self._last]
        return white

    def transposed(self, values: np.ndarray) -> np.ndarray:
        """The transpose of the map, applied to values ``(n, m, ...)``."""
        now, before, long_before = self._factors(values)
        found = np.asarray(now * values)
        found[:-1] -= before * values[1:]
        # No sample is the last good one before two others.
        found[self._last] -= long_before * values[self._after]
        return found

    def _factors(self, values: np.ndarray) -> list[np.ndarray]:
        more = (1,) * (values.ndim - self._now.ndim)
        return [f.reshape(*f.shape, *more) for f in (self._now, self._before, self._long_before)]


def _across(good: np.ndarray) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...]]:
    """Good samples right before which one is not good, but some are earlier, and the last of these: their indices."""
    after = np.nonzero(np.concatenate([np.zeros((1, *good.shape[1:]), dtype=bool), good[1:] & ~good[:-1]]))
    if not len(after[0]):
        return after, after
    rows = np.arange(len(good)).reshape(-1, *([1] * (good.ndim - 1)))
    right_before = (after[0] - 1, *after[1:])
    last = np.maximum.accumulate(np.where(good, rows, -1), axis=0)[right_before]
    after = tuple(index[last >= 0] for index in after)
    return after, (last[last >= 0], *after[1:])
