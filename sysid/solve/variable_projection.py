"""Takes the coefficients of a basis out of a least-squares problem.

Whitened residuals v of a channel hold noise of unit variance, O o of coefficients o that each column has for
itself, C c of coefficients c that all columns share, and G^T s of the noise that all markers of a picture have in
common (:mod:`sysid.noise.common_mode`), all of unit variance. They have one covariance, and the best coefficients leave

    min_{o,c} |P (v - O o - C c)|^2 + |o|^2 + |c|^2 = v^T (I + G^T G + O O^T + C C^T)^-1 v,    P = (I + G^T G)^(-1/2),

the norm of the rows (P (v - O o - C c), -o, -c). By Woodbury's identity, with M = (I + O O^T)^-1 = I - O (I + O^T O)^-1
O^T, block by block of columns, and B = (C, G^T), b = (c, s),

    b = (I + B^T M B)^-1 B^T M v,    o = (I + O^T O)^-1 O^T (v - B b).

The common noise is in the same inverse as the coefficients: weighed down after these were found, it would have driven
them first, since each column would have been taken for a witness of its own. O and C are products of shapes and few
functions of time, whitened (:class:`sysid.solve.discretisation_basis.Changes`). They are never formed but for one
column at a time: 254 columns of 2000 samples would make a gigabyte of them. (Kennedy & O'Hagan, J. R. Stat. Soc. B 63,
2001, section 4.2; Hager, SIAM Review 31, 1989, for the identity.)
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.common_mode import CommonWhitening
from sysid.noise.whitening import Whitening
from sysid.solve.discretisation_basis import Basis, Changes, Sizes, added, added_transpose


class Elimination:
    """The map for a ``basis`` in measured units, of whose samples at the times ``t`` [s] ``(n,)`` those that are
    ``good`` ``(n, m)`` count. ``common`` ``(n, r, m)``: deviations that whitened samples of one instant have in common,
    weighted as the samples are (:meth:`sysid.noise.common_mode.CommonMode.deviations`); None: nothing.

    ``times`` [s]: where the rows of coefficients belong.
    """

    def __init__(
        self, basis: Basis, noise: ChannelNoise, good: np.ndarray, t: np.ndarray, common: np.ndarray | None = None
    ) -> None:
        self._basis, self._good = basis, good
        self._whiten = Whitening(noise, good, t, basis.weights(noise))
        self._slopes = self._whiten(basis.slopes)
        self._deviations = np.zeros((len(good), 0, good.shape[1])) if common is None else common * good[:, None]
        self._whiten_common = CommonWhitening(self._deviations)
        own = np.concatenate([p.instants for p in basis.own])
        self.times = np.concatenate([np.tile(own, good.shape[1]), *(p.instants for p in basis.common)])
        self._count = sum(len(p.instants) for p in basis.common)
        self._own: list[tuple[np.ndarray, bool]] = []
        self._shared = cho_factor(self._information(), lower=True, check_finite=False)

    def mean_error(self, scaled: np.ndarray | None) -> np.ndarray:
        """Expected error, whitened ``(n, m)``, at scaled parameters; None: where it was measured."""
        return self._whiten(self._basis.expected if scaled is None else self._basis.mean_error(scaled))

    def slopes(self, scaled: np.ndarray) -> np.ndarray:
        """Derivatives of the expected error by the first parameters at scaled ones, whitened ``(n, m, p)``."""
        return np.asarray(self._slopes * self._basis.in_reach(scaled))

    def suits(self, good: np.ndarray) -> bool:
        """The same samples count."""
        return np.array_equal(self._good, good)

    def __call__(self, vectors: np.ndarray) -> tuple[np.ndarray, Sizes]:
        """Rows ``(good + coefficients, q)`` for whitened vectors ``(n, m, q)``, and the coefficients that explain the
        first of them. The rows of coefficients are those of each column, then those that all share."""
        vectors = np.where(self._good[:, :, None], vectors, 0.0)
        without_own = self._left(vectors, self._basis.own, self._best_own(vectors))
        seen = added_transpose(self._basis.common, self._whiten.transposed(without_own), shared=True)[:, 0]
        in_pictures = (self._deviations @ without_own).reshape(-1, vectors.shape[2])
        shared = cho_solve(self._shared, np.concatenate([seen, in_pictures]), check_finite=False)
        common = shared[: self._count]
        of_noise = shared[self._count :].reshape(*self._deviations.shape[:2], vectors.shape[2])
        left = self._left(vectors, self._basis.common, common[:, None])
        own = self._best_own(left - self._deviations.transpose(0, 2, 1) @ of_noise)
        left = self._whiten_common(self._left(left, self._basis.own, own))
        by_column = own.transpose(1, 0, 2)
        rows = np.concatenate([left[self._good], -by_column.reshape(-1, own.shape[2]), -common])
        return rows, Sizes(common[:, 0], by_column[:, :, 0])

    def _left(self, vectors: np.ndarray, parts: Sequence[Changes], coefficients: np.ndarray) -> np.ndarray:
        return np.asarray(vectors - self._whiten(added(parts, coefficients)))

    def _best_own(self, vectors: np.ndarray) -> np.ndarray:
        """Of the coefficients that columns have for themselves ``(l, m, q)``, where others are 0."""
        found = added_transpose(self._basis.own, self._whiten.transposed(vectors), shared=False)
        for j, factor in enumerate(self._own):
            found[:, j] = cho_solve(factor, found[:, j], check_finite=False)
        return found

    def _information(self) -> np.ndarray:
        """I + B^T M B of what columns share, coefficients first; on the way the Cholesky factor of I + O^T O of each
        column."""
        n, r, m = self._deviations.shape
        k = self._count
        found = np.zeros((k + n * r, k + n * r))
        crossed, of_noise = found[:k, k:].reshape(k, n, r), found[k:, k:].reshape(n, r, n, r)
        for j in range(m):
            column, deviation = self._whiten.of_column(j), self._deviations[:, :, j]
            own, common = (
                column(np.concatenate([p.shape[:, [j]] * p.functions for p in parts], axis=1)[:, None])[:, 0]
                for parts in (self._basis.own, self._basis.common)
            )
            factor = cho_factor(np.eye(own.shape[1]) + own.T @ own, lower=True, check_finite=False)
            self._own.append(factor)
            half = solve_triangular(factor[0], own.T, lower=True, check_finite=False)
            left = common - half.T @ (half @ common)
            found[:k, :k] += common.T @ left
            if r:
                crossed += left.T[:, :, None] * deviation
                smoothed = half.T @ half
                for a, b in product(range(r), range(r)):
                    of_noise[:, a, :, b] -= deviation[:, a, None] * smoothed * deviation[:, b]
        if r:
            found[k:, :k] = crossed.reshape(k, n * r).T
            within, at = self._deviations @ self._deviations.transpose(0, 2, 1), np.arange(n)
            of_noise[at, :, at, :] += within
        found[np.diag_indices_from(found)] += 1.0
        return found
