"""Material points of a sheet that is curved at rest: the nearest of the surface."""

from __future__ import annotations

import numpy as np

from sim_core.errors import ConfigError
from sim_core.geometry.sheets import SheetMesh

NEAR = 0.1
"""How far a point may be from the surface, over the longest edge of the triangle that is nearest."""


def locate_near(mesh: SheetMesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangle ``(k,)`` and barycentric weights ``(k, 3)`` of the points of a surface nearest to ``points`` [m]
    ``(k, 3)``. Raises ``ConfigError`` naming the first that is not near the surface."""
    corners = mesh.nodes[mesh.triangles]
    u, v = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    sides = np.stack([u, v], axis=1)
    inverse = np.linalg.inv(np.einsum("mai,mbi->mab", sides, sides))
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    triangle, weights = np.empty(len(points), dtype=np.int64), np.empty((len(points), 3))
    for k, point in enumerate(np.asarray(points, dtype=float)):
        local = np.einsum("mij,mjk,mk->mi", inverse, sides, point - corners[:, 0])
        found = np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)
        # Clipped to the triangle: exact inside, within the edges nearly so.
        found = np.maximum(found, 0.0)
        found /= found.sum(axis=1, keepdims=True)
        miss = np.linalg.norm(np.einsum("ma,mai->mi", found, corners) - point, axis=1)
        triangle[k] = int(np.argmin(miss))
        weights[k] = found[triangle[k]]
        if miss[triangle[k]] > NEAR * longest[triangle[k]]:
            raise ConfigError(
                f"Point {point.tolist()} [m] is {miss[triangle[k]]:.3g} m away from the sheet.",
                "Give points of the surface, in the coordinates of its mesh, in m.",
            )
    return triangle, weights
