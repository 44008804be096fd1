"""Which primitives may touch: pairs of points, edges or triangles, searched at the start of a step, in two rings.

The inner ring is what the contact law and the collision test look at: what is near at the start, and what the
foreseen motion may bring together. It is wider than a step needs, so that it serves several steps; it is
searched anew when the primitives have moved by more than the surplus. The outer ring, wider again, decides
which nodes the Hessian couples; it is renewed only when the inner ring is no longer part of it (or when it is
far too wide after a violent step), so that the matrix keeps its pattern for many steps.

Primitives are taken by the spheres around them, so none is missed however large it is; then their distances
decide. A pair i, j at the distance d cannot come within the range while d - range > |m_i - m_j| + e_i + e_j, with the
mean moves m of their nodes and the largest deviations e from them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

SURPLUS = 0.5
"""Share of the margin between the rings by which the inner ring is wider than a step needs."""

MOST_COUPLED, FEW_COUPLED = 2, 256
"""How many times as many pairs as are near, and how many more, the outer ring may have."""

Distance = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Distances [m] of pairs: positions of all nodes, first and second member of each pair, int32."""


class Primitives:
    """Points, edges or triangles. ``nodes``: int32 ``(n, k)``; ``weights``: ``(n, k)`` of points that lie
    between nodes, else None."""

    def __init__(self, nodes: np.ndarray, weights: np.ndarray | None = None) -> None:
        self.nodes = nodes
        self._weights = weights
        self.members = np.unique(nodes)
        self.stretch = 1.0 if weights is None else float(np.abs(weights).sum(axis=1).max(initial=1.0))
        """How many times further from a common mean than its nodes a point may move."""

    def spheres(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres [m] ``(n, 3)`` and radii [m] ``(n,)`` of spheres around them."""
        corners = x[self.nodes]
        if self._weights is not None:
            return np.einsum("nk,nkj->nj", self._weights, corners), np.zeros(len(corners))
        return _around(corners)

    def moves(self, move: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean of the nodes' moves [m] ``(n, 3)`` and the largest deviation from it [m] ``(n,)``."""
        if self._weights is not None:
            return np.einsum("nk,nkj->nj", self._weights, move[self.nodes]), np.zeros(len(self.nodes))
        return _around(move[self.nodes])


class Candidates:
    """Candidates of one ordered pair of sets of primitives, which may be the same set or share nodes.

    ``pairs``: first and second members of the inner ring, ascending; ``coupled``: of the outer ring.
    ``offset``: [m], distance of the primitives at which the surfaces touch. ``once``: both sets are the same,
    and every pair is listed once only. Primitives that share a node are no pair.
    """

    def __init__(
        self, ours: Primitives, theirs: Primitives, offset: float, distance: Distance, once: bool = False
    ) -> None:
        self._ours, self._theirs = ours, theirs
        self._offset = offset
        self._distance = distance
        self._once = once
        self._surplus = 0.0
        self._range = 0.0
        self._searched_at: np.ndarray | None = None
        nothing = np.empty(0, dtype=np.int32)
        self.pairs = (nothing, nothing)
        self.coupled = (nothing, nothing)
        self._coupled_keys = np.empty(0, dtype=np.int64)
        self._joined = self._sharing_nodes()

    def _sharing_nodes(self) -> np.ndarray:
        """Keys of the pairs that share a node, ascending."""
        sides = []
        count = 1 + max(int(part.nodes.max(initial=-1)) for part in (self._ours, self._theirs))
        for part in (self._ours, self._theirs):
            rows = np.repeat(np.arange(len(part.nodes)), part.nodes.shape[1])
            ones = np.ones(part.nodes.size, dtype=np.int32)
            sides.append(sp.csr_matrix((ones, (rows, part.nodes.ravel())), shape=(len(part.nodes), count)))
        found = (sides[0] @ sides[1].T).tocoo()
        return np.sort(found.row * np.int64(len(self._theirs.nodes)) + found.col)

    @property
    def any(self) -> bool:
        """True when there is at least one candidate."""
        return bool(len(self.pairs[0]))

    @property
    def keys(self) -> np.ndarray:
        """First member times number of second primitives plus second member, of the inner ring, ascending."""
        first, second = self.pairs
        return np.asarray(first * np.int64(len(self._theirs.nodes)) + second)

    def search(
        self, x: np.ndarray, towards: np.ndarray, within: float, margin: float, more: bool = False
    ) -> tuple[bool, bool]:
        """Look for pairs that come within ``within`` [m] beyond the offset while nodes move from ``x`` to
        ``towards`` or thereabouts, unless those at hand do.

        The outer ring is wider by ``margin`` [m], the inner by a part of it. Returns whether the inner and the
        outer ring changed. ``more``: keep the inner ring at hand beside what is found, because the way leads on
        from where it was needed.
        """
        if self._searched_at is not None and self._range == within and self._surplus <= SURPLUS * margin:
            if max(self._motion(x), self._motion(towards)) <= self._surplus:
                return False, False
        self._searched_at = x.copy()
        self._range, self._surplus = within, SURPLUS * margin
        near, gap = self._within(x, within + margin)
        inner, bound = near[gap <= within + self._surplus], near[:0]
        if self._motion(towards) > self._surplus:
            bound = self._bound(x, towards, within)
            inner = np.union1d(inner, bound)
        if more:
            inner, bound = np.union1d(inner, self.keys), np.union1d(bound, self.keys)
        at = np.searchsorted(self._coupled_keys, inner)
        inside = bool(np.all(at < len(self._coupled_keys))) and bool(np.all(self._coupled_keys[at] == inner))
        inside &= len(self._coupled_keys) <= MOST_COUPLED * (len(near) + len(bound)) + FEW_COUPLED
        if not inside:
            self._coupled_keys = np.union1d(near, bound)
            self.coupled = self._split(self._coupled_keys)
        self.pairs = self._split(inner)
        return True, not inside

    def forget(self) -> None:
        """Search afresh next time, whatever was found before."""
        self._searched_at = None
        nothing = np.empty(0, dtype=np.int32)
        self.pairs = self.coupled = (nothing, nothing)
        self._coupled_keys = np.empty(0, dtype=np.int64)

    def outran(self, x: np.ndarray) -> bool:
        """True when a pair that is no candidate may have come within the range on the way to ``x``."""
        if self._searched_at is None or self._motion(x) <= self._surplus:
            return False
        return not bool(np.isin(self._bound(self._searched_at, x, self._range), self.keys).all())

    def _motion(self, x: np.ndarray) -> float:
        """By how much any primitives may have approached each other since the search [m]."""
        assert self._searched_at is not None
        move = x - self._searched_at
        ours, theirs = self._ours.members, self._theirs.members
        middle = 0.5 * (move[ours].sum(axis=0) / len(ours) + move[theirs].sum(axis=0) / len(theirs))
        move -= middle
        squares = np.einsum("ij,ij->i", move, move)
        ways = np.sqrt([squares[ours].max(), squares[theirs].max()])
        return float(self._ours.stretch * ways[0] + self._theirs.stretch * ways[1])

    def _bound(self, x: np.ndarray, to: np.ndarray, within: float) -> np.ndarray:
        """Keys of the pairs that may come within ``within`` between ``x`` and ``to``, ascending."""
        move = to - x
        (points, r), (centres, s) = self._ours.spheres(x), self._theirs.spheres(x)
        (m, e), (n, f) = self._ours.moves(move), self._theirs.moves(move)
        a, b = r + e + 0.5 * np.linalg.norm(m, axis=1), s + f + 0.5 * np.linalg.norm(n, axis=1)
        keys = self._near(points + 0.5 * m, a, centres + 0.5 * n, b, self._offset + within)
        first, second = self._split(keys)
        slack = self._offset + within + e[first] + f[second] + np.linalg.norm(m[first] - n[second], axis=1)
        kept = np.linalg.norm(points[first] - centres[second], axis=1) - r[first] - s[second] <= slack
        keys, slack = keys[kept], slack[kept]
        return np.asarray(keys[self._distance(x, *self._split(keys)) <= slack])

    def _split(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        first, second = np.divmod(keys, len(self._theirs.nodes))
        return first.astype(np.int32), second.astype(np.int32)

    def _within(self, x: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Keys of the pairs within ``reach``, ascending, and their distances less the offset [m]."""
        keys = self._near(*self._ours.spheres(x), *self._theirs.spheres(x), self._offset + reach)
        gap = self._distance(x, *self._split(keys)) - self._offset
        kept = gap <= reach
        return keys[kept], gap[kept]

    def _near(self, points: np.ndarray, r: np.ndarray, centres: np.ndarray, s: np.ndarray, apart: float) -> np.ndarray:
        """Keys of the pairs whose spheres are nearer than ``apart``, ascending."""
        largest = apart + float(r.max(initial=0.0)) + float(s.max(initial=0.0))
        some = np.flatnonzero(_in_box(points, centres, largest))
        others = np.flatnonzero(_in_box(centres, points[some], largest)) if len(some) else some
        if not len(others):
            return np.empty(0, dtype=np.int64)
        close = cKDTree(points[some]).sparse_distance_matrix(cKDTree(centres[others]), largest, output_type="ndarray")
        first, second = some[close["i"]], others[close["j"]]
        kept = close["v"] <= apart + r[first] + s[second]
        if self._once:
            kept &= first < second
        keys = np.sort(first[kept] * np.int64(len(centres)) + second[kept])
        return np.asarray(keys[~np.isin(keys, self._joined, assume_unique=True)])


def _around(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of corners ``(n, k, 3)`` and the largest distances from them."""
    centres = corners.mean(axis=1)
    return centres, np.sqrt(((corners - centres[:, None]) ** 2).sum(axis=-1).max(axis=1))


def _in_box(points: np.ndarray, others: np.ndarray, margin: float) -> np.ndarray:
    """Which ``points`` are within ``margin`` of the box around ``others``."""
    inside = (points >= others.min(axis=0) - margin) & (points <= others.max(axis=0) + margin)
    return np.asarray(inside.all(axis=1))
