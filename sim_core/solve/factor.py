"""Sparse symmetric factorisation behind one interface: analyse once, refactor often, solve.

MKL PARDISO (through its MIT-licensed wheel) where the platform has it, else qdldl (Apache-2.0), else scipy's
SuperLU. All take the upper triangle in CSR form.
"""

from __future__ import annotations

import ctypes
import os
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

os.environ.setdefault("MKL_NUM_THREADS", "1")  # one process a core is the parallelism

try:
    import pymklpardiso
except ImportError:  # no wheel for this platform
    pymklpardiso = None

try:
    import qdldl
except ImportError:
    qdldl = None


def pardiso_address() -> int | None:
    """Address of MKL's ``pardiso_64`` in the library of the wheel, for compiled code; None where there is none."""
    if pymklpardiso is None:
        return None
    found = getattr(ctypes.CDLL(pymklpardiso._mkl_pardiso.__file__), "pardiso_64", None)
    return None if found is None else ctypes.cast(found, ctypes.c_void_p).value


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

    def size_bytes(self) -> int:
        """Memory of factors and analysis."""
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

    def size_bytes(self) -> int:
        analysis_kb, factors_kb = (self._solver.get_iparm_value(k) for k in (15, 16))
        return int(1024 * (analysis_kb + factors_kb) + 16 * self._solver.nnz)  # and its copy of the matrix


class _Columns:
    """From values in rows of the upper triangle to a matrix in columns, without sorting anew."""

    def __init__(self, upper: sp.csr_matrix) -> None:
        numbered = sp.csr_matrix((np.arange(1.0, upper.nnz + 1.0), upper.indices, upper.indptr), upper.shape)
        self._pattern = numbered.tocsc()
        self._order = self._pattern.data.astype(np.int64) - 1
        self.nnz = int(upper.nnz)

    def upper(self, values: np.ndarray) -> sp.csc_matrix:
        pattern = self._pattern
        return sp.csc_matrix((values[self._order], pattern.indices, pattern.indptr), pattern.shape)


class QdldlFactor:
    """LDL^T for quasi-definite matrices."""

    def __init__(self, upper: sp.csr_matrix, definite: bool) -> None:
        self._columns = _Columns(upper)
        self._definite = definite
        self._solver: Any = None
        self.refactor(upper.data)

    def refactor(self, values: np.ndarray) -> None:
        matrix = self._columns.upper(values)
        try:
            if self._solver is None:
                self._solver = qdldl.Solver(matrix, upper=True)
            else:
                self._solver.update(matrix, upper=True)
        except (RuntimeError, ValueError) as error:
            self._solver = None
            raise NotPositiveDefinite(str(error)) from error
        if self._definite and not np.all(self._solver.factors()[1] > 0.0):
            raise NotPositiveDefinite("a pivot is not positive")

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        if rhs.ndim == 2:
            return np.column_stack([self._solver.solve(column) for column in rhs.T])
        return np.asarray(self._solver.solve(rhs))

    def size_bytes(self) -> int:
        return 16 * (int(self._solver.factors()[0].nnz) + self._columns.nnz)


class SuperluFactor:
    """LU of scipy, without pivoting where a positive definite matrix is wanted; works everywhere."""

    def __init__(self, upper: sp.csr_matrix, definite: bool) -> None:
        self._columns = _Columns(upper)
        self._definite = definite
        self.refactor(upper.data)

    def refactor(self, values: np.ndarray) -> None:
        upper = self._columns.upper(values)
        matrix = (upper + sp.triu(upper, 1).T).tocsc()
        symmetric = {"diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}} if self._definite else {}
        try:
            self._solver = splu(matrix, permc_spec="MMD_AT_PLUS_A", **symmetric)
        except RuntimeError as error:
            raise NotPositiveDefinite(str(error)) from error
        if self._definite:
            on_diagonal = np.array_equal(self._solver.perm_r, self._solver.perm_c)
            if not on_diagonal or not np.all(self._solver.U.diagonal() > 0.0):
                raise NotPositiveDefinite("a pivot is not positive")

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        return np.asarray(self._solver.solve(rhs))

    def size_bytes(self) -> int:
        return 12 * int(self._solver.L.nnz + self._solver.U.nnz) + 16 * self._columns.nnz


def factorise(upper: sp.csr_matrix, definite: bool = True) -> Factor:
    """Analyse and factorise. ``definite``: insist on a positive definite matrix."""
    if pymklpardiso is not None:
        return PardisoFactor(upper, definite)
    if qdldl is not None:
        return QdldlFactor(upper, definite)
    return SuperluFactor(upper, definite)
