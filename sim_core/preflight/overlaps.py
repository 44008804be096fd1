"""Bodies that overlap where they start."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from sim_core.contact.intersection_check import cross
from sim_core.postprocess import Layout, Surface, surfaces
from sim_core.preflight.distance import signed_distance
from sim_core.preflight.finding import Finding
from sim_core.rigs import Rigid

ALLOWED_M = 1e-6
"""Depth by which surfaces that lie on each other may overlap: round-off of what is written in a file."""


def overlap_findings(layout: Layout) -> list[Finding]:
    """A finding for each two bodies that go through each other at the start; rigid ones may."""
    found = []
    for one, other in combinations(surfaces(layout), 2):
        declared = layout.rig.contact(one.body, other.body) is not None
        depth = overlap(layout, one, other)
        if depth <= ALLOWED_M:
            continue
        by = f" by {1e3 * depth:.3g} mm" if np.isfinite(depth) else ""
        problem = f"{one.body} and {other.body} overlap at the start{by}"
        if declared:
            found.append(
                Finding(
                    "bodies overlap",
                    f"{problem}, and their contact cannot part them.",
                    "Move one of them, or the end effector that carries it, until they are apart.",
                )
            )
        else:
            found.append(
                Finding(
                    "bodies overlap",
                    f"{problem}, and no contact is declared between them: they pass through each other.",
                    "Move one of them; declare the contact if they are to touch.",
                )
            )
    return found


def overlap(layout: Layout, one: Surface, other: Surface) -> float:
    """Depth [m] by which two bodies overlap at the start, 0 if not, infinite where it is not known how deep."""
    x, frames = layout.rest, layout.start
    if one.nodes is None and other.nodes is None:
        return 0.0
    for rigid, soft in ((one, other), (other, one)):
        spec = layout.rig.bodies[rigid.body]
        if isinstance(spec, Rigid):
            origin, rotation = layout.body_frame(rigid.body, frames)
            vertices = soft.vertices(layout, x, frames)
            depth = -float(signed_distance(spec, rotation.inv().apply(vertices - origin)).min())
            if depth > 0.0:
                return depth
            if rigid.kind == "plane":
                return 0.0
            return np.inf if _crossing(layout, soft, rigid) else 0.0
    return np.inf if _crossing(layout, one, other) or _inside(layout, one, other) else 0.0


def _crossing(layout: Layout, one: Surface, other: Surface) -> bool:
    """Whether an edge of one surface goes through a triangle of the other."""
    a, b = (s.vertices(layout, layout.rest, layout.start) for s in (one, other))
    if (a.max(axis=0) < b.min(axis=0)).any() or (b.max(axis=0) < a.min(axis=0)).any():
        return False
    points = np.vstack([a, b])
    shifted = other.triangles + len(a)
    return cross(points, _edges(one.triangles), shifted) or cross(points, _edges(shifted), one.triangles)


def _inside(layout: Layout, one: Surface, other: Surface) -> bool:
    """Whether one body lies within the other, a closed one, whose surface it does not cross: by the solid angle that
    the triangles take from a vertex (Van Oosterom & Strackee, IEEE Trans. Biomed. Eng. 30, 1983)."""
    for closed, within in ((one, other), (other, one)):
        if closed.kind == "sheet":
            continue
        vertices = closed.vertices(layout, layout.rest, layout.start)
        point = within.vertices(layout, layout.rest, layout.start)[0]
        corner = vertices[closed.triangles] - point
        length = np.linalg.norm(corner, axis=2)
        volume = np.einsum("ti,ti->t", corner[:, 0], np.cross(corner[:, 1], corner[:, 2]))
        a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
        down = length.prod(axis=1) + sum(
            np.einsum("ti,ti->t", p, q) * length[:, k] for p, q, k in ((a, b, 2), (b, c, 0), (c, a, 1))
        )
        if abs(float(np.sum(2.0 * np.arctan2(volume, down)))) > 2.0 * np.pi:
            return True
    return False


def _edges(triangles: np.ndarray) -> np.ndarray:
    return np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
