"""How deep points are inside a rigid shape where they start: contact pushes out, which is no motion that was asked for.

Distances as in :mod:`sim_core.contact.shapes`, without derivatives:

    sphere    |y| - R
    box       |max(q, 0)| + min(max(q_i), 0) - r,  q = |y| - (h - r)
    cylinder  the same with q = (rho - (R - r), |z| - (H - r))
    plane     z
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

HALF_SPACE, SPHERE, CYLINDER, BOX = range(4)


def distances(y: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """Signed distances [m] ``(n,)`` of points in the shape's own frame [m] ``(n, 3)``, negative inside."""
    kind = int(shape[0])
    if kind == HALF_SPACE:
        return np.asarray(y[:, 2])
    if kind == SPHERE:
        return np.asarray(np.linalg.norm(y, axis=1) - shape[1])
    if kind == CYLINDER:
        rounding = shape[3]
        radial, axial = np.hypot(y[:, 0], y[:, 1]), np.abs(y[:, 2])
        over = np.column_stack([radial - (shape[1] - rounding), axial - (shape[2] - rounding)])
    else:
        rounding = shape[4]
        over = np.abs(y) - (shape[1:4] - rounding)
    outside = np.linalg.norm(np.maximum(over, 0.0), axis=1)
    return np.asarray(outside + np.minimum(over.max(axis=1), 0.0) - rounding)


def over_triangles(points: np.ndarray, corners: np.ndarray) -> float:
    """Least distance [m] of points ``(n, 3)`` from the triangles ``(m, 3, 3)`` that they lie straight above or below,
    inf where they lie over none."""
    centres = corners.mean(axis=1)
    reach = np.linalg.norm(corners - centres[:, None], axis=2).max(axis=1)
    near = cKDTree(points).sparse_distance_matrix(cKDTree(centres), float(reach.max()), output_type="ndarray")
    if not len(near):
        return np.inf
    p, (a, b, c) = points[near["i"]], np.moveaxis(corners[near["j"]], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sides = [np.einsum("ni,ni->n", np.cross(v - u, p - u), normal) for u, v in ((a, b), (b, c), (c, a))]
    above = np.min(sides, axis=0) >= 0.0
    return float(np.abs(np.einsum("ni,ni->n", p - a, normal))[above].min(initial=np.inf))
