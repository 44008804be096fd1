"""A pinhole camera of the truth: pose, Brown's distortion, rolling shutter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Array = np.ndarray


@dataclass(frozen=True)
class Pinhole:
    """Intrinsics [px], size [px], position [m] and rotation in the base (columns: axes x right, y down, z forward).

    ``distortion``: k1, k2, p1, p2, k3 of Brown (1971) as OpenCV defines them. ``line_s``: time between two rows of a
    rolling shutter, the middle row being taken at the stamp.
    """

    focal: float
    centre: tuple[float, float]
    size: tuple[int, int]
    position: Array
    rotation: Array
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    line_s: float = 0.0

    def project(self, points: Array) -> Array:
        """Pixels of points in the base frame [m], shape ``(..., 3)``; NaN behind the camera or beyond the picture."""
        local = (points - self.position) @ self.rotation
        depth = np.where(local[..., 2:] > 1e-6, local[..., 2:], np.nan)
        x, y = np.moveaxis(local[..., :2] / depth, -1, 0)
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        uv = np.stack([u, v], axis=-1) * self.focal + np.asarray(self.centre)
        inside = ((uv >= 0.0) & (uv <= np.asarray(self.size) - 1.0)).all(axis=-1)
        return np.where(inside[..., None], uv, np.nan)


def look_at(position: Array, target: Array, up: Array) -> Array:
    """Rotation of a camera at ``position`` that looks at ``target`` with ``up`` upwards in the picture."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.column_stack([right, np.cross(forward, right), forward])
