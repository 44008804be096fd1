"""Where noisy samples of a coordinate are those of one that is at rest.

Of a hand that moved before and will move again, a smoothed curve creeps by a part of the noise while it rests; so
little, but enough to turn the friction of whatever it holds from one limit to the other. A rest is therefore found
first. A sample is in motion if the means of the h samples before and after it, or after one that is less than h away,
differ by more than noise makes of one in a thousand series, for h = 1, 2, 4, 8. What is left in a row is at rest unless
it drifts: the squares of its coefficients of the first four Legendre polynomials, in units of the noise, are those of
chi-squared of four degrees of freedom for one that rests (one in a thousand is missed). What drifts is cut, an eighth
at a time, at the end that has more part in that: motions begin and end slowly. What drifts by half of it does not rest.
"""

from __future__ import annotations

import numpy as np

from sim_core.rigs.fields import FloatArray

SCALES = (1, 2, 4, 8)
"""Samples of which means are compared."""

FEWEST_AT_REST = 20
"""Samples in a row of which that can be said."""

MISSED = 1e-3
"""Share of the series, and of the rests in these, that are taken for motions by chance."""


def rests(values: FloatArray, sigma: float) -> list[slice]:
    """Samples in a row of ``values`` ``(n,)``, with noise of the standard deviation ``sigma``, at rest."""
    from scipy.special import ndtri

    n = len(values)
    total = np.concatenate([[0.0], np.cumsum(values - values.mean())])
    limit = -float(ndtri(0.5 * MISSED / max(n, 1)))
    moves = np.zeros(n, dtype=bool)
    for h in SCALES:
        if n < 2 * h:
            break
        mean = (total[h:] - total[:-h]) / h
        apart = np.abs(mean[h:] - mean[:-h]) > limit * sigma * np.sqrt(2.0 / h)
        for k in np.flatnonzero(apart):
            moves[k : k + 2 * h] = True
    edges = np.flatnonzero(np.diff(np.concatenate([[1], moves.astype(int), [1]])))
    found = (_without_drift(values, sigma, int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True))
    return [span for span in found if span is not None]


def _without_drift(values: FloatArray, sigma: float, first: int, end: int) -> slice | None:
    """The samples from ``first`` to before ``end`` less those at its ends with which it drifts; None where too few
    are left, or less than half."""
    from scipy.special import chdtri

    limit, fewest = float(chdtri(4, MISSED)), max(FEWEST_AT_REST, (end - first) // 2)
    while end - first >= fewest:
        if _drift(values[first:end], sigma) <= limit:
            return slice(first, end)
        less = max(1, (end - first) // 8)
        if _drift(values[first + less : end], sigma) < _drift(values[first : end - less], sigma):
            first += less
        else:
            end -= less
    return None


def _drift(values: FloatArray, sigma: float) -> float:
    """The squares of the coefficients of the first four polynomials, in units of the noise, of values ``(n,)``."""
    basis, _ = np.linalg.qr(np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(values)), 4))
    return float(np.sum((basis[:, 1:].T @ values) ** 2)) / sigma**2
