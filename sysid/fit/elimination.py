"""Takes the coefficients of a basis out of a least-squares problem.

For coefficients c of unit variance that add R c to whitened residuals v, the best c leaves

    min_c |v - R c|^2 + |c|^2 = |(v - R c, -c)|^2 = v^T (I + R R^T)^-1 v,    c = (I + R^T R)^-1 R^T v,

which is Woodbury's identity. With [R; I] = [P; S] T of orthonormal columns c = S P^T v, and the map is
v -> (v - P w, -S w) with w = P^T v. What each column has for itself goes first, then what all columns share.
"""

from __future__ import annotations

import numpy as np

from sysid.fit.directions import Basis, Sizes
from sysid.fit.noise import ChannelNoise


class Elimination:
    """The map for a ``basis`` in measured units, of whose samples those that are ``good`` ``(n, m)`` count.

    ``expectation``: the basis, whitened, without its coefficients.
    """

    def __init__(self, basis: Basis, noise: ChannelNoise, good: np.ndarray) -> None:
        white = basis.whitened(noise, good)
        self.expectation = white.without_coefficients()
        self._good = good
        self._own = _orthonormal(np.ascontiguousarray(white.own.transpose(1, 0, 2)))
        self._common = _orthonormal(self._without_own(white.common))
        self.times = np.concatenate([np.tile(basis.own_times, good.shape[1]), basis.common_times])

    def suits(self, good: np.ndarray) -> bool:
        """The same samples count."""
        return np.array_equal(self._good, good)

    def __call__(self, vectors: np.ndarray) -> tuple[np.ndarray, Sizes]:
        """Rows ``(good + coefficients, q)`` for whitened vectors ``(n, m, q)``, and the coefficients that explain the
        first of them; ``times`` [s] says where the rows of coefficients belong."""
        rows = self._without_own(vectors)
        inner = self._common[0].T @ rows
        rows = rows - self._common[0] @ inner
        common = self._common[1] @ inner
        own = -rows[np.count_nonzero(self._good) :, 0].reshape(self._own[1].shape[:2])
        return np.concatenate([rows, -common]), Sizes(common[:, 0], own)

    def _without_own(self, vectors: np.ndarray) -> np.ndarray:
        spans, shares = self._own
        by_column = np.ascontiguousarray(np.where(self._good[:, :, None], vectors, 0.0).transpose(1, 0, 2))
        inner = spans.transpose(0, 2, 1) @ by_column
        left = (by_column - spans @ inner).transpose(1, 0, 2)[self._good]
        return np.concatenate([left, -np.concatenate(list(shares @ inner))])


def _orthonormal(root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """P ``(..., n, k)`` and S ``(..., k, k)`` of [R; I] = [P; S] T for a root R ``(..., n, k)``: T from the Cholesky
    factorisation of I + R^T R, S = T^-1."""
    gram = np.eye(root.shape[-1]) + np.swapaxes(root, -1, -2) @ root
    shares = np.swapaxes(np.linalg.inv(np.linalg.cholesky(gram)), -1, -2)
    return root @ shares, shares
