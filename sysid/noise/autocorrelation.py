"""The colour of noise, from what the fit leaves.

A rest shows the level of the noise and the correlation of neighbouring samples, and no more: slow drift under white
noise, as force sensors have it, is hardly seen in a second. Without a rest the noise is taken for white, with the level
that neighbouring samples show; coloured noise is then underrated twice. What the fit leaves shows both. In each
quantity of a channel the whitened residuals r are taken for a sum of white noise and first-order autoregressive noises
of several correlation lengths,

    C = sum_b v_b R_b,    R_b,kl = rho_b^|k - l|,    v_b >= 0,

whose variances v_b follow from the products of samples that are l apart, for several lags l, less what the parameters
take up of them, H = J A J^T (A: inverse information; S_l: mean of the samples l before and l after), by non-negative
least squares (Lawson & Hanson 1974, ch. 23):

    r^T S_l r = sum_b v_b tr((I - H) S_l (I - H) R_b),

and less the bias of each column, where that is taken out. Matrices that depend on the distance of samples alone are
taken to go on beyond the ends of a recording, so that all products with J come from its cross-correlations; what S_l
misses of samples that are missing is taken for the same share everywhere. Lags are lags in time: messages that were
lost are samples that are missing. What the discretisation error takes up is left out: noise that it resembles is
underrated.

The scores J^T r then have the covariance J^T C J instead of J^T J. Only intervals know of it, and only where it
widens them. Estimates, and the misfit that tells whether something is missing, stay those of the noise assumed: what a
missing law leaves is correlated, too, and is not to pass for noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import FROM_DIFFERENCES
from sysid.noise.sampling_interval import in_sampling_intervals
from sysid.settings.noise import NOISE


@dataclass(frozen=True)
class Samples:
    """Which samples of a channel the rows of a residual are, one by one ``(n, m)``, their times [s] ``(n,)``, the
    groups of columns that share a colour, and whether the bias of each column is taken out."""

    there: np.ndarray
    t: np.ndarray
    groups: tuple[np.ndarray, ...]
    tared: bool = False

    def of_rows(self, residual: np.ndarray, jacobian: np.ndarray, sight: np.ndarray | None = None) -> list[Part]:
        """Each group of the channel, with a sample that is not there for each that is missing in time; ``residual``
        ``(rows,)``, ``jacobian`` ``(rows, p)``; ``sight`` ``(rows,)``: which of them are predicted in sight."""
        count = _counted(self.t)
        rows, columns = np.nonzero(self.there)
        shape, at = (count[-1] + 1, self.there.shape[1]), (count[rows], columns)
        there, r, j = np.zeros(shape, dtype=bool), np.zeros(shape), np.zeros((*shape, jacobian.shape[1]))
        there[at], r[at], j[at] = True if sight is None else sight, residual, jacobian
        return [Part(there[:, g], r[:, g], j[:, g], self.tared) for g in self.groups]


def _counted(t: np.ndarray) -> np.ndarray:
    """Numbers of the samples at the times ``t`` [s] ``(n,)`` in a row that has those that are missing as well. Long
    pauses count for less, so that the row is at most twice as long as without."""
    steps = np.maximum(np.rint(np.diff(in_sampling_intervals(t))), 1.0)
    gaps = max(int(np.count_nonzero(steps > 1.0)), 1)
    return np.concatenate([[0], np.cumsum(np.minimum(steps, 1 + len(t) // gaps))]).astype(int)


class Part(NamedTuple):
    """One quantity in one run, sample by sample at even times: which are ``there`` ``(n, m)``, their residuals
    ``(n, m)`` and derivatives ``(n, m, p)``, 0 elsewhere; ``tared``: the mean of each column is taken out."""

    there: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    tared: bool = False


def autocorrelated_scores(quantities: Sequence[Sequence[Part]], inverse: np.ndarray) -> np.ndarray:
    """By how much the covariance of the scores exceeds the information ``(p, p)``: sum of J^T C J - J^T J over
    quantities, of which each has a part in some runs; ``inverse`` ``(p, p)``: A."""
    excess = np.zeros(inverse.shape)
    for parts in quantities:
        number = sum(int(part.there.sum()) for part in parts)
        if number > len(inverse) and any(part.residual.any() for part in parts):
            excess += _excess(parts, number, inverse)
    return excess


def _excess(parts: Sequence[Part], number: int, inverse: np.ndarray) -> np.ndarray:
    """J^T C J - J^T J of one quantity."""
    longest = max(len(part.there) for part in parts)
    lengths = _geometric(
        NOISE.shortest_correlation_samples, NOISE.correlation_length_ratio, NOISE.longest_correlation_share * longest
    )
    rhos = np.array([0.0, *np.exp(-1.0 / lengths)])
    lags = np.unique(np.round([0.0, *_geometric(1.0, 2.0, NOISE.largest_lag_share * longest)]).astype(int))
    pairs = np.array([sum(int((_from(p.there, k) & _until(p.there, k)).sum()) for p in parts) for k in lags])
    products = np.array([sum(float(np.sum(_from(p.residual, k) * _until(p.residual, k))) for p in parts) for k in lags])
    lagged = _lagged_information(parts, longest)
    distance = np.arange(longest)
    twice = np.where(distance > 0, 2.0, 1.0)
    spreads = np.tensordot(twice * np.power.outer(rhos, distance), lagged, axes=1)
    taken = np.tensordot(lagged, inverse, axes=2)
    apart = np.abs(np.subtract.outer(lags, distance)), np.add.outer(lags, distance)
    met = pairs / np.maximum([sum(_within_reach(p.there, k) for p in parts) for k in lags], 1.0)
    by_lag = np.column_stack(
        [
            pairs * np.power(rho, lags)
            - met * ((np.power(rho, apart[0]) + np.power(rho, apart[1])) @ (twice * taken))
            + np.tensordot(inverse @ lagged[lags] @ inverse, spread, axes=2)
            - _tared(parts, rho, lags)
            for rho, spread in zip(rhos, spreads, strict=True)
        ]
    )
    level = max(products[0] / max(by_lag[0, 0], 1.0), 1e-300)
    sd = np.sqrt(np.maximum(pairs, 1) * np.where(lags == 0, 2.0, 1.0))
    weighed, wanted = by_lag / sd[:, None], products / (level * sd)
    size = np.linalg.norm(weighed, axis=0)
    shares, off = nnls(weighed / size, wanted)
    white = weighed[:, 0] * (weighed[:, 0] @ wanted) / size[0] ** 2
    if np.sum((wanted - white) ** 2) - off**2 < NOISE.colour_evidence:
        return np.asarray((level - 1.0) * spreads[0])
    return np.asarray(np.tensordot(level * shares / size, spreads, axes=1) - spreads[0])


def _lagged_information(parts: Sequence[Part], longest: int) -> np.ndarray:
    """J^T S_d J for all distances d of samples, summed over runs ``(longest, p, p)``: cross-correlations, by the fast
    Fourier transform of some columns at a time."""
    p = parts[0].jacobian.shape[2]
    found = np.zeros((longest, p, p))
    for part in parts:
        n, m = part.there.shape
        many = max(1, int(NOISE.transformed_at_once / (2 * n * p)))
        spectrum = np.zeros((n + 1, p, p), dtype=complex)
        for k in range(0, m, many):
            wave = np.fft.rfft(part.jacobian[:, k : k + many], 2 * n, axis=0)
            spectrum += wave.conj().transpose(0, 2, 1) @ wave
        found[:n] += np.fft.irfft(spectrum, 2 * n, axis=0)[:n]
    return np.asarray(0.5 * (found + found.transpose(0, 2, 1)))


def _within_reach(there: np.ndarray, lag: int) -> float:
    """Number of samples that others, half before and half after them, would be so far from if none were missing."""
    return 0.5 * float(_from(there, lag).sum() + _until(there, lag).sum())


def _tared(parts: Sequence[Part], rho: float, lags: np.ndarray) -> np.ndarray:
    """What the bias of each column takes up, ``(l,)``: tr(P S_l R) with P the mean of its n samples, the number of
    pairs that are l apart, over n, times the mean of the rows of R."""
    found = np.zeros(len(lags))
    for part in (part for part in parts if part.tared):
        size = len(part.there)
        wave = np.fft.rfft(part.there.astype(float), 2 * size, axis=0)
        pairs = np.rint(np.fft.irfft(np.abs(wave) ** 2, 2 * size, axis=0)[:size])
        pairs = pairs[:, pairs[0] > 0]
        distance = np.arange(size)
        row = np.where(distance > 0, 2.0, 1.0) * rho**distance @ pairs / pairs[0]
        found[lags < size] += pairs[lags[lags < size]] / pairs[0] @ row
    return found


def _geometric(first: float, ratio: float, last: float) -> np.ndarray:
    """Numbers from ``first`` to ``last``, each at most so many times the one before; none if ``last`` is less."""
    steps = int(np.ceil(np.log(last / first) / np.log(ratio) - 1e-9)) if last >= first else -1
    return np.geomspace(first, last, steps + 1) if steps > 0 else np.full(steps + 1, first)


def _from(values: np.ndarray, lag: int) -> np.ndarray:
    """All samples but the first ``lag``."""
    return values[lag:]


def _until(values: np.ndarray, lag: int) -> np.ndarray:
    """All samples but the last ``lag``."""
    return values[: max(len(values) - lag, 0)]


def unknown_autocorrelation(noise: Mapping[str, ChannelNoise]) -> list[str]:
    """A sentence for each channel whose autocorrelation no rest shows."""
    return [
        f"The colour of the noise of {name} is not known, since nothing stands still for {NOISE.min_rest_samples} "
        "of its samples. Readings are weighed as if it were white, and intervals allow for the correlation of what "
        "the fit leaves. Record a rest at the start."
        for name, found in sorted(noise.items())
        if found.source == FROM_DIFFERENCES
    ]
