"""Where a deformable surface is tested for contact: quadrature points with their areas.

Sheets are sampled at their nodes (area: a third of the triangles around), gels at six points of each
quadratic face (Dunavant's rule of degree 4), so that uniform pressure gives consistent nodal forces.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.geometry.sheets import SheetMesh

_A, _B = 0.445948490915965, 0.091576213509771
_RULE = np.array(
    [
        (_A, _A, 1 - 2 * _A),
        (_A, 1 - 2 * _A, _A),
        (1 - 2 * _A, _A, _A),
        (_B, _B, 1 - 2 * _B),
        (_B, 1 - 2 * _B, _B),
        (1 - 2 * _B, _B, _B),
    ]
)
_RULE_WEIGHTS = np.array([0.223381589678011] * 3 + [0.109951743655322] * 3)


@dataclass(frozen=True)
class Samples:
    """``nodes``: int32 ``(n, k)``; ``weights``: ``(n, k)``, rows sum to one; ``areas`` [m^2] ``(n,)``;
    ``offset`` [m]: distance of the real surface from the sampled one (half a sheet's thickness)."""

    nodes: np.ndarray
    weights: np.ndarray
    areas: np.ndarray
    offset: float

    def positions(self, x: np.ndarray) -> np.ndarray:
        """Sample positions [m] ``(n, 3)`` for node positions ``x``."""
        return np.asarray(np.einsum("nk,nkj->nj", self.weights, x[self.nodes]))


def sheet_samples(mesh: SheetMesh, node_offset: int, thickness_m: float) -> Samples:
    """Nodes of a sheet, numbered from ``node_offset`` on."""
    count = len(mesh.nodes)
    nodes = np.arange(node_offset, node_offset + count, dtype=np.int32)[:, None]
    return Samples(nodes, np.ones((count, 1)), mesh.node_areas, 0.5 * thickness_m)


def face_samples(faces: np.ndarray, nodes: np.ndarray) -> Samples:
    """Quadrature points of quadratic faces ``(m, 6)`` (corners a b c, midpoints ab bc ca)."""
    a, b, c = _RULE.T
    shape = np.column_stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a])
    corner = nodes[faces[:, :3]]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    count = len(_RULE_WEIGHTS)
    return Samples(
        np.ascontiguousarray(np.repeat(faces, count, axis=0), dtype=np.int32),
        np.tile(shape, (len(faces), 1)),
        np.outer(area, _RULE_WEIGHTS).ravel(),
        0.0,
    )


def face_triangles(faces: np.ndarray) -> np.ndarray:
    """Four linear triangles for each quadratic face: int32 ``(4 m, 3)``, same orientation."""
    a, b, c, ab, bc, ca = faces.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.ascontiguousarray(np.vstack([np.column_stack(p) for p in parts]), dtype=np.int32)
