"""Quantities on the surfaces of bodies by which they are coloured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.geometry import tet10
from sim_core.geometry.sheets import SheetMesh
from sim_core.geometry.solids import TetMesh
from sim_core.postprocess.curvature import largest_curvature
from sim_core.postprocess.layout import Layout
from sim_core.postprocess.surfaces import Surface, vertex_areas, vertex_normals
from sim_core.scene.scene import Frame
from sim_core.state_history import StateHistory

AT_NODES = np.vstack([np.eye(4), 0.5 * np.eye(4)[tet10.EDGES].sum(axis=1)])
"""Barycentric coordinates of the nodes of a quadratic tetrahedron, in the order of :mod:`sim_core.geometry.tet10`."""


@dataclass(frozen=True)
class Quantity:
    """What can be shown on a surface. ``unit`` is shown, of values in SI times ``factor``; ``bodies``: kinds of bodies
    that have it."""

    name: str
    unit: str
    factor: float
    bodies: tuple[str, ...]
    words: str


QUANTITIES = {
    q.name: q
    for q in (
        Quantity(
            "displacement", "mm", 1e3, ("sheet", "gel", "affine"), "way from where the mount would have carried it"
        ),
        Quantity("strain", "%", 1e2, ("sheet", "gel"), "largest principal Green-Lagrange strain, in magnitude"),
        Quantity("curvature", "1/m", 1.0, ("sheet",), "largest principal curvature, in magnitude"),
        Quantity("pressure", "kPa", 1e-3, ("sheet", "gel", "affine"), "normal contact force over area"),
        Quantity("slip", "mm/s", 1e3, ("sheet", "gel", "affine"), "speed at which it slides on what it touches"),
    )
}
"""By name."""


def quantity(
    name: str, layout: Layout, surface: Surface, states: StateHistory, step: int, frames: Mapping[str, Frame]
) -> np.ndarray:
    """A quantity at the vertices of a surface in SI units ``(v,)``: at instant ``step`` of the states, with the mounts
    at ``frames``. NaN where bodies of that kind do not have it."""
    if surface.nodes is None or surface.kind not in QUANTITIES[name].bodies:
        return np.full(len(surface.local), np.nan)
    x = states.positions[step]
    if name == "displacement":
        return np.asarray(np.linalg.norm(x[surface.nodes] - layout.carried(frames)[surface.nodes], axis=1))
    if name == "strain":
        return strain(layout, surface, x)
    if name == "curvature":
        return largest_curvature(x[surface.nodes], surface.triangles)
    if name == "slip":
        return np.asarray(states.slip_speeds[step][surface.nodes])
    return pressure(surface, states, step)


def pressure(surface: Surface, states: StateHistory, step: int) -> np.ndarray:
    """Contact pressure [Pa] ``(v,)``: of a gel as its nodes bear it; else normal nodal force over nodal area, which for
    the linear triangles of sheets and affine bodies is a consistent mean."""
    assert surface.nodes is not None
    if surface.kind == "gel":
        return np.asarray(states.pressures[step][surface.nodes])
    vertices = states.positions[step][surface.nodes]
    force = states.contact_forces_at(step)[surface.nodes]
    normal = np.abs((force * vertex_normals(vertices, surface.triangles)).sum(axis=1))
    return np.asarray(normal / np.maximum(vertex_areas(vertices, surface.triangles), 1e-300))


def strain(layout: Layout, surface: Surface, x: np.ndarray) -> np.ndarray:
    """Largest principal Green-Lagrange strain in magnitude, E = (F^T F - 1) / 2, at the vertices ``(v,)``: of a gel in
    its volume, of a sheet in its midsurface; the mean over the elements around."""
    body = layout.bodies[surface.body]
    assert surface.nodes is not None
    now = x[body.nodes]
    if isinstance(body.mesh, TetMesh):
        elements = body.mesh.tets
        slopes, _ = tet10.gradients(body.mesh.nodes[elements], AT_NODES)
        gradient = np.einsum("mai,mqaj->mqij", now[elements], slopes)
    else:
        assert isinstance(body.mesh, SheetMesh)
        elements = body.mesh.triangles
        rest, moved = (p[elements[:, 1:]] - p[elements[:, :1]] for p in (body.mesh.nodes, now))
        gradient = np.einsum("mjk,mki->mij", np.linalg.inv(rest[..., :2]), moved)[:, None]
        gradient = np.repeat(gradient, 3, axis=1)
    green = 0.5 * (np.swapaxes(gradient, -1, -2) @ gradient - np.eye(gradient.shape[-1]))
    largest = np.abs(np.linalg.eigvalsh(green)).max(axis=-1)
    total = np.bincount(elements.ravel(), largest.ravel(), len(body.nodes))
    count = np.bincount(elements.ravel(), minlength=len(body.nodes))
    return np.asarray((total / np.maximum(count, 1))[surface.nodes - body.nodes[0]])
