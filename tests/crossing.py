"""An oracle that knows nothing of the simulator: which edges of one triangle mesh cross triangles of another."""

import numpy as np


def edges_of(triangles):
    return np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=-1).reshape(-1, 2), axis=0)


def crossings(x, edges, triangles):
    """Number of pairs of an edge and a triangle, without a node in common, that intersect at ``x`` ``(n, 3)``.

    The ends of the edge are on both sides of the triangle's plane (by 1 nm, which rounding stays below), and the
    line through them is on the same side of all three of its edges (signed volumes).
    """
    p, q = x[edges[:, 0]][:, None], x[edges[:, 1]][:, None]
    a, b, c = (x[triangles[:, k]][None] for k in range(3))

    def volume(u, v, w, z):
        return np.einsum("...i,...i->...", np.cross(v - u, w - u), z - u)

    twice = np.linalg.norm(np.cross(b - a, c - a), axis=-1)
    above, below = (volume(a, b, c, end) / twice for end in (p, q))
    apart = (above * below < 0.0) & (np.minimum(np.abs(above), np.abs(below)) > 1e-9)
    turns = np.stack([volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)])
    through = np.all(turns > 0.0, axis=0) | np.all(turns < 0.0, axis=0)
    joined = (edges[:, None, :, None] == triangles[None, :, None, :]).any(axis=(2, 3))
    return int(np.count_nonzero(apart & through & ~joined))


def crossings_of(x, *meshes):
    """All crossings between and within triangle meshes (node indices into ``x``)."""
    triangles = np.vstack(meshes)
    return crossings(x, edges_of(triangles), triangles)
