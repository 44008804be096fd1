"""Which triangles a sample may touch: searched at the start of every step, in two rings.

The inner ring is what the contact law looks at; it is found anew for every step. The outer ring, wider,
decides which nodes the Hessian couples; it is renewed only when the inner ring is no longer part of it (or
when it is far too wide after a violent step), so that the matrix keeps its pattern for many steps.
Triangles are taken by their circumscribing spheres, so none is missed however large it is.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sim_core.contact.samples import Samples


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
        self._searched_at = x.copy()
        self._reach = reach
        points, centres, radii = self._spheres(x)
        inner = self._within(points, centres, radii, reach)
        at = np.searchsorted(self._coupled_keys, inner)
        inside = bool(np.all(at < len(self._coupled_keys))) and bool(np.all(self._coupled_keys[at] == inner))
        inside &= self._coupled_reach <= 2.0 * (reach + margin) or not len(self._coupled_keys)
        if not inside:
            self._coupled_reach = reach + margin
            outer = self._within(points, centres, radii, reach + margin)
            self._coupled_keys = outer
            self.coupled = tuple(np.divmod(outer, len(self._triangles)))  # type: ignore[assignment]
        sample, triangle = np.divmod(inner, len(self._triangles))
        grown = len(inner) > len(self.near)
        if grown:
            self.near = np.zeros(2 * len(inner), dtype=np.int32)
        self.near[: len(inner)] = triangle
        self.first[:] = np.searchsorted(sample, np.arange(len(self.first)))
        return not inside, grown

    def outran(self, x: np.ndarray) -> bool:
        """True when samples and triangles may have moved towards each other by more than the reach."""
        if self._searched_at is None:
            return False
        moved = x - self._searched_at
        ours, theirs = moved[self._members], moved[self._corners]
        middle = 0.5 * (ours.mean(axis=0) + theirs.mean(axis=0))
        furthest = sum(float(np.linalg.norm(part - middle, axis=1).max()) for part in (ours, theirs))
        return furthest > self._reach

    def _spheres(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        corners = x[self._triangles]
        centres = corners.mean(axis=1)
        radii = np.sqrt(((corners - centres[:, None]) ** 2).sum(axis=-1).max(axis=1))
        return self._samples.positions(x), centres, radii

    def _within(self, points: np.ndarray, centres: np.ndarray, radii: np.ndarray, reach: float) -> np.ndarray:
        """Pairs as sample * number of triangles + triangle, ascending."""
        distance = self._offset + reach
        largest = distance + float(radii.max())
        some = np.flatnonzero(_in_box(points, centres, largest))
        others = np.flatnonzero(_in_box(centres, points[some], largest)) if len(some) else some
        if not len(others):
            return np.empty(0, dtype=np.int64)
        pairs = cKDTree(points[some]).sparse_distance_matrix(cKDTree(centres[others]), largest, output_type="ndarray")
        sample, triangle = some[pairs["i"]], others[pairs["j"]]
        kept = pairs["v"] <= distance + radii[triangle]
        return np.sort(sample[kept] * np.int64(len(centres)) + triangle[kept])


def _in_box(points: np.ndarray, others: np.ndarray, margin: float) -> np.ndarray:
    """Which ``points`` are within ``margin`` of the box around ``others``."""
    inside = (points >= others.min(axis=0) - margin) & (points <= others.max(axis=0) + margin)
    return np.asarray(inside.all(axis=1))
