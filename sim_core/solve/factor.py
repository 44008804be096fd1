"""Sparse symmetric factorisation behind one interface: analyse once, refactor often, solve.

MKL PARDISO (through its MIT-licensed wheel) where the platform has it, qdldl (Apache-2.0) elsewhere.
Both take the upper triangle in CSR form.
"""

from __future__ import annotations

import os
from typing import Any, Protocol

import numpy as np
import qdldl
import scipy.sparse as sp

os.environ.setdefault("MKL_NUM_THREADS", "1")  # one process a core is the parallelism

try:
    import pymklpardiso
except ImportError:  # no wheel for this platform
    pymklpardiso = None


class NotPositiveDefinite(Exception):
    """The matrix has no Cholesky factorisation."""


class Factor(Protocol):
    """A factorised matrix of fixed pattern."""

    def refactor(self, values: np.ndarray) -> None:
        """Factorise new values of the same pattern. Raises :class:`NotPositiveDefinite`."""
        ...

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve for one right-hand side ``(n,)`` or several ``(n, k)``."""
        ...


class PardisoFactor:
    """MKL PARDISO, positive definite or symmetric indefinite."""

    def __init__(self, upper: sp.csr_matrix, definite: bool) -> None:
        kind = pymklpardiso.MTYPE_REAL_SYM_POSDEF if definite else pymklpardiso.MTYPE_REAL_SYM_INDEF
        try:
            self._solver = self._analyse(upper, kind)
        except RuntimeError as error:
            raise NotPositiveDefinite(str(error)) from error

    @staticmethod
    def _analyse(upper: sp.csr_matrix, kind: int) -> Any:
        """The public constructor, without its row-by-row check that the matrix is upper triangular."""
        bare = getattr(pymklpardiso, "_PardisoSolver", None)
        if bare is None:
            return pymklpardiso.PardisoSolver(upper, kind)
        solver = pymklpardiso.PardisoSolver.__new__(pymklpardiso.PardisoSolver)
        solver._dtype = np.float64
        solver._solver = bare(kind, 0)
        indptr, indices = upper.indptr.astype(np.int64), upper.indices.astype(np.int64)
        solver._solver.set_pattern(ia=indptr, ja=indices, n=upper.shape[0])
        solver._solver.factor(upper.data)
        return solver

    def refactor(self, values: np.ndarray) -> None:
        try:
            self._solver.refactor(values)
        except RuntimeError as error:
            raise NotPositiveDefinite(str(error)) from error

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        return np.asarray(self._solver.solve(np.asfortranarray(rhs) if rhs.ndim == 2 else rhs))


class QdldlFactor:
    """LDL^T for quasi-definite matrices; the fallback on every platform."""

    def __init__(self, upper: sp.csr_matrix, definite: bool) -> None:
        self._pattern = upper.copy()
        self._definite = definite
        self._solver = qdldl.Solver(self._symmetric(upper.data))

    def _symmetric(self, values: np.ndarray) -> sp.csc_matrix:
        upper = sp.csr_matrix((values, self._pattern.indices, self._pattern.indptr), self._pattern.shape)
        return (upper + sp.triu(upper, 1).T).tocsc()

    def refactor(self, values: np.ndarray) -> None:
        try:
            self._solver = qdldl.Solver(self._symmetric(values))
        except RuntimeError as error:
            raise NotPositiveDefinite(str(error)) from error
        if self._definite and np.any(self._solver.factors()[1] <= 0.0):
            raise NotPositiveDefinite("a pivot is not positive")

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        if rhs.ndim == 2:
            return np.column_stack([self._solver.solve(column) for column in rhs.T])
        return np.asarray(self._solver.solve(rhs))


def factorise(upper: sp.csr_matrix, definite: bool = True) -> Factor:
    """Analyse and factorise. ``definite``: insist on a positive definite matrix."""
    if pymklpardiso is not None:
        return PardisoFactor(upper, definite)
    return QdldlFactor(upper, definite)
