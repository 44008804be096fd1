"""The true Hessian of a system at one instant, kept: to solve with and to multiply by when the system has gone on.

Kept are the values by pairs of nodes, about a tenth of what a factorisation with its analysis takes; where they belong
is shared by all that have the same pattern. The numerical factorisation is done when a solution is asked for. What is
costly to prepare for a pattern, its symbolic analysis above all, is prepared once while neighbours in time share it.
"""

from __future__ import annotations

import copy

import numpy as np

from sim_core.energies.term import PairTable
from sim_core.kernels import BoundKernel
from sim_core.solve.factor import Factor, NotPositiveDefinite, factorise
from sim_core.solve.pattern import Pattern
from sim_core.solve.product import nodal_product
from sim_core.solve.system import System


class Keeper:
    """Keeps the stiffness of a system; a friend of :class:`System`, whose storage it reads."""

    def __init__(self, system: System) -> None:
        self._system = system
        self._layout: Pattern | None = None
        self._prepared: _Prepared | None = None

    def keep(self) -> Stiffness:
        """Stiffness where the system is now, at the end of a step."""
        system = self._system
        system.guard(True)
        data = system.hessian_data(exact=True)
        live = system._pattern
        new = self._layout is None or self._layout.indices is not live.indices
        if new:
            self._layout = _snapshot(live)
        assert self._layout is not None
        diagonal = live.indptr[system.n_unknowns - system.deflections.size : -1]
        springs = data[diagonal] - live.data(system._hessian)[diagonal] if len(diagonal) else np.empty(0)
        kept = Stiffness(self, self._layout, system._hessian[: live.n_used].copy(), springs)
        kept.size_bytes += _size_bytes(self._layout) if new else 0
        return kept

    def prepared(self, layout: Pattern) -> _Prepared:
        """What the layout needs; that of the one before is given up."""
        if self._prepared is None or self._prepared.layout is not layout:
            self._prepared = _Prepared(layout)
        return self._prepared


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
        self.size_bytes = values.nbytes + springs.nbytes

    def product(self, move: np.ndarray) -> np.ndarray:
        """Change of the nodal gradient [N] for a move of all nodes [m], ``(n, 3)`` both, as
        :meth:`System.nodal_product`."""
        return self._keeper.prepared(self.layout).product(self._values, move)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Solve over the unknowns for one right-hand side ``(n,)`` or several ``(n, k)``. The Hessian is definite at
        a stable equilibrium, and need not be where motion holds one."""
        data, layout = self.layout.data(self._values), self.layout
        if len(self._springs):
            data[layout.indptr[-1 - len(self._springs) : -1]] += self._springs
        prepared = self._keeper.prepared(layout)
        try:
            return prepared.factor(data, definite=True).solve(rhs)
        except NotPositiveDefinite:
            return prepared.factor(data, definite=False).solve(rhs)


class _Prepared:
    """Analysis of one layout, and its product."""

    def __init__(self, layout: Pattern) -> None:
        self.layout = layout
        self._factors: dict[bool, Factor] = {}
        self._values = np.empty(layout.n_used)
        table = layout.table
        self._move, self._out = (np.empty((len(table.start) - 1, 3)) for _ in range(2))
        self._product = BoundKernel(
            nodal_product, table.start, table.column, table.place, self._values, self._move, self._out
        )

    def product(self, values: np.ndarray, move: np.ndarray) -> np.ndarray:
        self._values[:], self._move[:] = values, move
        self._product()
        return np.array(self._out)

    def factor(self, data: np.ndarray, definite: bool) -> Factor:
        """Factorise entries in the layout's order."""
        if definite not in self._factors:
            self._factors[definite] = factorise(self.layout.matrix(data), definite)
        else:
            self._factors[definite].refactor(data)
        return self._factors[definite]
