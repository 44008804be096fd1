"""How much of the noise at rest is white, and how much goes on from sample to sample.

The two parts of :mod:`sysid.noise.whitening` are separated by their restricted likelihood, in which what a parabola
takes away of each stretch is accounted for (Patterson & Thompson, Biometrika 58, 1971): with K = R(rho, white) the
correlation of a column y at rest and X = (1, t, t^2),

    -2 log L = (n - 3) log s^2 + RSS / s^2 + log |K| + log |X^T K^-1 X|,

summed over all stretches and columns, which share rho and the share that is white, those of one quantity s as well.
Forces and torques are sums of the signals of the same strain gauges, so that their noise has one spectrum, unless what
two of their own explain beyond one has a chance of a thousandth. A noise with one part only is the simpler one: a
second part has to be worth ``NOISE.white_part_gain``. What is slow is known badly from short rests, and its most
probable size is on average half of what it is, so means over the posterior are taken: of the white variance, of that of
the mean of many samples, and of that of a sample about what those before it predict. The last one decides how large
residuals are in units of the noise, and rests tell it best.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid.noise.sampling_interval import in_sampling_intervals
from sysid.settings.noise import NOISE

COLOURS, SHARES = 1.0 - np.geomspace(0.5, 0.015, 12), np.linspace(0.04, 0.94, 11)
"""Correlations and white shares that the likelihood is integrated over."""


class Mixture(NamedTuple):
    """Standard deviation of both parts together, correlation of the coloured one over an interval, share of the
    variance that is white."""

    sigma: float
    rho: float
    white: float


Rests = Sequence[tuple[np.ndarray, np.ndarray]]
"""Stretches at rest, each values ``(n, m)``, NaN where there is none, and times [s] ``(n,)``."""


def mixtures_of(quantities: Sequence[Rests]) -> list[Mixture | None]:
    """The parts of the noise of quantities of one sensor at rest; None of one that has one part, which explains it as
    well. They have one spectrum where several do not explain them better."""
    from scipy.special import chdtri

    chosen = [[(_some(values), t) for values, t in rests] for rests in quantities]
    chosen = [[(values, t) for values, t in rests if values.size] for rests in chosen]
    known = [k for k, rests in enumerate(chosen) if rests]
    found: list[Mixture | None] = [None] * len(quantities)
    colours = np.array([0.0, *np.linspace(0.05, NOISE.largest_correlation, 20)])
    one = np.array([_loss(chosen[k], colours, np.zeros(len(colours)))[0] for k in known])
    rho, white = (grid.ravel() for grid in np.meshgrid(COLOURS, SHARES))
    of_two = [_loss(chosen[k], rho, white) for k in known]
    two, variances = (np.array([pair[k] for pair in of_two]) for k in (0, 1))

    def least(which: list[int]) -> float:
        return float(min(one[which].sum(axis=0).min(), two[which].sum(axis=0).min()))

    whole = list(range(len(known)))
    more = 2 * (len(known) - 1)  # of numbers that spectra have
    apart = more > 0 and least(whole) - sum(least([k]) for k in whole) > float(chdtri(more, NOISE.two_spectra_chance))
    for group in [[k] for k in whole] if apart else [whole] if whole else []:
        loss = two[group].sum(axis=0)
        if float(one[group].sum(axis=0).min() - loss.min()) < 2.0 * NOISE.white_part_gain:
            continue
        loss = loss + prior_loss(rho)
        weight = np.exp(-0.5 * (loss - loss.min()))
        for k in group:
            found[known[k]] = _mean(weight / weight.sum(), variances[k], rho, white)
    return found


def _mean(weight: np.ndarray, variance: np.ndarray, rho: np.ndarray, white: np.ndarray) -> Mixture:
    """The parts whose white variance w, innovation variance s and long-run variance l are the means with weights
    ``(g,)``. The sum of both parts is an ARMA(1, 1) process with the spectrum s |1 - q z|^2 / |1 - rho z|^2 on the unit
    circle, where s q = w rho; at frequency zero that is l, so that s^(1/2) (1 - w rho / s) = l^(1/2) (1 - rho)."""
    coloured, own = variance * (1.0 - white), variance * white
    of_white, long_run = float(weight @ own), float(weight @ (own + coloured * (1.0 + rho) / (1.0 - rho)))
    ahead = float(weight @ innovation_variance(own, coloured, rho))
    slope = (np.sqrt(long_run) - np.sqrt(ahead)) / (np.sqrt(long_run) - of_white / np.sqrt(ahead))
    slope = min(float(slope), NOISE.largest_correlation)
    whole = of_white + (long_run - of_white) * (1.0 - slope) / (1.0 + slope)
    return Mixture(float(np.sqrt(whole)), slope, of_white / whole)


def innovation_variance(white: np.ndarray, coloured: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Variance of the sum of a white and a coloured part about its best prediction from all samples before: the larger
    root s of s + (w rho)^2 / s = w (1 + rho^2) + c (1 - rho^2)."""
    half = 0.5 * (white * (1.0 + rho**2) + coloured * (1.0 - rho**2))
    return np.asarray(half + np.sqrt(half**2 - (white * rho) ** 2))


def _loss(stretches: Rests, rho: np.ndarray, white: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """-2 log L at the best variance, and that, for correlations and white shares ``(g,)`` each."""
    squares, logs, number = np.zeros(len(rho)), np.zeros(len(rho)), 0
    degree = NOISE.trend_degree + 1
    for values, t in stretches:
        good, at = np.isfinite(values), in_sampling_intervals(t)
        course = np.vander((t - t[0]) / max(t[-1] - t[0], 1e-300), degree)
        for pattern in np.unique(good, axis=1).T:
            alike = (good == pattern[:, None]).all(axis=0)
            count = int(alike.sum())
            gram, log_determinant = _correlated(
                np.hstack([values[pattern][:, alike], course[pattern]]), at[pattern], rho, white
            )
            of_y, x_y, x_x = gram[:, :count, :count], gram[:, count:, :count], gram[:, count:, count:]
            explained = np.einsum("gij,gij->g", x_y, np.linalg.solve(x_x, x_y))
            squares += np.trace(of_y, axis1=1, axis2=2) - explained
            logs += count * (log_determinant + np.linalg.slogdet(x_x)[1])
            number += count * (int(pattern.sum()) - degree)
    variance = np.maximum(squares / number, 1e-300)
    return number * (np.log(variance) + 1.0) + logs, variance


def _correlated(
    values: np.ndarray, at: np.ndarray, rho: np.ndarray, white: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """V^T K^-1 V ``(g, m, m)`` and log |K| ``(g,)`` of values V ``(n, m)`` at times ``at`` in sampling intervals, by
    the innovations of a Kalman filter for the coloured part, for all correlations and white shares ``(g,)`` at once."""
    gram, log_determinant = np.zeros((len(rho), values.shape[1], values.shape[1])), np.zeros(len(rho))
    state, unknown = np.zeros((len(rho), values.shape[1])), 1.0 - white
    for row, pause in zip(values, np.diff(at, prepend=at[0]), strict=True):
        kept = rho**pause
        state *= kept[:, None]
        unknown = kept**2 * unknown + (1.0 - kept**2) * (1.0 - white)
        variance = unknown + white
        ahead = row - state
        scaled = ahead / np.sqrt(variance)[:, None]
        gram += scaled[:, :, None] * scaled[:, None]
        log_determinant += np.log(variance)
        state += (unknown / variance)[:, None] * ahead
        unknown *= white / variance
    return gram, log_determinant


def prior_loss(rho: np.ndarray) -> np.ndarray:
    """-2 log of the prior of correlations: what is slower than a rest is long cannot be separated from its course."""
    return np.asarray((np.log(NOISE.colour_intervals * (1.0 - rho)) / NOISE.colour_intervals_log_sd) ** 2)


def _some(values: np.ndarray) -> np.ndarray:
    """A few of the columns that have readings enough ``(n, k)``."""
    enough = np.flatnonzero(np.isfinite(values).sum(axis=0) > 2 * NOISE.trend_degree)
    if len(enough) > NOISE.mixture_columns:
        enough = enough[np.linspace(0, len(enough) - 1, NOISE.mixture_columns).astype(int)]
    return values[:, enough]
