"""Residuals in units of the innovations of noise, in which least squares are right.

Noise is first-order autoregressive (coloured), and a part of its variance may be white on top of that: a force sensor
hums by itself and drifts with the temperature of its amplifier. Together they are an ARMA(1, 1) process (Box & Jenkins,
Time Series Analysis, 1976, section 4.3; Granger & Morris, J. R. Stat. Soc. A 139, 1976). With D the map to the
innovations of the coloured part, and r the white variance over the coloured one, the covariance of D y is tridiagonal,

    D cov(y) D^T = I + r S S^T,    S = D in units of the coloured noise,

and its Cholesky factor L gives the innovations of both, L^-1 D y.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky_banded, solve_banded

from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.sampling_interval import in_sampling_intervals


def whiten(residual: np.ndarray, noise: ChannelNoise, t: np.ndarray) -> np.ndarray:
    """Residuals ``(n, m, ...)`` at the times ``t`` [s] ``(n,)`` in units of the noise's innovations
    (:class:`Whitening`); NaN stays NaN."""
    good = np.isfinite(residual)
    return np.where(good, Whitening(noise, good, t)(np.where(good, residual, 0.0)), np.nan)


class Whitening:
    """The map of residuals to units of the noise's innovations, for samples ``(n, m, ...)`` at the times ``t`` [s]
    ``(n,)`` that are ``good``.

    Coloured noise goes on between samples (Ornstein & Uhlenbeck): over d usual intervals it is correlated by a = rho^d,
    so that a sample is (r_k - a r_b) / (sigma sqrt(1 - a^2)), b being the last good one of its column. Whether those
    between were never recorded or are not good makes no difference. The first of a column is divided by sigma alone.
    Others than good ones have no part in it, and are 0 afterwards. ``weights``: further factors on the samples
    afterwards.
    """

    def __init__(self, noise: ChannelNoise, good: np.ndarray, t: np.ndarray, weights: np.ndarray | float = 1.0) -> None:
        shape = (1, -1, *([1] * (good.ndim - 2)))
        rho, at = noise.rho.reshape(shape), in_sampling_intervals(t)
        coloured = noise.sigma * np.sqrt(1.0 - noise.white)
        next_to = rho ** np.diff(at).reshape(-1, *([1] * (good.ndim - 1)))
        alike = np.where(good[1:] & good[:-1], next_to, 0.0)
        self._weights = weights * good
        self._now = good / coloured.reshape(shape)
        self._now[1:] /= np.sqrt(1.0 - alike**2)
        self._before = alike * self._now[1:]
        self._after, self._last = _across(good)
        beyond = noise.rho[self._after[1]] ** (at[self._after[0]] - at[self._last[0]])
        self._now[self._after] /= np.sqrt(1.0 - beyond**2)
        self._long_before = beyond * self._now[self._after]
        self._mixed = _mixed(noise, good, at) if noise.white.any() else []

    def of_column(self, j: int) -> Whitening:
        """The same for one column alone ``(n, 1)``."""
        column, of_it = copy(self), self._after[1] == j
        column._weights = self._weights[:, [j]]
        column._now, column._before = self._now[:, [j]], self._before[:, [j]]
        none = np.zeros(np.count_nonzero(of_it), dtype=int)
        column._after, column._last = (self._after[0][of_it], none), (self._last[0][of_it], none)
        column._long_before = self._long_before[of_it]
        first = np.zeros(1, dtype=int)
        column._mixed = [replace(m, columns=first) for m in self._mixed if j in m.columns]
        return column

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Values ``(n, m, ...)``, finite everywhere, whitened."""
        now, before, long_before = self._factors(values)
        white = np.ascontiguousarray(now * values)
        white[1:] -= before * values[:-1]
        white[self._after] -= long_before * values[self._last]
        for mixed in self._mixed:
            mixed.apply(white, self._now.shape, transposed=False)
        return self._weighed(white)

    def transposed(self, values: np.ndarray) -> np.ndarray:
        """The transpose of the map, applied to values ``(n, m, ...)``."""
        now, before, long_before = self._factors(values)
        values = np.ascontiguousarray(self._weighed(values))
        for mixed in self._mixed:
            mixed.apply(values, self._now.shape, transposed=True)
        found = np.asarray(now * values)
        found[:-1] -= before * values[1:]
        # No sample is the last good one before two others.
        found[self._last] -= long_before * values[self._after]
        return found

    @property
    def log_determinant(self) -> float:
        """Of the map, without its weights, over the good samples."""
        whole = float(np.sum(np.log(self._now[self._now > 0.0])))
        return whole - sum(len(m.columns) * float(np.sum(np.log(m.factor[0]))) for m in self._mixed)

    def _weighed(self, values: np.ndarray) -> np.ndarray:
        more = (1,) * (values.ndim - self._weights.ndim)
        return np.asarray(values * self._weights.reshape(*self._weights.shape, *more))

    def _factors(self, values: np.ndarray) -> list[np.ndarray]:
        more = (1,) * (values.ndim - self._now.ndim)
        return [f.reshape(*f.shape, *more) for f in (self._now, self._before, self._long_before)]


@dataclass(frozen=True)
class _Mixed:
    """What white noise added to the coloured makes of its innovations, for ``columns`` of which the same ``rows`` are
    good: the Cholesky ``factor`` of their covariance, lower banded ``(2, r)``."""

    rows: np.ndarray
    columns: np.ndarray
    factor: np.ndarray

    def apply(self, values: np.ndarray, shape: tuple[int, ...], transposed: bool) -> None:
        """Multiply these columns of values ``(n, m, ...)`` by the inverse of the factor, or by its transpose, in place.
        ``shape``: of the map's samples, ``(n, m, ...)``."""
        flat = values.reshape(shape[0], int(np.prod(shape[1:])), -1)
        here = np.ix_(self.rows, self.columns)
        part = flat[here]
        right = part.reshape(len(self.rows), -1)
        if transposed:
            upper = np.zeros(self.factor.shape)
            upper[0, 1:], upper[1] = self.factor[1, :-1], self.factor[0]
            found = solve_banded((0, 1), upper, right, check_finite=False)
        else:
            found = solve_banded((1, 0), self.factor, right, check_finite=False)
        flat[here] = found.reshape(part.shape)


def _mixed(noise: ChannelNoise, good: np.ndarray, at: np.ndarray) -> list[_Mixed]:
    """The factors of all columns that have white noise and coloured."""
    flat = good.reshape(len(good), -1)
    each = flat.shape[1] // max(len(noise.sigma), 1)
    rho, white = np.repeat(noise.rho, each), np.repeat(noise.white, each)
    groups: dict[tuple[bytes, float, float], list[int]] = {}
    for k in np.flatnonzero((white > 0.0) & flat.any(axis=0)):
        groups.setdefault((flat[:, k].tobytes(), float(rho[k]), float(white[k])), []).append(int(k))
    found = []
    for (_, colour, share), columns in groups.items():
        rows = np.flatnonzero(flat[:, columns[0]])
        alike = colour ** np.diff(at[rows])
        now = np.concatenate([[1.0], 1.0 / np.sqrt(1.0 - alike**2)])
        before = alike * now[1:]
        covariance = np.zeros((2, len(rows)))
        covariance[0] = now**2
        covariance[0, 1:] += before**2
        covariance[1, :-1] = -before * now[:-1]
        covariance *= share / (1.0 - share)
        covariance[0] += 1.0
        factor = cholesky_banded(covariance, lower=True, check_finite=False)
        found.append(_Mixed(rows, np.array(columns), factor))
    return found


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
