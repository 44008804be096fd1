"""Whether two surfaces go through each other where they start: contact keeps apart, it does not take apart."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from sim_core.contact.primitives import Primitives

SHIFT = 1e-6
"""How far surfaces are shifted to decide what lies in a plane, in lengths of an edge."""

ASKEW = np.array([0.5377, 0.6133, 0.5785])
"""A direction that no edge of a mesh is likely to have."""


def cross(x: np.ndarray, edges: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether an edge ``(n, 2)`` goes through a triangle ``(m, 3)`` at the positions ``x`` [m].

    Its ends are on both sides of the triangle's plane, and the line through them passes all three of the
    triangle's edges on the same side (signs of the volumes of tetrahedra). Where an end lies in the plane,
    or the line meets an edge, the signs are those of both of two positions that are shifted a little, opposite
    ways: what only touches is not through.
    """
    if not (len(edges) and len(triangles)):
        return False
    lengths = np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1)
    shift = SHIFT * float(np.median(lengths)) * ASKEW
    return all(_cross(x, edges, triangles, sign * shift) for sign in (1.0, -1.0))


def _cross(x: np.ndarray, edges: np.ndarray, triangles: np.ndarray, shift: np.ndarray) -> bool:
    """The same with the edges shifted [m] ``(3,)``, by signs alone."""
    (centres, r), (others, s) = Primitives(edges).spheres(x), Primitives(triangles).spheres(x)
    near = cKDTree(centres).sparse_distance_matrix(cKDTree(others), float(r.max() + s.max()), output_type="ndarray")
    close = near["v"] <= r[near["i"]] + s[near["j"]]
    edge, triangle = edges[near["i"][close]], triangles[near["j"][close]]
    p, q = (x[edge[:, k]] + shift for k in range(2))
    a, b, c = (x[triangle[:, k]] for k in range(3))

    def volume(u: np.ndarray, v: np.ndarray, w: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("ni,ni->n", np.cross(v - u, w - u), z - u))

    apart = volume(a, b, c, p) * volume(a, b, c, q) < 0.0
    turns = np.stack([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
    through = np.all(turns > 0.0, axis=0) | np.all(turns < 0.0, axis=0)
    return bool(np.any(apart & through))
