"""Which triangles a sample may touch, in two rings.

The inner ring is what the contact law looks at. It is wider than one step needs and is found anew only when
the surfaces have moved by more than the surplus. The outer ring, wider again, decides which nodes the Hessian
couples; it is renewed only when the inner ring is no longer part of it (or when it is far too wide after a
violent step), so that the matrix keeps its pattern for many steps. Triangles are first taken by their
circumscribing spheres, so none is missed however large it is; then their distances decide.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sim_core.contact.samples import Samples

SURPLUS = 0.5
"""Share of the margin between the rings by which the inner ring is wider than a step needs."""


class Candidates:
    """Candidates of one ordered pair of surfaces.

    ``first``: int32 ``(n + 1,)``, ``near``: the triangles of sample ``s`` are
    ``near[first[s]:first[s + 1]]``, ascending. ``coupled``: samples and triangles of the outer ring.
    ``offset``: [m], distance of the sampled surfaces at which the real ones touch.
    """

    def __init__(self, samples: Samples, triangles: np.ndarray, offset: float) -> None:
        self._samples = samples
        self._triangles = triangles
        self._offset = offset
        self._members = np.unique(samples.nodes)
        self._corners = np.unique(triangles)
        self._reach = 0.0
        self._coupled_reach = 0.0
        self._searched_at: np.ndarray | None = None
        self.first = np.zeros(len(samples.areas) + 1, dtype=np.int32)
        self.near = np.zeros(16 * len(samples.areas), dtype=np.int32)
        self.coupled = (np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))
        self._coupled_keys = np.empty(0, dtype=np.int64)

    @property
    def any(self) -> bool:
        """True when there is at least one candidate."""
        return bool(self.first[-1])

    def search(self, x: np.ndarray, reach: float, margin: float) -> tuple[bool, bool]:
        """Look for triangles within ``reach`` [m] beyond the offset of samples at node positions ``x``.

        The outer ring is wider by ``margin`` [m]. Returns whether the outer ring changed, and whether
        :attr:`near` is a new array because the old one was too small.
        """
        known = self._searched_at is not None and self._reach <= 4.0 * (reach + margin)
        if known and reach + self._motion(x) <= self._reach:
            return False, False
        self._searched_at = x.copy()
        self._reach = reach + SURPLUS * margin
        near, distance = self._within(x, reach + margin)
        inner = near[distance <= self._reach]
        at = np.searchsorted(self._coupled_keys, inner)
        inside = bool(np.all(at < len(self._coupled_keys))) and bool(np.all(self._coupled_keys[at] == inner))
        inside &= self._coupled_reach <= 2.0 * (reach + margin) or not len(self._coupled_keys)
        if not inside:
            self._coupled_reach = reach + margin
            self._coupled_keys = near
            self.coupled = tuple(np.divmod(near, len(self._triangles)))  # type: ignore[assignment]
        sample, triangle = np.divmod(inner, len(self._triangles))
        grown = len(inner) > len(self.near)
        if grown:
            self.near = np.zeros(2 * len(inner), dtype=np.int32)
        self.near[: len(inner)] = triangle
        self.first[:] = np.searchsorted(sample, np.arange(len(self.first)))
        return not inside, grown

    def outran(self, x: np.ndarray) -> bool:
        """True when samples and triangles may have moved towards each other by more than the inner ring is wide."""
        return self._searched_at is not None and self._motion(x) > self._reach

    def _motion(self, x: np.ndarray) -> float:
        """By how much samples and triangles may have approached each other since the search [m]."""
        assert self._searched_at is not None
        ours, theirs = (x[m] - self._searched_at[m] for m in (self._members, self._corners))
        middle = 0.5 * (ours.mean(axis=0) + theirs.mean(axis=0))
        return float(sum(np.sqrt(((part - middle) ** 2).sum(axis=1).max()) for part in (ours, theirs)))

    def _within(self, x: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
        """Pairs as sample * number of triangles + triangle, ascending, and their distances less the offset [m]."""
        corners, points = x[self._triangles], self._samples.positions(x)
        centres = corners.mean(axis=1)
        radii = np.sqrt(((corners - centres[:, None]) ** 2).sum(axis=-1).max(axis=1))
        distance = self._offset + reach
        largest = distance + float(radii.max())
        some = np.flatnonzero(_in_box(points, centres, largest))
        others = np.flatnonzero(_in_box(centres, points[some], largest)) if len(some) else some
        if not len(others):
            return np.empty(0, dtype=np.int64), np.empty(0)
        pairs = cKDTree(points[some]).sparse_distance_matrix(cKDTree(centres[others]), largest, output_type="ndarray")
        sample, triangle = some[pairs["i"]], others[pairs["j"]]
        close = pairs["v"] <= distance + radii[triangle]
        keys = np.sort(sample[close] * np.int64(len(centres)) + triangle[close])
        sample, triangle = np.divmod(keys, len(centres))
        gap = distance_to_triangles(points[sample], corners[triangle]) - self._offset
        return keys[gap <= reach], gap[gap <= reach]


def distance_to_triangles(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Distances [m] of points ``(n, 3)`` to one triangle each ``(n, 3, 3)``: over the face or to its border."""
    out = np.full(len(points), np.inf)
    inside = np.ones(len(points), dtype=bool)
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    for p, q in ((a, b), (b, c), (c, a)):
        edge, to = q - p, points - p
        inside &= np.einsum("nj,nj->n", np.cross(edge, to), normal) >= 0.0
        share = np.einsum("nj,nj->n", to, edge) / np.einsum("nj,nj->n", edge, edge)
        border = np.linalg.norm(to - np.clip(share, 0.0, 1.0)[:, None] * edge, axis=1)
        np.minimum(out, border, out=out)
    height = np.abs(np.einsum("nj,nj->n", points - a, normal)) / np.linalg.norm(normal, axis=1)
    return np.where(inside, height, out)


def _in_box(points: np.ndarray, others: np.ndarray, margin: float) -> np.ndarray:
    """Which ``points`` are within ``margin`` of the box around ``others``."""
    inside = (points >= others.min(axis=0) - margin) & (points <= others.max(axis=0) + margin)
    return np.asarray(inside.all(axis=1))
