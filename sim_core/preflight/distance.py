"""Distances between bodies of a rig that stand where they are placed, without deformation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from sim_core.postprocess import Layout
from sim_core.postprocess.surfaces import Surface
from sim_core.rigs import Rigid, Sheet
from sim_core.scene.scene import Frame

FINENESS = 12
"""Points along each side of a triangle that is large, where its distance to another body is measured."""


def signed_distance(spec: Rigid, points: np.ndarray) -> np.ndarray:
    """Distance [m] ``(n,)`` of points in the frame of a rigid body ``(n, 3)``, negative inside."""
    shape = spec.shape
    if shape.type == "plane":
        return np.asarray(points[:, 2])
    if shape.type == "sphere":
        return np.asarray(np.linalg.norm(points, axis=1) - shape.radius_m)
    if shape.type == "cylinder":
        radial = np.linalg.norm(points[:, :2], axis=1) - shape.radius_m
        over = np.stack([radial, np.abs(points[:, 2]) - 0.5 * shape.length_m], axis=1)
    else:
        over = np.abs(points) - 0.5 * np.array(shape.size_m)
    return np.asarray(np.linalg.norm(np.maximum(over, 0.0), axis=1) + np.minimum(over.max(axis=1), 0.0))


def half_thickness(layout: Layout, body: str) -> float:
    """Half the thickness [m] of a sheet, 0 of other bodies."""
    spec = layout.rig.bodies[body]
    return 0.5 * spec.material.thickness_m if isinstance(spec, Sheet) else 0.0


def sampled(vertices: np.ndarray, triangles: np.ndarray, spacing: float) -> np.ndarray:
    """Points on triangles [m] ``(n, 3)`` about ``spacing`` apart, at most :data:`FINENESS` along a side; the vertices
    first."""
    corner = vertices[triangles]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    count = np.clip(np.ceil(longest / spacing), 1, FINENESS).astype(int)
    found = [vertices]
    for n in np.unique(count[count > 1]):
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
        keep = i + j <= n
        b = np.stack([i[keep], j[keep], n - i[keep] - j[keep]], axis=1) / n
        found.append((b @ corner[count == n]).reshape(-1, 3))
    return np.vstack(found)


def gap(layout: Layout, one: Surface, other: Surface, x: np.ndarray, frames: Mapping[str, Frame]) -> float:
    """Smallest distance [m] between two bodies when the nodes are at ``x`` and the mounts at ``frames``, less half
    thicknesses of sheets; negative where one of them is rigid and the other goes into it. Between two meshes it is that
    of points on them, too large by less than half the distance of these points."""
    thickness = half_thickness(layout, one.body) + half_thickness(layout, other.body)
    for rigid, soft in ((one, other), (other, one)):
        spec = layout.rig.bodies[rigid.body]
        if isinstance(spec, Rigid):
            origin, rotation = layout.body_frame(rigid.body, frames)
            vertices = soft.vertices(layout, x, frames)
            points = sampled(vertices, soft.triangles, _spacing(vertices))
            return float(signed_distance(spec, rotation.inv().apply(points - origin)).min()) - thickness
    clouds = []
    for surface in (one, other):
        vertices = surface.vertices(layout, x, frames)
        clouds.append(sampled(vertices, surface.triangles, _spacing(vertices)))
    return float(cKDTree(clouds[0]).query(clouds[1])[0].min()) - thickness


def _spacing(vertices: np.ndarray) -> float:
    return max(float(np.ptp(vertices, axis=0).max()) / 40.0, 1e-6)
