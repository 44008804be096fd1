"""The colour of noise that no rest told, from what the fit leaves.

Without a rest the noise of a channel is taken for white, with the level that neighbouring samples show. Coloured noise
is then underrated twice: its level by the differences, and how alike its samples are. What the fit leaves shows both:
in each quantity of a channel it is taken for first-order autoregressive noise of variance v, in units of the level
assumed, and correlations R_kl = rho^|k - l|. Both follow from two moments of the residuals r, beside what the
parameters take up of them, H = J A J^T (A: inverse information; S: mean of both neighbours):

    E[r^T r] = v tr((I - H) R (I - H)),    E[r^T S r] = v tr((I - H) S (I - H) R).

The scores J^T r then have the covariance v J^T R J instead of J^T J. Only intervals know of it, and only where it
widens them. Estimates, and the misfit that tells whether something is missing, stay those of the noise assumed: what a
missing law leaves is correlated, too, and is not to pass for noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from sysid.fit.noise import FROM_DIFFERENCES, MIN_REST_SAMPLES, WHITE, ChannelNoise

ROUNDS = 8
"""Times that the correlation is corrected for what the parameters take up."""

MOST = 0.99
"""Largest correlation that is believed."""


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
    """By how much the covariance of the scores exceeds the information ``(p, p)``: sum of v J^T R J - J^T J over
    quantities, of which each has a part in some runs; ``inverse`` ``(p, p)``: A."""
    excess = np.zeros(inverse.shape)
    for parts in quantities:
        number = sum(int(part.there.sum()) for part in parts)
        if number > len(inverse) and any(part.residual.any() for part in parts):
            excess += _excess(parts, number, inverse)
    return excess


def _excess(parts: Sequence[Part], number: int, inverse: np.ndarray) -> np.ndarray:
    """v J^T R J - J^T J of one quantity."""
    pairs = sum(int((part.there[1:] & part.there[:-1]).sum()) for part in parts)
    square = sum(float(np.sum(part.residual**2)) for part in parts)
    product = sum(float(np.sum(part.residual[1:] * part.residual[:-1])) for part in parts)
    plain = _product(parts, [part.jacobian for part in parts])
    beside = [_neighbours(part.jacobian) for part in parts]
    taken = inverse @ plain @ inverse
    taken_beside = inverse @ _product(parts, beside) @ inverse
    rho, spread, left = 0.0, plain, 1.0
    for k in range(ROUNDS):
        correlated = [_correlated(part.jacobian, rho) for part in parts]
        spread = _product(parts, correlated)
        left = max(number - 2.0 * float(np.sum(inverse * spread)) + float(np.sum(taken * spread)), 1.0)
        if k == ROUNDS - 1:
            break
        crossed = sum(np.tensordot(b, c, axes=([0, 1], [0, 1])) for b, c in zip(beside, correlated, strict=True))
        left_beside = pairs * rho - 2.0 * np.sum(inverse * crossed) + np.sum(taken_beside * spread)
        rho = float(np.clip(rho + product / square - left_beside / left, 0.0, MOST))
        if k == ROUNDS - 2 and rho <= WHITE:
            rho = 0.0
    return np.asarray(spread * (square / left) - plain)


def _product(parts: Sequence[Part], others: Sequence[np.ndarray]) -> np.ndarray:
    """Sum of J^T v over runs ``(p, p)``."""
    p = others[0].shape[-1]
    pairs = zip(parts, others, strict=True)
    return np.asarray(sum(part.jacobian.reshape(-1, p).T @ v.reshape(-1, p) for part, v in pairs))


def _neighbours(values: np.ndarray) -> np.ndarray:
    """S v: half the sum of the samples before and after."""
    out = np.zeros_like(values)
    out[1:] += 0.5 * values[:-1]
    out[:-1] += 0.5 * values[1:]
    return out


def _correlated(values: np.ndarray, rho: float) -> np.ndarray:
    """R v: sum over l of rho^|k - l| v_l."""
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
