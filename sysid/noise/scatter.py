"""Level and colour of noise in a stretch of readings in which nothing moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sysid.settings.noise import NOISE


class Stretch(NamedTuple):
    """Noise of a quiet stretch: standard deviation, lag-one correlation, number of readings."""

    level: float
    rho: float
    size: int


def scatter_of(values: np.ndarray, at: np.ndarray) -> Stretch | None:
    """Noise of a quiet stretch, after removing a line from each column, by the readings that are there; None where no
    column has enough of them. ``at`` ``(n,)``: their times
    (:func:`sysid.noise.sampling_interval.in_sampling_intervals`)."""
    values = without_mistakes(values, at)
    good = np.isfinite(values)
    if not good.any():
        return None
    base = _line(at)
    residual = _line_residual(values, good, base)
    near = (np.diff(at) < NOISE.gap_interval)[:, None]
    size, pairs = int(good.sum()), int((near & good[1:] & good[:-1]).sum())
    variance = np.sum(residual**2) / (size - 2 * values.shape[1])
    # Of readings in a row the line takes up two pairs; of others in proportion.
    taken = 2 * values.shape[1] * pairs / (size - values.shape[1])
    if variance <= 0.0 or pairs <= 2 * values.shape[1]:
        return Stretch(float(np.sqrt(variance)), 0.0, size)
    product = np.sum(near * residual[1:] * residual[:-1]) / (pairs - taken)
    # Removing a line biases the correlation down by about 2 (1 + rho) / n.
    rho = product / variance
    rho = min(float(rho + 2.0 * (1.0 + rho) * values.shape[1] / size), NOISE.largest_correlation)
    return Stretch(float(np.sqrt(variance / _share_left(at, max(rho, 0.0), base))), rho, size)


def without_mistakes(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """The columns ``(n, k)`` of a quiet stretch that have readings enough, NaN where one is a mistake."""
    while True:
        values = values[:, np.isfinite(values).sum(axis=0) >= NOISE.min_rest_samples]
        good = np.isfinite(values)
        if not good.any():
            return values
        mistakes = _mistakes(_line_residual(values, good, _line(at)), good)
        if not mistakes.any():
            return values
        values = np.where(mistakes, np.nan, values)


def line_residual(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Residuals of columns ``(n, k)`` at times ``(n,)`` from a line each, 0 where there is no reading."""
    return _line_residual(values, np.isfinite(values), _line(at))


def _line(at: np.ndarray) -> np.ndarray:
    return np.column_stack([np.ones(len(at)), 2.0 * (at - at[0]) / (at[-1] - at[0]) - 1.0])


def _line_residual(values: np.ndarray, good: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Residual of each column from a line, 0 where it is not ``good``."""
    residual = np.zeros(values.shape)
    for there in np.unique(good, axis=1).T:
        alike = (good == there[:, None]).all(axis=0)
        seen, line = values[np.ix_(there, alike)], base[there]
        residual[np.ix_(there, alike)] = seen - line @ np.linalg.lstsq(line, seen, rcond=None)[0]
    return residual


def _mistakes(residual: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Readings ``(n, m)`` that are no noise: far beyond the median scatter, and few (a tracker's mistakes)."""
    median = 1.4826 * float(np.median(np.abs(residual[good])))
    far = good & (np.abs(residual) > NOISE.rest_outlier_sd * median)
    return far if 0.0 < median and far.sum() <= NOISE.rest_outlier_share * good.sum() else np.zeros_like(far)


def _share_left(at: np.ndarray, rho: float, base: np.ndarray) -> float:
    """Share of the variance of noise with lag-one correlation ``rho``, at the times ``at`` ``(n,)`` in usual intervals,
    left by a fit of the columns of ``base`` ``(n, 2)``, over that of white noise: tr((I - H) R) / (n - 2)."""
    n = len(at)
    if rho == 0.0 or n > NOISE.longest_exact_samples:
        return 1.0
    correlation = rho ** np.abs(np.subtract.outer(at, at))
    q = np.linalg.qr(base)[0]
    return float((n - np.sum(q * (correlation @ q))) / (n - 2))
