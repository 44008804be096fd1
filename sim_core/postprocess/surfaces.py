"""Triangulated surfaces of all bodies of a rig, and where their vertices are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.contact.samples import face_triangles
from sim_core.geometry import closed
from sim_core.geometry.sheets import SheetMesh
from sim_core.geometry.solids import TetMesh
from sim_core.postprocess.layout import Layout
from sim_core.rigs import Gel, Plane, Rigid
from sim_core.scene.scene import Frame

ROUND_CELLS = 8.0
"""Edges of the triangles that draw a round rigid shape, per radius."""


@dataclass(frozen=True)
class Surface:
    """Surface of one body. ``kind``: 'sheet', 'gel', 'affine', 'rigid' or 'plane' (a square that stands for it).

    ``triangles``: int32 ``(m, 3)``, vertex indices, outward of a closed body. ``nodes``: node of the scene that each
    vertex is, ``(v,)``; None for rigid bodies, whose vertices are at ``local`` [m] ``(v, 3)`` in the body's frame.
    ``bonded``: bool ``(m,)``, triangles of a gel's face that is glued to its mount.
    """

    body: str
    kind: str
    triangles: np.ndarray
    nodes: np.ndarray | None
    local: np.ndarray
    bonded: np.ndarray

    def vertices(self, layout: Layout, x: np.ndarray, frames: Mapping[str, Frame]) -> np.ndarray:
        """Where the vertices are [m] ``(v, 3)`` when the nodes are at ``x`` ``(N, 3)`` and the mounts at ``frames``."""
        if self.nodes is not None:
            return np.asarray(x[self.nodes])
        origin, rotation = layout.body_frame(self.body, frames)
        return np.asarray(origin + rotation.apply(self.local))


def surfaces(layout: Layout) -> list[Surface]:
    """Surfaces of all bodies, in the order of the rig. A plane is a square about as large as all else."""
    found = []
    for name, body in layout.bodies.items():
        if isinstance(body.spec, Rigid):
            local, triangles = _rigid(body.spec, _reach(layout, name))
            kind = "plane" if isinstance(body.spec.shape, Plane) else "rigid"
            found.append(Surface(name, kind, triangles, None, local, np.zeros(len(triangles), dtype=bool)))
            continue
        if isinstance(body.mesh, TetMesh):
            faces, on = body.mesh.surface, np.zeros(len(body.mesh.surface), dtype=bool)
            if isinstance(body.spec, Gel) and body.spec.bonded is not None:
                on[body.mesh.face_sets[body.spec.bonded]] = True
            triangles, bonded = face_triangles(faces), np.tile(on, 4)
        else:
            assert isinstance(body.mesh, SheetMesh)
            triangles, bonded = body.mesh.triangles, np.zeros(len(body.mesh.triangles), dtype=bool)
        used, place = np.unique(triangles, return_inverse=True)
        compact = place.reshape(-1, 3).astype(np.int32)
        found.append(
            Surface(name, body.spec.type, compact, body.nodes[used], body.local[used], bonded)
        )  # fmt: skip
    return found


def _rigid(spec: Rigid, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in the body's frame [m] and triangles of a rigid shape."""
    shape = spec.shape
    if shape.type == "sphere":
        mesh = closed.sphere(shape.radius_m, shape.radius_m / ROUND_CELLS * 2.0)
    elif shape.type == "cylinder":
        mesh = closed.cylinder(shape.radius_m, shape.length_m, 2.0 * np.pi * shape.radius_m / 48.0)
    elif shape.type == "box":
        mesh = closed.box(shape.size_m, max(shape.size_m))
    else:
        corners = reach * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
        return corners, np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    return mesh.nodes, mesh.triangles.astype(np.int32)


def _reach(layout: Layout, plane: str) -> float:
    """Half the edge [m] of the square that stands for a plane: everything else is above it, with room."""
    origin, _ = layout.body_frame(plane, layout.start)
    others = [b.rest for n, b in layout.bodies.items() if n != plane]
    points = np.vstack(others) if others else np.zeros((1, 3))
    return 1.25 * float(np.linalg.norm(points - origin, axis=1).max(initial=0.01))


def vertex_normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Unit normals ``(v, 3)`` at the ``vertices`` [m] ``(v, 3)`` of ``triangles`` ``(t, 3)``: those of the triangles
    around weighted by their areas."""
    corner = vertices[triangles]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(total, triangles[:, k], normal)
    return np.asarray(total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-300))


def vertex_areas(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """A third of the area of the triangles around each vertex [m^2] ``(v,)``."""
    return SheetMesh(vertices, triangles).node_areas
