"""Pairs of points, edges or triangles that are near each other, from a list that serves while they move.

Primitives are taken by the spheres around them, so none is missed however large it is (a k-d tree of their
centres); then their distances decide. The list holds what is within a wide reach (Verlet, Phys. Rev. 159, 1967). While
nodes have come nearer to each other by less than what it is wider than asked for, distances of its pairs are all
that has to be looked at.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from sim_core.contact.closing_distance import Approach
from sim_core.contact.primitives import Primitives

Distance = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""Distances [m] of pairs: positions of all nodes, first and second member of each pair, int32."""


class Neighbours:
    """Neighbours of one set of primitives in another, which may be the same set or share nodes.

    Pairs are named by keys: first member times number of second primitives plus second member. ``offset``: [m],
    distance of the primitives at which the surfaces touch; gaps are distances less the offset. ``once``: both sets are
    the same, and every pair is listed once only. Primitives that share a node are no pair.
    """

    def __init__(self, ours: Primitives, theirs: Primitives, offset: float, distance: Distance, once: bool) -> None:
        self._ours, self._theirs = ours, theirs
        self._offset = offset
        self._distance = distance
        self._once = once
        self._joined = self._sharing_nodes()
        self.approach = Approach(ours.members, theirs.members, (ours.stretch, theirs.stretch))
        self._listed, self._reach = np.empty(0, dtype=np.int64), -np.inf
        self._listed_at: np.ndarray | None = None

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

    def split(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and second members, int32."""
        first, second = np.divmod(keys, len(self._theirs.nodes))
        return first.astype(np.int32), second.astype(np.int32)

    def keys(self, pairs: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Of pairs that were split."""
        return np.asarray(pairs[0] * np.int64(len(self._theirs.nodes)) + pairs[1])

    def within(self, x: np.ndarray, reach: float, spare: float) -> tuple[np.ndarray, np.ndarray]:
        """Keys of the pairs with gaps within ``reach`` [m] where nodes are at ``x`` [m] ``(n, 3)``, ascending, and
        their gaps [m]. A list that does not serve is made anew, wider by ``spare`` [m]."""
        if not self._serves(x, reach):
            self._listed = self._near(*self._ours.spheres(x), *self._theirs.spheres(x), self._offset + reach + spare)
            gap = self.gaps(x, self._listed)
            self._listed = self._listed[gap <= reach + spare]
            self._listed_at, self._reach = x.copy(), reach + spare
        gap = self.gaps(x, self._listed)
        kept = gap <= reach
        return self._listed[kept], gap[kept]

    def _serves(self, x: np.ndarray, reach: float) -> bool:
        """Whether the list has all pairs with gaps within ``reach`` at ``x``."""
        return self._listed_at is not None and reach + self.approach(self._listed_at, x) <= self._reach

    def listed_within(self, x: np.ndarray, reach: float) -> np.ndarray:
        """As :meth:`within`, of the pairs that happen to be listed."""
        return self._listed[self.gaps(x, self._listed) <= reach]

    def gaps(self, x: np.ndarray, keys: np.ndarray) -> np.ndarray:
        """Gaps [m] of pairs."""
        return self._distance(x, *self.split(keys)) - self._offset

    def forget(self) -> None:
        """Make the list anew next time."""
        self._listed_at = None

    def on_the_way(self, x: np.ndarray, to: np.ndarray, reach: float) -> np.ndarray:
        """Keys of the pairs that may come within ``reach`` [m] while nodes move from ``x`` to ``to``, ascending.

        A pair i, j at the distance d cannot while d - offset - reach > |m_i - m_j| + e_i + e_j, with the mean moves m
        of their nodes and the largest deviations e from them.
        """
        move = to - x
        (m, e), (n, f) = self._ours.moves(move), self._theirs.moves(move)
        if self._serves(x, reach + self.approach(x, to)):
            keys = self._listed
            first, second = self.split(keys)
        else:
            (points, r), (centres, s) = self._ours.spheres(x), self._theirs.spheres(x)
            a, b = r + e + 0.5 * np.linalg.norm(m, axis=1), s + f + 0.5 * np.linalg.norm(n, axis=1)
            keys = self._near(points + 0.5 * m, a, centres + 0.5 * n, b, self._offset + reach)
            first, second = self.split(keys)
            slack = self._slack(reach, m, e, n, f, first, second)
            kept = np.linalg.norm(points[first] - centres[second], axis=1) - r[first] - s[second] <= slack
            keys, first, second = keys[kept], first[kept], second[kept]
        slack = self._slack(reach, m, e, n, f, first, second)
        return np.asarray(keys[self._distance(x, first, second) <= slack])

    def _slack(
        self,
        reach: float,
        m: np.ndarray,
        e: np.ndarray,
        n: np.ndarray,
        f: np.ndarray,
        first: np.ndarray,
        second: np.ndarray,
    ) -> np.ndarray:
        """Distances [m] from which pairs may come within ``reach``."""
        return np.asarray(self._offset + reach + e[first] + f[second] + np.linalg.norm(m[first] - n[second], axis=1))

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


def _in_box(points: np.ndarray, others: np.ndarray, margin: float) -> np.ndarray:
    """Which ``points`` are within ``margin`` of the box around ``others``."""
    inside = (points >= others.min(axis=0) - margin) & (points <= others.max(axis=0) + margin)
    return np.asarray(inside.all(axis=1))
