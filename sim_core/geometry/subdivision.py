"""Finer meshes of the same body, for meshes that have no rule by which to make them anew."""

from __future__ import annotations

import numpy as np

from sim_core.geometry import tet10
from sim_core.geometry.sheets import SheetMesh
from sim_core.geometry.solids import TetMesh, surface_of

_EIGHTH = np.array(
    [[0, 4, 6, 7], [4, 1, 5, 8], [6, 5, 2, 9], [7, 8, 9, 3], [4, 8, 5, 6], [4, 8, 6, 7], [5, 8, 9, 6], [6, 8, 9, 7]]
)
"""Nodes of a quadratic tetrahedron that are the corners of its eight parts."""


def split_triangles(mesh: SheetMesh, parts: int) -> SheetMesh:
    """Every triangle in ``parts`` squared, in its own plane."""
    if parts == 1:
        return mesh
    steps = [(i, j, parts - i - j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    weights = np.array(steps) / parts
    number = {step: k for k, step in enumerate(steps)}
    small = []
    for i, j, k in steps:
        if k > 0:
            small.append([number[i, j, k], number[i + 1, j, k - 1], number[i, j + 1, k - 1]])
        if k > 1:
            small.append([number[i + 1, j, k - 1], number[i + 1, j + 1, k - 2], number[i, j + 1, k - 1]])
    # A node is known by its corners and its weights there, so that a slit stays one.
    keys: dict[tuple[tuple[int, int], ...], int] = {}
    place = np.empty((len(mesh.triangles), len(steps)), dtype=np.int64)
    nodes = []
    for t, triangle in enumerate(mesh.triangles.tolist()):
        for s, step in enumerate(steps):
            key = tuple(sorted((v, w) for v, w in zip(triangle, step, strict=True) if w))
            if key not in keys:
                keys[key] = len(keys)
                nodes.append(weights[s] @ mesh.nodes[triangle])
            place[t, s] = keys[key]
    fine = place[:, np.array(small)].reshape(-1, 3)
    corners = mesh.nodes[mesh.triangles[0]]
    made = np.array(nodes)[fine[0]]
    if np.cross(made[1] - made[0], made[2] - made[0]) @ np.cross(corners[1] - corners[0], corners[2] - corners[0]) < 0:
        fine = fine[:, ::-1]
    return SheetMesh(np.array(nodes), np.ascontiguousarray(fine, dtype=np.int32))


def split_tets(mesh: TetMesh) -> TetMesh:
    """Every tetrahedron in eight, on the same curved elements; sets of faces are kept."""
    linear = mesh.tets[:, _EIGHTH].reshape(-1, 4).astype(np.int64)
    ends = np.vstack([np.eye(4), 0.5 * np.eye(4)[tet10.EDGES].sum(axis=1)])[_EIGHTH][:, tet10.EDGES]
    at_middles = tet10.shape(ends.mean(axis=2).reshape(-1, 4)).reshape(8, 6, 10)
    middles = np.einsum("cea,mai->mcei", at_middles, mesh.nodes[mesh.tets]).reshape(-1, 3)
    pairs = np.sort(linear[:, tet10.EDGES].reshape(-1, 2), axis=1)
    _, first, inverse = np.unique(pairs, axis=0, return_index=True, return_inverse=True)
    nodes = np.vstack([mesh.nodes, middles[first]])
    tets = np.concatenate([linear, len(mesh.nodes) + inverse.reshape(-1, 6)], axis=1)
    turned = np.linalg.det(nodes[tets[:, 1:4]] - nodes[tets[:, :1]]) < 0.0
    tets[turned] = tets[turned][:, [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]]
    fine = surface_of(nodes, tets, lambda corners: {})
    a, b, c, ab, bc, ca = mesh.surface.T
    parts = np.concatenate([np.column_stack(p) for p in [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]])
    parent = {tuple(sorted(part)): k % len(mesh.surface) for k, part in enumerate(parts.tolist())}
    of = np.array([parent[tuple(sorted(face))] for face in fine.surface[:, :3].tolist()])
    sets = {name: np.flatnonzero(np.isin(of, rows)) for name, rows in mesh.face_sets.items()}
    return TetMesh(fine.nodes, fine.tets, fine.surface, sets)
