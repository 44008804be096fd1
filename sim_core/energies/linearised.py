"""Exact derivatives of what a term with memory does in one step.

Besides the positions x' at the end of the step, the gradient R = dE/dx' of such a term depends on the positions x
at its start and on its internal variables xi, and it has new ones afterwards, xi' = G(x'; x, xi). All of it is
local: an element or a sample depends on its own nodes and its own internal variables. The derivatives are therefore
small dense blocks, placed in sparse matrices; what the Hessian already is (dR/dx') is left out.

The blocks come from closed forms, or from a complex step,  df/dz = Im f(z + i h) / h  with h = 1e-30, which has no
cancellation (Squire & Trapp, SIAM Review 40, 1998): one call for all elements and all inputs at once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from sim_core.energies.term import Internals

_TINY = 1e-30


@dataclass(frozen=True)
class Blocks:
    """A sparse matrix as a sum of small dense blocks. ``parts``: values ``(n, a, b)`` at rows ``(n, a)`` and columns
    ``(n, b)``, which may repeat."""

    parts: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    shape: tuple[int, int]

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for part in self.parts for a in part)

    def __matmul__(self, other: np.ndarray) -> np.ndarray:
        """Product with a vector, or with several in the columns of a matrix."""
        if other.ndim == 1:
            return gathered(
                *((np.einsum("nab,nb->na", v, other[columns]), rows) for v, rows, columns in self.parts),
                size=self.shape[0],
            )
        count = other.shape[1]
        each = np.arange(count)
        found = gathered(
            *((v @ other[columns], rows[..., None] * count + each) for v, rows, columns in self.parts),
            size=self.shape[0] * count,
        )
        return found.reshape(self.shape[0], count)

    def back(self, other: np.ndarray) -> np.ndarray:
        """Product of the transpose with a vector."""
        return gathered(
            *((np.einsum("nab,na->nb", v, other[rows]), columns) for v, rows, columns in self.parts),
            size=self.shape[1],
        )

    def tocsr(self) -> sp.csr_matrix:
        """The same as a matrix of scipy."""
        flat = [[np.empty(0)], [np.empty(0, dtype=int)], [np.empty(0, dtype=int)]]
        for v, rows, columns in self.parts:
            flat[0].append(v.ravel())
            flat[1].append(np.broadcast_to(rows[:, :, None], v.shape).ravel())
            flat[2].append(np.broadcast_to(columns[:, None, :], v.shape).ravel())
        values, at, by = (np.concatenate(f) for f in flat)
        return sp.csr_matrix((values, (at, by)), shape=self.shape)


@dataclass(frozen=True)
class Chain:
    """A product of sparse matrices that is not multiplied out: what it is applied to goes through one after the other,
    the last first."""

    factors: tuple[Matrix, ...]

    @property
    def nbytes(self) -> int:
        return sum(_nbytes(f) for f in self.factors)

    def __matmul__(self, other: np.ndarray) -> np.ndarray:
        """Product with a vector, or with several in the columns of a matrix."""
        for factor in reversed(self.factors):
            other = np.asarray(factor @ other)
        return other

    def back(self, other: np.ndarray) -> np.ndarray:
        """Product of the transpose with a vector."""
        for factor in self.factors:
            other = np.asarray(times_back(factor, other))
        return other


@dataclass(frozen=True)
class Transposed:
    """The transpose of a sparse matrix that is not formed."""

    matrix: Blocks

    @property
    def nbytes(self) -> int:
        return self.matrix.nbytes

    def __matmul__(self, other: np.ndarray) -> np.ndarray:
        """Product with a vector, or with several in the columns of a matrix."""
        parts = ((v.transpose(0, 2, 1), columns, rows) for v, rows, columns in self.matrix.parts)
        return Blocks(tuple(parts), self.matrix.shape[::-1]) @ other

    def back(self, other: np.ndarray) -> np.ndarray:
        """Product of the matrix itself with a vector."""
        return self.matrix @ other


Matrix = Any
"""A sparse matrix: :class:`Blocks`, a :class:`Chain`, :class:`Transposed`, or one of scipy's."""


@dataclass(frozen=True)
class ByNumber:
    """Derivatives by one number of a term: of dE/dx' ``(3 n_nodes)``, of the new internal variables ``(q')`` and of the
    moment on a rigid body ``(3)``."""

    force: np.ndarray
    memory: np.ndarray
    moment: np.ndarray


@dataclass(frozen=True)
class Linearised:
    """Derivatives of one term in one step. None: zero.

    ``force_*``: of dE/dx', ``(3 n_nodes, .)``; ``memory_*``: of the new internal variables, flattened, ``(q', .)``;
    ``moment_*``: of the moment [N m] of a rigid body's surface forces about its node, ``(3, .)``. By what: ``start``:
    x at the start ``(3 n_nodes)``; ``past``: x at the start of the step before, which rates of BDF2 look back to;
    ``memory``: the old internal variables ``(q)``; ``end``: x' ``(3 n_nodes)``;
    ``turn``: a small turn of the rigid body at the end of the step, in its own frame [rad] ``(3)``; ``rest``: what a
    contact measures on the shape at rest, its ``measures`` (:mod:`sim_core.contact.measures`) in a row. ``numbers``: by
    those numbers of the term whose differences could cross a switch of its law: a point that has come to rest is
    exactly at the slip limit, a fold that is held exactly at yield.
    """

    force_start: Matrix | None = None
    force_past: Matrix | None = None
    force_memory: Matrix | None = None
    force_turn: Matrix | None = None
    force_rest: Matrix | None = None
    memory_start: Matrix | None = None
    memory_memory: Matrix | None = None
    memory_end: Matrix | None = None
    memory_turn: Matrix | None = None
    memory_rest: Matrix | None = None
    moment_start: Matrix | None = None
    moment_memory: Matrix | None = None
    moment_end: Matrix | None = None
    moment_turn: Matrix | None = None
    moment_rest: Matrix | None = None
    numbers: dict[str, ByNumber] = field(default_factory=dict)

    @property
    def remembers(self) -> bool:
        """Whether anything depends on the start of the step or on the old internal variables."""
        by_start = ("force_start", "force_past", "force_memory", "memory_start", "memory_memory")
        return any(not vanishes(getattr(self, name)) for name in by_start)

    def size_bytes(self) -> int:
        """Memory of all matrices and numbers."""
        total = sum(a.nbytes for n in self.numbers.values() for a in (n.force, n.memory, n.moment))
        return total + sum(_nbytes(matrix) for matrix in vars(self).values() if not isinstance(matrix, dict))


def _nbytes(matrix: Matrix | None) -> int:
    """Memory of a matrix."""
    if matrix is None:
        return 0
    # Of one of scipy's two indices of half the length a value.
    return int(2 * matrix.data.nbytes if sp.issparse(matrix) else matrix.nbytes)


def times(matrix: Matrix | None, vector: np.ndarray) -> np.ndarray | float:
    """Product with a matrix that may be zero."""
    return 0.0 if matrix is None else np.asarray(matrix @ vector)


def times_back(matrix: Matrix | None, vector: np.ndarray) -> np.ndarray | float:
    """Product of the transpose of a matrix that may be zero with a vector."""
    if matrix is None:
        return 0.0
    return np.asarray(matrix.T @ vector if sp.issparse(matrix) else matrix.back(vector))


def vanishes(matrix: Matrix | None) -> bool:
    """Whether a matrix is zero."""
    if isinstance(matrix, Blocks):
        return not any(values.any() for values, _, _ in matrix.parts)
    if isinstance(matrix, Transposed):
        return vanishes(matrix.matrix)
    if isinstance(matrix, Chain):
        return any(vanishes(factor) for factor in matrix.factors)
    return matrix is None or not matrix.count_nonzero()


def flatten(internals: Internals) -> np.ndarray:
    """All internal variables of a term as one vector, in their order."""
    return np.concatenate([np.empty(0), *(a.ravel() for a in internals.values())])


def size_of(internals: Internals) -> int:
    """Length of that vector."""
    return sum(a.size for a in internals.values())


def unflatten(vector: np.ndarray, like: Internals) -> Internals:
    """The inverse of :func:`flatten`."""
    out, at = {}, 0
    for name, array in like.items():
        out[name] = vector[at : at + array.size].reshape(array.shape)
        at += array.size
    return out


def places(internals: Internals) -> dict[str, np.ndarray]:
    """Where each internal variable is in the flattened vector: arrays of its shape."""
    return unflatten(np.arange(size_of(internals)), internals)


def axes_of(nodes: np.ndarray) -> np.ndarray:
    """Places of the components of nodes ``(..., k)`` in a flattened ``(n_nodes, 3)`` array: ``(..., 3 k)``."""
    axes = 3 * np.asarray(nodes, dtype=np.int64)[..., None] + np.arange(3)
    return np.asarray(axes.reshape(*axes.shape[:-2], -1))


def placed(*parts: tuple[np.ndarray, np.ndarray, np.ndarray], shape: tuple[int, int]) -> Blocks:
    """Sum of dense blocks ``(n, a, b)`` at rows ``(n, a)`` and columns ``(n, b)``; a part: all three."""
    index = np.int32 if max(shape) < 2**31 else np.int64
    kept = [(np.ascontiguousarray(v), r.astype(index), c.astype(index)) for v, r, c in parts if v.size]
    return Blocks(tuple(kept), shape)


def complex_step(function: Callable[..., tuple[np.ndarray, ...]], *inputs: np.ndarray) -> list[list[np.ndarray]]:
    """Derivatives of every output by every input, as ``found[output][input]``, outputs' shape then inputs' shape.

    ``inputs``: ``(n, ...)``, one row an element; ``function`` takes them with a further first axis and must be
    analytic in them (no absolute values or norms; choices by real parts).
    """
    sizes = [int(np.prod(z.shape[1:])) for z in inputs]
    total = sum(sizes)
    stepped, at = [], 0
    for z, size in zip(inputs, sizes, strict=True):
        moved = np.repeat(z[None].astype(complex), total, axis=0)
        flat = moved.reshape(total, len(z), size)
        flat[np.arange(at, at + size), :, np.arange(size)] += 1j * _TINY
        stepped.append(moved)
        at += size
    found = []
    for output in function(*stepped):
        slopes = np.moveaxis(output.imag / _TINY, 0, -1)
        parts = np.split(slopes, np.cumsum(sizes)[:-1], axis=-1)
        found.append([p.reshape(*p.shape[:-1], *z.shape[1:]) for p, z in zip(parts, inputs, strict=True)])
    return found


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Vector products along the last axis, complex vectors too."""
    p, q = [1, 2, 0], [2, 0, 1]
    return np.asarray(a[..., p] * b[..., q] - a[..., q] * b[..., p])


def gathered(*parts: tuple[np.ndarray, np.ndarray], size: int) -> np.ndarray:
    """Sum of values at places, both ``(n, ...)``, in a vector of ``size``."""
    sums = [np.bincount(at.ravel(), weights=values.ravel(), minlength=size) for values, at in parts]
    return np.asarray(sum(sums[1:], sums[0]) if sums else np.zeros(size))


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sums of products along the last axis, without complex conjugation."""
    return np.asarray((a * b).sum(axis=-1))


def skew(v: np.ndarray) -> np.ndarray:
    """Matrices ``(n, 3, 3)`` of the products v x from ``(n, 3)``."""
    out = np.zeros((*v.shape, 3), dtype=v.dtype)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j], out[..., j, i] = -v[..., k], v[..., k]
    return out
