"""Where each entry of the Hessian is stored, and how the matrix to factorise is read from it.

Storage is by pairs of nodes (i <= j), nine values a pair in row order, so that assembly is addition in
place. The pairs of static terms come first and never move. Pairs that only dynamic terms couple (contact
between deformable bodies) follow; they are looked up in a table that is rewritten in place when the
candidates change. The last value of all swallows entries that are stored at their mirror image. The matrix over
the unknowns is gathered from there:  data = sum over equal (row, column) of  weight * values[order].
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from sim_core.energies.term import PairTable

SPARE_PAIRS = 2048
"""Places for dynamic pairs at the start; doubled whenever they do not suffice."""

_ROW, _COLUMN = np.divmod(np.arange(9), 3)


class Pattern:
    """Storage of one system.

    ``number``: unknown of each component, -1 where prescribed, int ``(3 n_nodes,)``; several components
    may share an unknown. ``static``: node pairs of each static term ``(k, 2)`` and whether it lists a pair
    once only (mirrored).
    """

    def __init__(self, number: np.ndarray, n_unknowns: int, static: Sequence[tuple[np.ndarray, bool]]) -> None:
        self.n_unknowns = n_unknowns
        self._number = np.asarray(number, dtype=np.int64)
        self._n_nodes = len(number) // 3
        diagonal = np.arange(self._n_nodes, dtype=np.int64) * (self._n_nodes + 1)
        keys = [self._keys(blocks) for blocks, _ in static]
        self._static = np.unique(np.concatenate([*keys, diagonal]))
        self._capacity = SPARE_PAIRS
        self._blocks = static
        self._places = [np.searchsorted(self._static, k) for k in keys]
        self._dynamic = np.empty(0, dtype=np.int64)
        self._static_entries = _Entries(self._number, n_unknowns, self._static, self._n_nodes, 0)
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
        entries = _Entries(self._number, self.n_unknowns, dynamic, self._n_nodes, 9 * len(static))
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
        """Force [N] on the unknowns due to moves [m] ``(n_nodes, 3)`` of the prescribed components."""
        force = values[self._coupled] * move.ravel()[self._coupled_fixed]
        return np.bincount(self._coupled_unknown, weights=force, minlength=self.n_unknowns)

    def scatter_static(self, blocks: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
        """Add ``values`` ``(k,)`` times the unit matrix to the blocks ``(k, 2)`` of static pairs, i <= j."""
        place = 9 * np.searchsorted(self._static, self._keys(blocks))
        for k in (0, 4, 8):
            np.add.at(out, place + k, values)


class _Entries:
    """Matrix entries of some node pairs, sorted.

    ``keys``: row times number of unknowns plus column; ``places``: of their values; ``weights``: 2 where an
    entry stands for its mirror image as well. ``coupled``: places of entries between an unknown
    (``coupled_unknown``) and a prescribed component (``coupled_fixed``). ``plain``: no two entries are at one
    place of the matrix and all weights are 1.
    """

    def __init__(self, number: np.ndarray, n_unknowns: int, pairs: np.ndarray, n_nodes: int, offset: int) -> None:
        node, other = np.divmod(pairs, n_nodes)
        left = number[3 * node[:, None] + _ROW]
        right = number[3 * other[:, None] + _COLUMN]
        upper = (node != other)[:, None] | (_ROW <= _COLUMN)
        rows, columns = np.minimum(left, right), np.maximum(left, right)
        kept = np.flatnonzero(((rows >= 0) & upper).ravel())
        keys = rows.ravel()[kept] * n_unknowns + columns.ravel()[kept]
        by_key = np.argsort(keys, kind="stable")
        self.keys, self.places = keys[by_key], kept[by_key] + offset
        twice = ((node != other)[:, None] & (left == right)).ravel()[kept[by_key]]
        self.weights = np.where(twice, 2.0, 1.0)
        self.plain = not twice.any() and not (self.keys[1:] == self.keys[:-1]).any()
        coupled = np.flatnonzero((((left < 0) != (right < 0)) & upper).ravel())
        self.coupled = coupled + offset
        self.coupled_unknown = columns.ravel()[coupled]
        fixed = np.where(left < 0, 3 * node[:, None] + _ROW, 3 * other[:, None] + _COLUMN)
        self.coupled_fixed = fixed.ravel()[coupled]


def _merged(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Places of the entries of two ascending arrays, one after the other, in their ascending union."""
    second = np.searchsorted(a, b, side="right") + np.arange(len(b))
    taken = np.zeros(len(a) + len(b), dtype=bool)
    taken[second] = True
    return np.concatenate([np.flatnonzero(~taken), second])
