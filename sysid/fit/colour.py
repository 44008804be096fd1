"""The colour of noise, from what the fit leaves.

A rest tells the level of the noise and how alike neighbouring samples are, and no more: slow drift beside white noise,
as force sensors have it, is hardly seen in a second. Without a rest the noise is taken for white, with the level that
neighbouring samples show; coloured noise is then underrated twice. What the fit leaves shows both. In each quantity of
a channel the whitened residuals r are taken for a sum of white noise and first-order autoregressive noises of several
correlation lengths,

    C = sum_b v_b R_b,    R_b,kl = rho_b^|k - l|,    v_b >= 0,

whose variances v_b follow from the products of samples that are l apart, for several lags l, beside what the parameters
take up of them, H = J A J^T (A: inverse information; S_l: mean of the samples l before and l after), by non-negative
least squares (Lawson & Hanson 1974, ch. 23):

    r^T S_l r = sum_b v_b tr((I - H) S_l (I - H) R_b).

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
from scipy.signal import lfilter

from sysid.fit.noise import FROM_DIFFERENCES, MIN_REST_SAMPLES, ChannelNoise

SHORTEST, LONGER = 1.5, 3.0
"""Shortest correlation length [samples], and the largest ratio of one to the next."""

LONGEST_SHARE = 0.2
"""Longest correlation length, in lengths of the longest recording: what is slower is not told from a parameter."""

FARTHEST_SHARE = 1.0 / 3.0
"""Largest lag, likewise."""

SEEN = 6.0
"""By how much colour must lower the sum of squares over lags, in units of their variance by white noise, to be
believed."""


@dataclass(frozen=True)
class Samples:
    """Which samples of a channel the rows of a residual are, one by one ``(n, m)``, and the groups of columns that
    share a colour."""

    there: np.ndarray
    groups: tuple[np.ndarray, ...]

    def of_rows(self, residual: np.ndarray, jacobian: np.ndarray) -> list[Part]:
        """Each group of the channel; ``residual`` ``(rows,)``, ``jacobian`` ``(rows, p)``."""
        r, j = np.zeros(self.there.shape), np.zeros((*self.there.shape, jacobian.shape[1]))
        r[self.there], j[self.there] = residual, jacobian
        return [Part(self.there[:, g], r[:, g], j[:, g]) for g in self.groups]


class Part(NamedTuple):
    """One quantity in one run: which samples are ``there`` ``(n, m)``, their residuals ``(n, m)`` and derivatives
    ``(n, m, p)``, 0 elsewhere."""

    there: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray


def coloured_scores(quantities: Sequence[Sequence[Part]], inverse: np.ndarray) -> np.ndarray:
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
    lengths = _geometric(SHORTEST, LONGER, LONGEST_SHARE * longest)
    lags = np.unique(np.round([0.0, *_geometric(1.0, 2.0, FARTHEST_SHARE * longest)]).astype(int)).tolist()
    pairs = np.array([sum(int((part.there[lag:] & _until(part.there, lag)).sum()) for part in parts) for lag in lags])
    products = np.array([sum(float(np.sum(p.residual[lag:] * _until(p.residual, lag))) for p in parts) for lag in lags])
    jacobians = [part.jacobian for part in parts]
    taken = [inverse @ _beside(parts, jacobians, lag) @ inverse for lag in lags]
    spreads, left = [], []
    for rho in (0.0, *np.exp(-1.0 / lengths)):
        correlated = [_correlated(jacobian, rho) for jacobian in jacobians]
        spreads.append(_beside(parts, correlated, 0))
        crossed = [float(np.sum(inverse * _beside(parts, correlated, lag))) for lag in lags]
        alike = pairs * np.power(rho, lags)
        left.append(alike - 2.0 * np.array(crossed) + [float(np.sum(both * spreads[-1])) for both in taken])
    by_lag = np.column_stack(left)
    level = max(products[0] / max(by_lag[0, 0], 1.0), 1e-300)
    sd = np.sqrt(np.maximum(pairs, 1) * np.where(np.array(lags) == 0, 2.0, 1.0))
    weighed, wanted = by_lag / sd[:, None], products / (level * sd)
    size = np.linalg.norm(weighed, axis=0)
    shares, distance = nnls(weighed / size, wanted)
    white = weighed[:, 0] * (weighed[:, 0] @ wanted) / size[0] ** 2
    if np.sum((wanted - white) ** 2) - distance**2 < SEEN:
        return np.asarray((level - 1.0) * spreads[0])
    return np.asarray(np.tensordot(level * shares / size, spreads, axes=1) - spreads[0])


def _geometric(first: float, ratio: float, last: float) -> np.ndarray:
    """Numbers from ``first`` to ``last``, each at most so many times the one before; none if ``last`` is less."""
    steps = int(np.ceil(np.log(last / first) / np.log(ratio) - 1e-9)) if last >= first else -1
    return np.geomspace(first, last, steps + 1) if steps > 0 else np.full(steps + 1, first)


def _until(values: np.ndarray, lag: int) -> np.ndarray:
    """All samples but the last ``lag``."""
    return values[: len(values) - lag]


def _beside(parts: Sequence[Part], others: Sequence[np.ndarray], lag: int) -> np.ndarray:
    """J^T S_l v, summed over runs ``(p, p)``; ``others``: v by run."""
    p = others[0].shape[-1]
    found = np.zeros((p, p))
    for part, v in zip(parts, others, strict=True):
        for a, b in ((part.jacobian[lag:], _until(v, lag)), (_until(part.jacobian, lag), v[lag:])):
            found += 0.5 * a.reshape(-1, p).T @ b.reshape(-1, p)
    return found


def _correlated(values: np.ndarray, rho: float) -> np.ndarray:
    """R v: sum over l of rho^|k - l| v_l."""
    if rho == 0.0:
        return values
    ahead = lfilter([1.0], [1.0, -rho], values, axis=0)
    back = lfilter([1.0], [1.0, -rho], values[::-1], axis=0)[::-1]
    return np.asarray(ahead + back - values)


def unheard(noise: Mapping[str, ChannelNoise]) -> list[str]:
    """A sentence for each channel whose colour no rest told."""
    return [
        f"The colour of the noise of {name} is not known, since nothing stands still for {MIN_REST_SAMPLES} of its "
        "samples. Readings are weighed as if it were white, and intervals allow for the correlation of what the fit "
        "leaves. Record a rest at the start."
        for name, found in sorted(noise.items())
        if found.source == FROM_DIFFERENCES
    ]
