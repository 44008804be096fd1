"""Where each entry of the Hessian is stored, and how the matrix to factorise is read from it.

Storage is by pairs of nodes (i <= j), nine values a pair in row order, so that assembly is addition in
place. The pairs of static terms come first and never move. Pairs that only dynamic terms couple (contact
between deformable bodies) follow; they are looked up in a table that is rewritten in place when the
candidates change. The last value of all swallows entries that are stored at their mirror image. The matrix over
the unknowns is gathered from there:  data = sum over equal (row, column) of  weight * values[order].

With dx = P du for the components x and the unknowns u, the matrix is P^T H P. A component has one unknown with the
weight 1, or none; embedded nodes (:mod:`sim_core.solve.embedding`) have the unknowns of their masters, weighted.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from sim_core.energies.term import PairTable
from sim_core.solve.embedding import Embedding

SPARE_PAIRS = 2048
"""Places for dynamic pairs at the start; doubled whenever they do not suffice."""

_ROW, _COLUMN = np.divmod(np.arange(9), 3)


class Pattern:
    """Storage of one system.

    ``number``: unknown of each component, -1 where prescribed, int ``(3 n_nodes,)``; several components
    may share an unknown. ``static``: node pairs of each static term ``(k, 2)`` and whether it lists a pair
    once only (mirrored). ``embedding``: nodes that move with others; their components have no number.
    """

    def __init__(
        self,
        number: np.ndarray,
        n_unknowns: int,
        static: Sequence[tuple[np.ndarray, bool]],
        embedding: Embedding | None = None,
    ) -> None:
        self.n_unknowns = n_unknowns
        self._n_nodes = len(number) // 3
        self.spread, self._fixed = _spread(np.asarray(number), n_unknowns, embedding)
        diagonal = np.arange(self._n_nodes, dtype=np.int64) * (self._n_nodes + 1)
        keys = [self._keys(blocks) for blocks, _ in static]
        self._static = np.unique(np.concatenate([*keys, diagonal]))
        self._capacity = SPARE_PAIRS
        self._blocks = static
        self._places = [np.searchsorted(self._static, k) for k in keys]
        self._dynamic = np.empty(0, dtype=np.int64)
        self._static_entries = _Entries(self.spread, self._fixed, self._static, self._n_nodes, 0)
        self._static_entries.give_diagonal(np.setdiff1d(np.arange(n_unknowns), self.spread.indices), n_unknowns)
        self._allocate()
        self._gather()

    @property
    def n_values(self) -> int:
        """Length of the array of values, the swallowing one included."""
        return 9 * (len(self._static) + self._capacity) + 1

    @property
    def n_used(self) -> int:
        """Length of the part of the array of values that the matrix is read from."""
        return 9 * (len(self._static) + len(self._dynamic))

    def _keys(self, blocks: np.ndarray) -> np.ndarray:
        blocks = np.asarray(blocks, dtype=np.int64).reshape(-1, 2)
        return np.asarray(blocks.min(axis=1) * self._n_nodes + blocks.max(axis=1))

    def _allocate(self) -> None:
        pairs = len(self._static) + self._capacity
        self.table = PairTable(
            np.zeros(self._n_nodes + 1, dtype=np.int32),
            np.zeros(pairs, dtype=np.int32),
            np.zeros(pairs, dtype=np.int32),
        )

    def static_slots(self) -> list[np.ndarray]:
        """Place of every entry of every block of the static terms: int32 ``(k, 9)`` each."""
        trash = self.n_values - 1
        out = []
        for (blocks, mirrored), place in zip(self._blocks, self._places, strict=True):
            i, j = blocks[:, 0, None], blocks[:, 1, None]
            below = (i > j) | ((i == j) & (_ROW > _COLUMN))
            entry = np.where(below, 3 * _COLUMN + _ROW, np.arange(9))
            slots = 9 * place[:, None] + entry
            missing = below & (not mirrored)
            out.append(np.ascontiguousarray(np.where(missing, trash, slots), dtype=np.int32))
        return out

    def renew(self, blocks: Sequence[np.ndarray]) -> bool:
        """Take the node pairs of the dynamic terms, ``(k, 2)`` each, in any order.

        True when storage had to grow: then all terms must be bound again to larger arrays.
        """
        keys = np.unique(np.concatenate([self._keys(b) for b in blocks]))
        at = np.minimum(np.searchsorted(self._static, keys), len(self._static) - 1)
        self._dynamic = keys[self._static[at] != keys]
        grown = len(self._dynamic) > self._capacity
        if grown:
            self._capacity = 2 * len(self._dynamic)
            self._allocate()
        self._gather()
        return grown

    @property
    def n_dynamic(self) -> int:
        """Number of dynamic pairs."""
        return len(self._dynamic)

    def shared_with(self, others: Sequence[Pattern], most: float) -> list[Pattern]:
        """This pattern and the first of ``others``, as long as all together have at most ``most`` times the pairs of
        any of them."""
        shared, pairs, fewest = [self], self._dynamic, len(self._dynamic)
        for other in others:
            pairs, fewest = np.union1d(pairs, other._dynamic), min(fewest, len(other._dynamic))
            if len(self._static) + len(pairs) > most * (len(self._static) + fewest):
                break
            shared.append(other)
        return shared

    def joined(self, others: Sequence[Pattern]) -> Pattern:
        """A pattern of the same system with the dynamic pairs of ``others`` as well."""
        out = copy.copy(self)
        out._dynamic = np.unique(np.concatenate([self._dynamic, *(p._dynamic for p in others)]))
        out._capacity = len(out._dynamic)
        out._allocate()
        out._gather()
        return out

    def places_in(self, wider: Pattern) -> np.ndarray:
        """Where a pattern that has all pairs of this one stores the values of its dynamic pairs, in order."""
        place = len(self._static) + np.searchsorted(wider._dynamic, self._dynamic)
        return np.asarray((9 * place[:, None] + np.arange(9)).ravel())

    def _gather(self) -> None:
        """Write the table of pairs and the order in which values make up the matrix."""
        static, dynamic = self._static, self._dynamic
        at = _merged(static, dynamic)
        table, count = self.table, len(static) + len(dynamic)
        keys = np.concatenate([static, dynamic])
        table.place[at] = np.arange(count)
        table.column[at] = keys % self._n_nodes
        rows = np.bincount(keys // self._n_nodes, minlength=self._n_nodes)
        table.start[1:] = np.cumsum(rows)
        entries = _Entries(self.spread, self._fixed, dynamic, self._n_nodes, 9 * len(static))
        known = self._static_entries
        self._plain = known.plain and entries.plain
        at = _merged(known.keys, entries.keys)
        matrix_key = np.empty(len(at), dtype=np.int64)
        self._order = np.empty(len(at), dtype=np.int64)
        matrix_key[at] = np.concatenate([known.keys, entries.keys])
        self._order[at] = np.concatenate([known.places, entries.places])
        if not self._plain:
            twice = np.empty(len(at))
            twice[at] = np.concatenate([known.weights, entries.weights])
            first = np.concatenate([[True], matrix_key[1:] != matrix_key[:-1]])
            self._starts = np.flatnonzero(first)
            self._weights = twice
            matrix_key = matrix_key[self._starts]
        row = matrix_key // self.n_unknowns
        self.indices = (matrix_key - row * self.n_unknowns).astype(np.int32)
        self.indptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=self.n_unknowns))]).astype(np.int32)
        self._coupled = np.concatenate([known.coupled, entries.coupled])
        self._coupled_unknown = np.concatenate([known.coupled_unknown, entries.coupled_unknown])
        self._coupled_weights = np.concatenate([known.coupled_weights, entries.coupled_weights])
        self._coupled_fixed = np.concatenate([known.coupled_fixed, entries.coupled_fixed])

    def data(self, values: np.ndarray) -> np.ndarray:
        """Entries of the upper triangle over the unknowns, in the order of ``indices``; a new array."""
        if self._plain:
            return np.asarray(values[self._order])
        return np.asarray(np.add.reduceat(values[self._order] * self._weights, self._starts))

    def matrix(self, data: np.ndarray) -> sp.csr_matrix:
        """Upper triangle over the unknowns as a sparse matrix."""
        n = self.n_unknowns
        return sp.csr_matrix((data, self.indices, self.indptr), shape=(n, n))

    def coupling(self, values: np.ndarray, move: np.ndarray) -> np.ndarray:
        """Force [N] on the unknowns due to moves [m] ``(n_nodes, 3)`` of the prescribed components and of what is
        embedded in them."""
        force = self._coupled_weights * values[self._coupled] * move.ravel()[self._coupled_fixed]
        return np.bincount(self._coupled_unknown, weights=force, minlength=self.n_unknowns)

    def scatter_static(self, blocks: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
        """Add ``values`` ``(k,)`` times the unit matrix to the blocks ``(k, 2)`` of static pairs, i <= j."""
        place = 9 * np.searchsorted(self._static, self._keys(blocks))
        for k in (0, 4, 8):
            np.add.at(out, place + k, values)


class _Entries:
    """Matrix entries of some node pairs, sorted.

    ``keys``: row times number of unknowns plus column; ``places``: of their values; ``weights``: products of the
    weights of two components on their unknowns, doubled where an entry stands for its mirror image as well.
    ``coupled``: places of entries between a component with unknowns (``coupled_unknown``, ``coupled_weights``) and one
    that moves with what is prescribed (``coupled_fixed``). ``plain``: no two entries are at one place of the matrix
    and all weights are 1.
    """

    def __init__(self, spread: sp.csr_matrix, fixed: np.ndarray, pairs: np.ndarray, n_nodes: int, offset: int) -> None:
        node, other = np.divmod(pairs, n_nodes)
        listed = np.flatnonzero(((node != other)[:, None] | (_ROW <= _COLUMN)).ravel())
        left = (3 * node[:, None] + _ROW).ravel()[listed]
        right = (3 * other[:, None] + _COLUMN).ravel()[listed]
        lengths = np.diff(spread.indptr)
        counts = lengths[left] * lengths[right]
        at = np.repeat(np.arange(len(left)), counts)
        nth = np.arange(len(at)) - np.repeat(np.cumsum(counts) - counts, counts)
        first, second = np.divmod(nth, lengths[right[at]])
        first += spread.indptr[left[at]]
        second += spread.indptr[right[at]]
        rows, columns = spread.indices[first].astype(np.int64), spread.indices[second].astype(np.int64)
        single = (left == right)[at]
        kept = np.flatnonzero(~single | (rows <= columns))
        keys = (np.minimum(rows, columns) * spread.shape[1] + np.maximum(rows, columns))[kept]
        order = np.argsort(keys, kind="stable")
        by_key = kept[order]
        self.keys, self.places = keys[order], listed[at[by_key]] + offset
        self.weights = spread.data[first[by_key]] * spread.data[second[by_key]]
        self.weights[(rows == columns)[by_key] & ~single[by_key]] *= 2.0
        self.plain = bool(np.all(self.weights == 1.0)) and not (self.keys[1:] == self.keys[:-1]).any()
        self._couple(spread, listed + offset, left, right, fixed)

    def give_diagonal(self, unknowns: np.ndarray, n_unknowns: int) -> None:
        """Make place on the diagonal for unknowns that no component moves with (a mount that holds others only)."""
        if not len(unknowns):
            return
        keys = np.concatenate([self.keys, unknowns * (n_unknowns + 1)])
        order = np.argsort(keys, kind="stable")
        self.keys = keys[order]
        self.places = np.concatenate([self.places, np.zeros(len(unknowns), dtype=np.int64)])[order]
        self.weights = np.concatenate([self.weights, np.zeros(len(unknowns))])[order]
        self.plain = False

    def _couple(
        self, spread: sp.csr_matrix, places: np.ndarray, left: np.ndarray, right: np.ndarray, fixed: np.ndarray
    ) -> None:
        lengths = np.diff(spread.indptr)
        ways = []
        for one, other, listed in ((left, right, fixed[right]), (right, left, fixed[left] & (left != right))):
            kept = np.flatnonzero(listed & (lengths[one] > 0))
            counts = lengths[one[kept]]
            at = np.repeat(kept, counts)
            unknown = np.arange(len(at)) - np.repeat(np.cumsum(counts) - counts, counts) + spread.indptr[one[at]]
            ways.append((at, unknown, other[at]))
        at, unknown, other = (np.concatenate(part) for part in zip(*ways, strict=True))
        order = np.argsort(at, kind="stable")
        self.coupled = places[at[order]]
        self.coupled_unknown = spread.indices[unknown[order]]
        self.coupled_weights = spread.data[unknown[order]]
        self.coupled_fixed = other[order]


def _spread(number: np.ndarray, n_unknowns: int, embedding: Embedding | None) -> tuple[sp.csr_matrix, np.ndarray]:
    """P ``(n_components, n_unknowns)``, and which components move with what is prescribed."""
    taken = np.flatnonzero(number >= 0)
    starts = np.concatenate([[0], np.cumsum(number >= 0)])
    spread = sp.csr_matrix((np.ones(len(taken)), number[taken], starts), (len(number), n_unknowns))
    fixed = np.asarray(number < 0)
    if embedding is None:
        return spread, fixed
    whole = sp.kron(embedding.matrix(), sp.identity(3)).tocsr()
    spread = (whole @ spread).tocsr()
    spread.sort_indices()
    components = (3 * embedding.nodes[:, None] + np.arange(3)).ravel()
    fixed[components] = False  # but for what their masters make of them
    return spread, np.asarray(abs(whole) @ fixed.astype(float) > 0.0)


def _merged(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Places of the entries of two ascending arrays, one after the other, in their ascending union."""
    second = np.searchsorted(a, b, side="right") + np.arange(len(b))
    taken = np.zeros(len(a) + len(b), dtype=bool)
    taken[second] = True
    return np.concatenate([np.flatnonzero(~taken), second])
