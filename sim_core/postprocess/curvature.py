"""Principal curvatures of a triangulated surface from its vertex normals."""

from __future__ import annotations

import numpy as np

from sim_core.postprocess.surfaces import vertex_normals


def largest_curvature(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Principal curvature of largest magnitude at each vertex [1/m] ``(v,)``, without its sign.

    In each triangle with edges e_k and differences dn_k of the normals at their ends the second fundamental form II
    is the least-squares solution of II e_k = dn_k in its plane (Rusinkiewicz, Estimating curvatures and their
    derivatives on triangle meshes, 3DPVT 2004, sec. 3.1); vertices take the mean over the triangles around, weighted
    by area.
    """
    normals = vertex_normals(vertices, triangles)
    corner, turn = vertices[triangles], normals[triangles]
    e, dn = np.roll(corner, -1, axis=1) - corner, np.roll(turn, -1, axis=1) - turn
    first = e[:, 0] / np.maximum(np.linalg.norm(e[:, 0], axis=1, keepdims=True), 1e-300)
    normal = np.cross(e[:, 0], e[:, 1])
    area = np.linalg.norm(normal, axis=1)
    second = np.cross(normal / np.maximum(area, 1e-300)[:, None], first)
    u, v = np.einsum("tkj,tj->tk", e, first), np.einsum("tkj,tj->tk", e, second)
    zero = np.zeros_like(u)
    rows = np.concatenate([np.stack([u, v, zero], axis=-1), np.stack([zero, u, v], axis=-1)], axis=1)
    right = np.concatenate([np.einsum("tkj,tj->tk", dn, first), np.einsum("tkj,tj->tk", dn, second)], axis=1)
    scale = np.maximum(np.abs(rows).max(axis=(1, 2)), 1e-300)
    rows, right = rows / scale[:, None, None], right / scale[:, None]
    a, b, c = np.einsum("tij,tj->it", np.linalg.pinv(rows), right)
    mean, spread = 0.5 * (a + c), np.sqrt((0.5 * (a - c)) ** 2 + b**2)
    largest = np.abs(mean) + spread
    total, weight = np.zeros(len(vertices)), np.zeros(len(vertices))
    for k in range(3):
        np.add.at(total, triangles[:, k], area * largest)
        np.add.at(weight, triangles[:, k], area)
    return np.asarray(total / np.maximum(weight, 1e-300))
