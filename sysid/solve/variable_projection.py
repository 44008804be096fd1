"""Takes the coefficients of a basis out of a least-squares problem.

For coefficients o that each column has for itself and c that all share, of unit variance, which add O o + C c to
whitened residuals v, the best ones leave

    min_{o,c} |v - O o - C c|^2 + |o|^2 + |c|^2 = |(v - O o - C c, -o, -c)|^2 = v^T (I + O O^T + C C^T)^-1 v,

which is Woodbury's identity. With M = (I + O O^T)^-1 = I - O (I + O^T O)^-1 O^T, block by block of columns,

    c = (I + C^T M C)^-1 C^T M v,    o = (I + O^T O)^-1 O^T (v - C c).

O and C are products of shapes and few functions of time, whitened (:class:`sysid.solve.discretisation_basis.Changes`).
They are never formed but for one column at a time: 254 columns of 2000 samples would make a gigabyte of them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.whitening import Whitening
from sysid.solve.discretisation_basis import Basis, Changes, Sizes, added, told


class Elimination:
    """The map for a ``basis`` in measured units, of whose samples at the times ``t`` [s] ``(n,)`` those that are
    ``good`` ``(n, m)`` count.

    ``times`` [s]: where the rows of coefficients belong.
    """

    def __init__(self, basis: Basis, noise: ChannelNoise, good: np.ndarray, t: np.ndarray) -> None:
        self._basis, self._good = basis, good
        self._whiten = Whitening(noise, good, t, basis.weights(noise))
        self._slopes = self._whiten(basis.slopes)
        own = np.concatenate([p.instants for p in basis.own])
        self.times = np.concatenate([np.tile(own, good.shape[1]), *(p.instants for p in basis.common)])
        pairs = [self._grams(j) for j in range(good.shape[1])]
        self._own = [factor for factor, _ in pairs]
        self._common = np.eye(len(pairs[0][1])) + sum(of_common for _, of_common in pairs)

    def mean_error(self, scaled: np.ndarray | None) -> np.ndarray:
        """Expected error, whitened ``(n, m)``, at scaled parameters; None: where it was measured."""
        return self._whiten(self._basis.expected if scaled is None else self._basis.mean_error(scaled))

    def slopes(self, scaled: np.ndarray) -> np.ndarray:
        """Derivatives of the expected error by the first parameters at scaled ones, whitened ``(n, m, p)``."""
        return np.asarray(self._slopes * self._basis.follows(scaled))

    def suits(self, good: np.ndarray) -> bool:
        """The same samples count."""
        return np.array_equal(self._good, good)

    def __call__(self, vectors: np.ndarray) -> tuple[np.ndarray, Sizes]:
        """Rows ``(good + coefficients, q)`` for whitened vectors ``(n, m, q)``, and the coefficients that explain the
        first of them. The rows of coefficients are those of each column, then those that all share."""
        vectors = np.where(self._good[:, :, None], vectors, 0.0)
        without_own = self._left(vectors, self._basis.own, self._best_own(vectors))
        seen = told(self._basis.common, self._whiten.transposed(without_own), shared=True)
        common = np.linalg.solve(self._common, seen[:, 0])
        left = self._left(vectors, self._basis.common, common[:, None])
        own = self._best_own(left)
        left = self._left(left, self._basis.own, own)
        by_column = own.transpose(1, 0, 2)
        rows = np.concatenate([left[self._good], -by_column.reshape(-1, own.shape[2]), -common])
        return rows, Sizes(common[:, 0], by_column[:, :, 0])

    def _left(self, vectors: np.ndarray, parts: Sequence[Changes], coefficients: np.ndarray) -> np.ndarray:
        return np.asarray(vectors - self._whiten(added(parts, coefficients)))

    def _best_own(self, vectors: np.ndarray) -> np.ndarray:
        """Of the coefficients that columns have for themselves ``(l, m, q)``, where others are 0."""
        found = told(self._basis.own, self._whiten.transposed(vectors), shared=False)
        for j, factor in enumerate(self._own):
            found[:, j] = cho_solve(factor, found[:, j], check_finite=False)
        return found

    def _grams(self, j: int) -> tuple[tuple[np.ndarray, bool], np.ndarray]:
        """Of column ``j``: the Cholesky factor of I + O^T O, and its part of C^T M C."""
        column = self._whiten.of_column(j)
        own, common = (
            column(np.concatenate([p.shape[:, [j]] * p.functions for p in parts], axis=1)[:, None])[:, 0]
            for parts in (self._basis.own, self._basis.common)
        )
        factor = cho_factor(np.eye(own.shape[1]) + own.T @ own, lower=True, check_finite=False)
        crossed = solve_triangular(factor[0], own.T @ common, lower=True, check_finite=False)
        return factor, common.T @ common - crossed.T @ crossed
