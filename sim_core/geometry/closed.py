"""Closed triangle meshes of balls, cylinders and boxes, centred at the origin, with their mass properties.

The corners of the mesh lie on the true surface, the moments are those of the true solid.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull, Delaunay

from sim_core.geometry.sheets import SheetMesh


def sphere(radius_m: float, edge_m: float) -> SheetMesh:
    """An icosahedron whose triangles are cut in four, on the sphere, until the edges are no longer than ``edge_m``."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    flat = np.array([(0.0, s, t * golden) for s in (-1, 1) for t in (-1, 1)])
    nodes = np.vstack([np.roll(flat, k, axis=1) for k in range(3)])
    nodes /= np.linalg.norm(nodes, axis=1, keepdims=True)
    triangles = ConvexHull(nodes).simplices
    while _longest(nodes, triangles) * radius_m > edge_m:
        sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
        edges, place = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
        middle = nodes[edges].sum(axis=1)
        ab, bc, ca = place.reshape(-1, 3).T + len(nodes)
        a, b, c = triangles.T
        triangles = np.vstack([np.column_stack(t) for t in [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]])
        nodes = np.vstack([nodes, middle / np.linalg.norm(middle, axis=1, keepdims=True)])
    return _outward(radius_m * nodes, triangles)


def cylinder(radius_m: float, length_m: float, edge_m: float) -> SheetMesh:
    """A cylinder along z: rings of 6, 12, 18, ... nodes on its ends, and as many around as the outermost has. Along
    the axis, where it is straight, cells are up to four times as long as ``edge_m``."""
    rings = int(np.ceil(radius_m / edge_m - 1e-9))
    rows = int(np.ceil(length_m / (4.0 * edge_m) - 1e-9))
    disc = [np.zeros((1, 2))]
    for k in range(1, rings + 1):
        angle = 2.0 * np.pi * np.arange(6 * k) / (6 * k)
        disc.append(radius_m * k / rings * np.column_stack([np.cos(angle), np.sin(angle)]))
    end = np.vstack(disc)
    faces = Delaunay(end).simplices
    around = 6 * rings
    rim = end[-around:]
    heights = np.linspace(-0.5 * length_m, 0.5 * length_m, rows + 1)
    inner = [np.column_stack([rim, np.full(around, z)]) for z in heights[1:-1]]
    nodes = np.vstack([*(np.column_stack([end, np.full(len(end), z)]) for z in heights[[0, -1]]), *inner])
    first = np.arange(around)
    row = [first + len(end) - around, *(first + 2 * len(end) + around * k for k in range(rows - 1))]
    row.append(first + 2 * len(end) - around)
    sides = []
    for low, high in pairwise(row):
        after, above = np.roll(low, -1), np.roll(high, -1)
        sides += [np.column_stack([low, after, above]), np.column_stack([low, above, high])]
    return _outward(nodes, np.vstack([faces, faces + len(end), *sides]))


def box(size_m: tuple[float, float, float], edge_m: float) -> SheetMesh:
    """A cuboid whose faces are grids of cells no longer than ``edge_m``, with diagonals that turn about."""
    count = [int(np.ceil(s / edge_m - 1e-9)) for s in size_m]
    nodes, triangles = [], []
    offset = 0
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        i, j = np.meshgrid(np.arange(count[first] + 1), np.arange(count[second] + 1), indexing="ij")
        number = np.arange(i.size).reshape(i.shape)
        a, b, c, d = (n.ravel() for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
        even = ((i + j)[:-1, :-1].ravel() % 2 == 0)[:, None]
        cells = np.vstack(
            [
                np.where(even, np.column_stack([a, b, c]), np.column_stack([a, b, d])),
                np.where(even, np.column_stack([a, c, d]), np.column_stack([b, c, d])),
            ]
        )
        for end in (0, count[axis]):
            grid = np.zeros((i.size, 3), dtype=int)
            grid[:, axis], grid[:, first], grid[:, second] = end, i.ravel(), j.ravel()
            nodes.append(grid)
            triangles.append(cells + offset)
            offset += i.size
    grid, place = np.unique(np.vstack(nodes), axis=0, return_inverse=True)
    return _outward((grid / count - 0.5) * np.array(size_m), place.ravel()[np.vstack(triangles)])


def sphere_moments(radius_m: float) -> tuple[float, np.ndarray]:
    """Volume [m^3], and the integrals of x^2, y^2, z^2 over it [m^5] ``(3,)``."""
    volume = 4.0 / 3.0 * np.pi * radius_m**3
    return volume, np.full(3, volume * radius_m**2 / 5.0)


def cylinder_moments(radius_m: float, length_m: float) -> tuple[float, np.ndarray]:
    """The same of a cylinder along z."""
    volume = np.pi * radius_m**2 * length_m
    return volume, volume * np.array([radius_m**2 / 4.0, radius_m**2 / 4.0, length_m**2 / 12.0])


def box_moments(size_m: tuple[float, float, float]) -> tuple[float, np.ndarray]:
    """The same of a cuboid."""
    volume = float(np.prod(size_m))
    return volume, volume * np.array(size_m) ** 2 / 12.0


def _longest(nodes: np.ndarray, triangles: np.ndarray) -> float:
    corners = nodes[triangles]
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())


def _outward(nodes: np.ndarray, triangles: np.ndarray) -> SheetMesh:
    """The mesh of a convex body around the origin with its triangles counter-clockwise as seen from outside."""
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    inward = np.einsum("ni,ni->n", np.cross(b - a, c - a), a + b + c) < 0.0
    turned = np.where(inward[:, None], triangles[:, ::-1], triangles)
    return SheetMesh(np.ascontiguousarray(nodes), np.ascontiguousarray(turned, dtype=np.int32))
