"""The true Hessian of a system at one instant, kept: to solve with and to multiply by when the system has gone on.

Kept are the values by pairs of nodes; where they belong is shared by all that have the same pattern. The numerical
factorisation is done when a solution is asked for. Its symbolic analysis costs three of them, so neighbours in time
share one, of all pairs that any of them has. Or the factorisation is made at once and kept too, which takes ten times
the memory, and four times the time, because no two factorisations can share an analysis. That pays from the sixth to
tenth right-hand side on, by the machine.

Who knows what is to be solved with next may let it be factorised on a second core meanwhile
(:meth:`Stiffness.foresee`): the solvers let go of the interpreter. Each that is foreseen and not used yet has an
analysis of its own.
"""

from __future__ import annotations

import copy
import weakref
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from sim_core.energies.term import PairTable
from sim_core.kernels import BoundKernel
from sim_core.solve.factor import Factor, NotPositiveDefinite, factorise
from sim_core.solve.hessian_vector import nodal_product
from sim_core.solve.sparsity import Pattern
from sim_core.solve.system import System

AHEAD = 2
"""How many steps are foreseen at a time, so that the second core always has one to factorise."""

SHARING = 1.04
"""An analysis is shared while it has at most this many times the pairs of nodes that one of its own would have."""


class Keeper:
    """Keeps the stiffness of a system; a friend of :class:`System`, whose storage it reads. ``factors``: factorised."""

    def __init__(self, system: System, factors: bool = False) -> None:
        self._system, self._factors = system, factors
        self._layout: Pattern | None = None
        self._layouts: list[weakref.ref[Pattern]] = []
        self._prepared: list[_Prepared] = []
        self._beside: ThreadPoolExecutor | None = None

    def keep(self) -> Stiffness:
        """Stiffness where the system is now, at the end of a step."""
        system = self._system
        data = system.hessian_data(exact=True)
        live = system._pattern
        new = self._layout is None or self._layout.indices is not live.indices
        if new:
            self._layout = _snapshot(live)
            self._layouts.append(weakref.ref(self._layout))
        assert self._layout is not None
        diagonal = live.indptr[system.n_unknowns - system.deflections.size : -1]
        springs = data[diagonal] - live.data(system._hessian)[diagonal] if len(diagonal) else np.empty(0)
        kept = Stiffness(self, self._layout, system._hessian[: live.n_used].copy(), springs)
        kept.size_bytes += _size_bytes(self._layout) if new else 0
        if self._factors:
            kept.factorise()
        return kept

    def prepared(self, layout: Pattern) -> _Prepared:
        """What the layout needs, shared with those kept before it. It is there for a step and for those that are
        foreseen meanwhile, whether they share a layout or not."""
        for found in self._prepared:
            if found.serves(layout):
                return found
        self._prepared = [*self._prepared[-AHEAD:], _Prepared(layout, self._earlier(layout))]
        return self._prepared[-1]

    @property
    def beside(self) -> ThreadPoolExecutor:
        """The second core."""
        if self._beside is None:
            self._beside = ThreadPoolExecutor(1, "factorise")
        return self._beside

    def _earlier(self, layout: Pattern) -> list[Pattern]:
        """Layouts kept before this one, the latest first, as far as they are still there."""
        self._layouts = [ref for ref in self._layouts if ref() is not None]
        alive = [found for ref in self._layouts if (found := ref()) is not None]
        at = next((k for k, found in enumerate(alive) if found is layout), 0)
        return alive[:at][::-1]


def _snapshot(pattern: Pattern) -> Pattern:
    """The pattern as it is now: what it replaces is shared, what it writes in place is copied."""
    out, used = copy.copy(pattern), pattern.n_used // 9
    table = pattern.table
    out.table = PairTable(table.start.copy(), table.column[:used].copy(), table.place[:used].copy())
    return out


def _size_bytes(layout: Pattern) -> int:
    arrays = [a for a in (*vars(layout).values(), *vars(layout.table).values()) if isinstance(a, np.ndarray)]
    return sum(a.nbytes for a in arrays)


class Stiffness:
    """True Hessian at one instant. ``values``: as stored by pairs of nodes; ``springs``: of compliant mounts [N/m];
    ``size_bytes``: memory, of the layout too where that is not the one before's."""

    def __init__(self, keeper: Keeper, layout: Pattern, values: np.ndarray, springs: np.ndarray) -> None:
        self._keeper, self.layout = keeper, layout
        self._values, self._springs = values, springs
        self._factor: Factor | None = None
        self._foreseen: _Analysis | None = None
        self.size_bytes = values.nbytes + springs.nbytes

    def product(self, move: np.ndarray) -> np.ndarray:
        """Change of the nodal gradient [N] for a move of all nodes [m], ``(n, 3)`` both, as
        :meth:`System.nodal_product`."""
        return self._keeper.prepared(self.layout).product(self.layout, self._values, move)

    def products(self, moves: np.ndarray) -> np.ndarray:
        """As :meth:`product`, for several moves at once, ``(n, 3, k)``."""
        return self._keeper.prepared(self.layout).products(self.layout, self._values, moves)

    def factorise(self) -> None:
        """Make and keep a factorisation of its own."""
        data = _with_springs(self.layout, self.layout.data(self._values), self._springs)
        self._factor = _Analysis(self.layout).factor(data)
        self.size_bytes += self._factor.size_bytes()

    def foresee(self) -> None:
        """Let it be factorised on a second core, for the next solution."""
        if self._factor is None and self._foreseen is None:
            prepared = self._keeper.prepared(self.layout)
            data, beside = prepared.data(self.layout, self._values, self._springs), self._keeper.beside
            analysis = prepared.free()
            analysis.begin(self, data, beside)
            self._foreseen = analysis

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve over the unknowns for one right-hand side ``(n,)`` or several ``(n, k)``."""
        if self._factor is not None:
            return self._factor.solve(rhs)
        if self._foreseen is not None:
            foreseen, self._foreseen = self._foreseen, None
            return foreseen.end().solve(rhs)
        prepared = self._keeper.prepared(self.layout)
        return prepared.free().factor(prepared.data(self.layout, self._values, self._springs)).solve(rhs)


def _with_springs(layout: Pattern, data: np.ndarray, springs: np.ndarray) -> np.ndarray:
    """Entries of the upper triangle over the unknowns with the springs of compliant mounts, which come last."""
    if len(springs):
        data[layout.indptr[-1 - len(springs) : -1]] += springs
    return data


class _Analysis:
    """Factorisations of one layout, one after the other."""

    def __init__(self, layout: Pattern) -> None:
        self.layout = layout
        self._factors: dict[bool, Factor] = {}
        self._begun: Future[Factor] | None = None
        self._owner: weakref.ref[Stiffness] | None = None

    @property
    def free(self) -> bool:
        """Nobody waits for what was begun."""
        return self._owner is None or self._owner() is None

    def begin(self, owner: Stiffness, data: np.ndarray, beside: ThreadPoolExecutor) -> None:
        """Factorise on a second core, for an owner who will come for it."""
        self._owner = weakref.ref(owner)
        self._begun = beside.submit(self.factor, data)

    def end(self) -> Factor:
        """What was begun."""
        assert self._begun is not None
        self._owner, begun = None, self._begun
        return begun.result()

    def wait(self) -> None:
        """Until nothing is done any more that was begun and that nobody came for."""
        if self._begun is not None:
            self._begun.exception()

    def factor(self, data: np.ndarray) -> Factor:
        """Factorise entries in the layout's order. The Hessian is definite at a stable equilibrium, and need not be
        where motion holds one."""
        try:
            return self._factorised(data, definite=True)
        except NotPositiveDefinite:
            return self._factorised(data, definite=False)

    def _factorised(self, data: np.ndarray, definite: bool) -> Factor:
        if definite not in self._factors:
            self._factors[definite] = factorise(self.layout.matrix(data), definite)
        else:
            self._factors[definite].refactor(data)
        return self._factors[definite]


class _Prepared:
    """Analyses, and one product, of a layout and as many of the ``earlier`` ones as fit well with it."""

    def __init__(self, layout: Pattern, earlier: Sequence[Pattern]) -> None:
        self._shared = layout.shared_with(earlier, SHARING)
        joined = layout.joined(self._shared)
        self._layout = joined
        self._analyses: list[_Analysis] = []
        self._places: dict[int, np.ndarray] = {}
        self._values = np.zeros(joined.n_used)
        self._held: np.ndarray | None = None
        table = joined.table
        self._move, self._out = (np.empty((len(table.start) - 1, 3)) for _ in range(2))
        self._product = BoundKernel(
            nodal_product, table.start, table.column, table.place, self._values, self._move, self._out
        )

    def serves(self, layout: Pattern) -> bool:
        """Whether this layout is among those that share it."""
        return any(layout is mine for mine in self._shared)

    def product(self, layout: Pattern, values: np.ndarray, move: np.ndarray) -> np.ndarray:
        """H ``move`` with the ``values`` of H as the layout stores them."""
        self._take(layout, values)
        self._move[:] = move
        self._product()
        return np.array(self._out)

    def products(self, layout: Pattern, values: np.ndarray, moves: np.ndarray) -> np.ndarray:
        """H ``moves``, as :meth:`product`, of several moves ``(n, 3, k)``."""
        self._take(layout, values)
        whole = 3 * len(moves)
        data, indices, starts = self._values[self._entries[0]], *self._entries[1:]
        matrix = sp.csr_matrix((data, indices, starts), shape=(whole, whole))
        return np.asarray(matrix @ moves.reshape(whole, -1)).reshape(moves.shape)

    @cached_property
    def _entries(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of all of H as a sparse matrix: where each entry is among the values, its column, and the starts of rows."""
        table = self._layout.table
        row = np.repeat(np.arange(len(table.start) - 1), np.diff(table.start))
        column, base = table.column[: len(row)].astype(int), 9 * table.place[: len(row)].astype(int)
        a, b = (axis.ravel() for axis in np.indices((3, 3)))
        own = (row == column)[:, None]
        upper = base[:, None] + 3 * np.where(own, np.minimum(a, b), a) + np.where(own, np.maximum(a, b), b)
        down, across = 3 * row[:, None] + a, 3 * column[:, None] + b
        apart = ~own[:, 0]
        rows = np.concatenate([down.ravel(), across[apart].ravel()])
        columns = np.concatenate([across.ravel(), down[apart].ravel()])
        where = np.concatenate([upper.ravel(), upper[apart].ravel()])
        order = np.lexsort((columns, rows))
        starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=3 * (len(table.start) - 1)))])
        return where[order], columns[order], starts

    def data(self, layout: Pattern, values: np.ndarray, springs: np.ndarray) -> np.ndarray:
        """Entries of H as its factorisation takes them."""
        self._take(layout, values)
        return _with_springs(self._layout, self._layout.data(self._values), springs)

    def free(self) -> _Analysis:
        """An analysis with which nothing is foreseen."""
        found = next((a for a in self._analyses if a.free), None)
        if found is None:
            found = _Analysis(self._layout)
            self._analyses.append(found)
        found.wait()
        return found

    def _take(self, layout: Pattern, values: np.ndarray) -> None:
        """Store values as the joined layout does, if they are not there yet."""
        if values is self._held:
            return
        known = len(values) - 9 * layout.n_dynamic
        if id(layout) not in self._places:
            self._places[id(layout)] = layout.places_in(self._layout)
        self._values[:known], self._values[known:] = values[:known], 0.0
        self._values[self._places[id(layout)]] = values[known:]
        self._held = values
