"""Residuals in units of the innovations of first-order autoregressive noise, in which least squares are right."""

from __future__ import annotations

from copy import copy

import numpy as np

from sysid.fit.noise import ChannelNoise


def whiten(residual: np.ndarray, noise: ChannelNoise) -> np.ndarray:
    """Residuals ``(n, m, ...)`` in units of the noise's innovations (:class:`Whitening`); NaN stays NaN."""
    good = np.isfinite(residual)
    return np.where(good, Whitening(noise, good)(np.where(good, residual, 0.0)), np.nan)


class Whitening:
    """The map of residuals to units of the noise's innovations, for samples ``(n, m, ...)`` that are ``good``.

    First-order autoregressive noise: (r_k - rho r_{k-1}) / (sigma sqrt(1 - rho^2)); a sample whose
    predecessor is missing is divided by sigma alone. Others have no part in it, and are 0 afterwards. ``weights``:
    further factors on the samples afterwards.
    """

    def __init__(self, noise: ChannelNoise, good: np.ndarray, weights: np.ndarray | float = 1.0) -> None:
        columns = (1, -1, *([1] * (good.ndim - 2)))
        sigma, rho = noise.sigma.reshape(columns), noise.rho.reshape(columns)
        follows = good.copy()
        follows[:1] = False
        follows[1:] &= good[:-1]
        scale = weights * good / sigma
        self._now = np.where(follows, scale / np.sqrt(1.0 - rho**2), scale)
        self._before = np.where(follows, rho * self._now, 0.0)[1:]

    def of_column(self, j: int) -> Whitening:
        """The same for one column alone ``(n, 1)``."""
        column = copy(self)
        column._now, column._before = self._now[:, [j]], self._before[:, [j]]
        return column

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Values ``(n, m, ...)``, finite everywhere, whitened."""
        now, before = self._factors(values)
        white = np.asarray(now * values)
        white[1:] -= before * values[:-1]
        return white

    def transposed(self, values: np.ndarray) -> np.ndarray:
        """The transpose of the map, applied to values ``(n, m, ...)``."""
        now, before = self._factors(values)
        found = np.asarray(now * values)
        found[:-1] -= before * values[1:]
        return found

    def _factors(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        more = (1,) * (values.ndim - self._now.ndim)
        return self._now.reshape(*self._now.shape, *more), self._before.reshape(*self._before.shape, *more)
