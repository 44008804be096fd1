"""Where a deformable surface is tested for contact: quadrature points with their areas.

Sheets are sampled at their nodes (area: a third of the triangles around), on round rigid shapes at the middles of
their edges too (as if each triangle were cut in four): a flat triangle stands on a drum there, and only points of the
sheet know how the drum turns under them. Gels are sampled at the nodes and the centres of their quadratic faces
(seven-point rule of degree 3: Stroud, Approximate Calculation of Multiple Integrals, 1971, T2:3-3), so that every node
of a surface is a sample and uniform pressure gives consistent nodal forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sim_core.contact.measures import SharedAreas, equal_shares
from sim_core.geometry.sheets import SheetMesh

_CORNER, _MIDDLE, _CENTRE = 1.0 / 20.0, 2.0 / 15.0, 9.0 / 20.0
"""Shares of a face's area at its corners, edge midpoints and centre (exact to degree 3)."""


@dataclass(frozen=True)
class Samples:
    """``nodes``: int32 ``(n, k)``; ``weights``: ``(n, k)``, rows sum to one; ``areas`` [m^2] ``(n,)``;
    ``offset`` [m]: distance of the real surface from the sampled one (half a sheet's thickness). ``shared``: of which
    triangles at rest the areas are shares (None: they are not measured)."""

    nodes: np.ndarray
    weights: np.ndarray
    areas: np.ndarray
    offset: float
    shared: SharedAreas | None = None

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Sample positions [m] ``(n, 3)`` for node positions ``x``."""
        return np.asarray(np.einsum("nk,nkj->nj", self.weights, x[self.nodes]))


def sheet_samples(mesh: SheetMesh, node_offset: int, thickness_m: float, divided: bool = False) -> Samples:
    """Nodes of a sheet, numbered from ``node_offset`` on; ``divided``: and the middles of its edges."""
    count = len(mesh.nodes)
    offset = 0.5 * thickness_m
    nodes = np.arange(node_offset, node_offset + count, dtype=np.int32)[:, None]
    shared = equal_shares(mesh.triangles, mesh.triangles + node_offset, count)
    if not divided:
        return Samples(nodes, np.ones((count, 1)), mesh.node_areas, offset, shared)
    edges, inverse = _sides(mesh.triangles)
    middles = equal_shares(inverse, shared.triangles, len(edges))
    shares = sp.vstack([0.25 * shared.shares, 0.75 * middles.shares]).tocsr()
    pairs = np.vstack([np.repeat(nodes, 2, axis=1), edges + node_offset]).astype(np.int32)
    weights = np.vstack([np.tile([1.0, 0.0], (count, 1)), np.full((len(edges), 2), 0.5)])
    return Samples(pairs, weights, shares @ mesh.areas, offset, SharedAreas(shared.triangles, shares))


def face_samples(faces: np.ndarray, nodes: np.ndarray) -> Samples:
    """Nodes and centres of quadratic faces ``(m, 6)`` (corners a b c, midpoints ab bc ca)."""
    corner = nodes[faces[:, :3]]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    members, place = np.unique(faces, return_inverse=True)
    shares = np.outer(area, [_CORNER] * 3 + [_MIDDLE] * 3)
    at_nodes = np.bincount(place.ravel(), weights=shares.ravel(), minlength=len(members))
    own_shares = sp.csr_matrix(
        (np.tile([_CORNER] * 3 + [_MIDDLE] * 3, len(faces)), (place.ravel(), np.repeat(np.arange(len(faces)), 6))),
        shape=(len(members), len(faces)),
    )
    shared = SharedAreas(faces[:, :3], sp.vstack([own_shares, _CENTRE * sp.identity(len(faces))]).tocsr())
    own = np.vstack([np.repeat(members[:, None], 6, axis=1), faces])
    weights = np.vstack(
        [np.tile([1.0, 0, 0, 0, 0, 0], (len(members), 1)), np.tile([-1 / 9] * 3 + [4 / 9] * 3, (len(faces), 1))]
    )
    areas = np.concatenate([at_nodes, _CENTRE * area])
    return Samples(np.ascontiguousarray(own, dtype=np.int32), weights, areas, 0.0, shared)


def face_triangles(faces: np.ndarray) -> np.ndarray:
    """Four linear triangles for each quadratic face: int32 ``(4 m, 3)``, same orientation."""
    a, b, c, ab, bc, ca = faces.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.ascontiguousarray(np.vstack([np.column_stack(p) for p in parts]), dtype=np.int32)


def triangle_edges(triangles: np.ndarray, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of a triangle mesh once each, int32 ``(k, 2)``, and their areas [m^2]: a third of the adjacent
    triangles."""
    corner = nodes[triangles]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    edges, inverse = _sides(triangles)
    areas = np.bincount(inverse.ravel(), weights=np.repeat(area / 3.0, 3), minlength=len(edges))
    return np.ascontiguousarray(edges, dtype=np.int32), areas


def edge_shares(triangles: np.ndarray) -> SharedAreas:
    """Of which triangles the areas of :func:`triangle_edges` are shares."""
    edges, inverse = _sides(triangles)
    return equal_shares(inverse, triangles, len(edges))


def _sides(triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Edges of a triangle mesh once each, int ``(k, 2)``, and which of them the sides of a triangle are ``(m, 3)``."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=-1).reshape(-1, 2)
    edges, inverse = np.unique(sides, axis=0, return_inverse=True)
    return edges, inverse.reshape(-1, 3)
