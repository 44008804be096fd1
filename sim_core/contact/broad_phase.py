"""Which primitives may touch: pairs of points, edges or triangles, searched at the start of a step, in two rings.

The inner ring is what the contact law and the collision test look at: what is near at the start, and what the
foreseen motion may bring together. It is wider than a step needs, so that it serves several steps; it is
searched anew when the primitives have moved by more than the surplus. The outer ring, wider again, decides
which nodes the Hessian couples; it is renewed only when the inner ring is no longer part of it (or when it is
far too wide after a violent step), so that the matrix keeps its pattern for many steps. It also has what will be
near some steps on if the motion continues. Both rings are cut out of a list that is wider still
(:mod:`sim_core.contact.neighbours`).
"""

from __future__ import annotations

import numpy as np

from sim_core.contact.neighbours import Distance, Neighbours
from sim_core.contact.primitives import Primitives

SURPLUS = 0.5
"""Share of the margin between the rings by which the inner ring is wider than a step needs."""

LISTED = 3.0
"""Margins by which the list of neighbours is wider than the outer ring."""

AHEAD = 6.0
"""Steps that the outer ring looks ahead."""

MOST_WIDER, FEW_WIDER = 2, 256
"""How many times as many pairs as are near, and how many more, a ring may have that a violent step has left."""


class Candidates:
    """Candidates of one ordered pair of sets of primitives, which may be the same set or share nodes.

    ``pairs``: first and second members of the inner ring, ascending; ``coupled``: of the outer ring.
    ``offset``: [m], distance of the primitives at which the surfaces touch. ``once``: both sets are the same,
    and every pair is listed once only. Primitives that share a node are no pair.
    """

    def __init__(
        self, ours: Primitives, theirs: Primitives, offset: float, distance: Distance, once: bool = False
    ) -> None:
        self._neighbours = Neighbours(ours, theirs, offset, distance, once)
        self._surplus, self._range, self._margin = 0.0, 0.0, 0.0
        self._searched_at: np.ndarray | None = None
        self._wide = False
        self._forget_rings()

    def _forget_rings(self) -> None:
        nothing = np.empty(0, dtype=np.int32)
        self.pairs = self.coupled = (nothing, nothing)
        self._coupled_keys = np.empty(0, dtype=np.int64)

    @property
    def any(self) -> bool:
        """True when there is at least one candidate."""
        return bool(len(self.pairs[0]))

    @property
    def keys(self) -> np.ndarray:
        """First member times number of second primitives plus second member, of the inner ring, ascending."""
        return self._neighbours.keys(self.pairs)

    def search(
        self, x: np.ndarray, towards: np.ndarray, within: float, margin: float, more: bool = False
    ) -> tuple[bool, bool]:
        """Look for pairs that come within ``within`` [m] beyond the offset while nodes move from ``x`` to
        ``towards`` or thereabouts, unless those at hand do.

        The outer ring is wider by ``margin`` [m], the inner by a part of it. Returns whether the inner and the
        outer ring changed. ``more``: keep the inner ring at hand beside what is found, because the way leads on
        from where it was needed.
        """
        approach = self._neighbours.approach
        if self._searched_at is not None and self._range == within and self._surplus <= SURPLUS * margin:
            serves = max(approach(self._searched_at, x), approach(self._searched_at, towards)) <= self._surplus
            if serves and not (self._wide and approach(x, towards) <= self._surplus):
                return False, False
        self._searched_at = x.copy()
        self._range, self._surplus, self._margin = within, SURPLUS * margin, margin
        near, gap = self._neighbours.within(x, within + margin, LISTED * margin)
        inner, bound = near[gap <= within + self._surplus], near[:0]
        if approach(x, towards) > self._surplus:
            bound = self._neighbours.on_the_way(x, towards, within)
            inner = np.union1d(inner, bound)
        if more:
            inner, bound = np.union1d(inner, self.keys), np.union1d(bound, self.keys)
        most = MOST_WIDER * (len(near) + len(bound)) + FEW_WIDER
        self._wide = len(inner) > MOST_WIDER * len(near) + FEW_WIDER
        at = np.searchsorted(self._coupled_keys, inner)
        inside = bool(np.all(at < len(self._coupled_keys))) and bool(np.all(self._coupled_keys[at] == inner))
        inside &= len(self._coupled_keys) <= most
        if not inside:
            self._couple(x, towards, near, bound)
        self.pairs = self._neighbours.split(inner)
        return True, not inside

    def recouple(self, x: np.ndarray, towards: np.ndarray) -> None:
        """Renew the outer ring, because the matrix has to change its pattern anyway. Arguments as of the search."""
        near, _ = self._neighbours.within(x, self._range + self._margin, LISTED * self._margin)
        self._couple(x, towards, near, self.keys)

    def _couple(self, x: np.ndarray, towards: np.ndarray, near: np.ndarray, needed: np.ndarray) -> None:
        soon = self._neighbours.listed_within(x + AHEAD * (towards - x), self._range + self._surplus)
        self._coupled_keys = np.union1d(np.union1d(near, needed), soon)
        self.coupled = self._neighbours.split(self._coupled_keys)

    def forget(self) -> None:
        """Search afresh next time, whatever was found before."""
        self._searched_at = None
        self._neighbours.forget()
        self._forget_rings()

    def outran(self, x: np.ndarray) -> bool:
        """True when a pair that is no candidate may have come within the range on the way to ``x``."""
        if self._searched_at is None or self._neighbours.approach(self._searched_at, x) <= self._surplus:
            return False
        return not bool(np.isin(self._neighbours.on_the_way(self._searched_at, x, self._range), self.keys).all())
