"""Points and edges inside a rigid shape that see what lies between the points of a deformable surface.

A surface is tested at its points against the signed distance of a shape (:mod:`sim_core.contact.shapes`). A
corner of a box under the middle of a triangle, or a peg thinner than a cell, would escape that test; so points
and edges of the shape are tested against the surface's triangles and edges too, at a distance of their own:

    box        corners and edges of the core, at the rounding
    cylinder   rims of the core as polygons (0.5 % of the radius inside), at the rounding; axis at the radius
    sphere     centre, at the radius

A half space has neither points nor edges. A flat triangle on a round shape is too deep by up to
L^2 / (8 R) where its corners touch. The axis and the centre therefore leave twice that, at most a tenth of the radius,
with the length L of the flat pieces between the points of a gel or a sheet: these bear, because the axis does not turn
with its body and knows of no slip around it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.contact.shapes import BOX, CYLINDER, SPHERE

RIM = 32
"""Corners of the polygon that stands for the rim of a cylinder."""


@dataclass(frozen=True)
class Core:
    """``points``: [m] ``(n, 3)`` in the body frame; ``edges``: between them, int ``(m, 2)``; ``offset``: [m],
    distance from them at which the shape's surface is; ``round``: whether that surface is curved there."""

    points: np.ndarray
    edges: np.ndarray
    offset: float
    round: bool

    def reach(self, facet_m: float) -> float:
        """Distance [m] at which curved faces with edges of ``facet_m`` are stopped."""
        if not self.round or facet_m == 0.0:
            return self.offset
        return self.offset - min(facet_m**2 / (4.0 * self.offset), 0.1 * self.offset)


def cores(shape: np.ndarray) -> list[Core]:
    """Parts of the core of a shape (array of :mod:`sim_core.contact.shapes`)."""
    kind = int(shape[0])
    if kind == SPHERE:
        return [Core(np.zeros((1, 3)), np.empty((0, 2), dtype=int), float(shape[1]), True)]
    if kind == BOX:
        corners = np.array([(a, b, c) for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)], dtype=float)
        edges = np.array([(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit])
        return [Core(corners * (shape[1:4] - shape[4]), edges, float(shape[4]), False)]
    if kind == CYLINDER:
        angle = 2.0 * np.pi * np.arange(RIM) / RIM
        radius, half = shape[1] - shape[3], shape[2] - shape[3]
        ring = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        rims = np.vstack([np.column_stack([ring, np.full(RIM, side * half)]) for side in (-1.0, 1.0)])
        here = np.arange(RIM)
        around = np.column_stack([here, np.roll(here, -1)])
        parts = [Core(rims, np.vstack([around, around + RIM]), float(shape[3]), False)]
        inner = max(float(shape[2] - shape[1]), 0.0)
        if inner > 0.0:
            ends = np.array([[0.0, 0.0, -inner], [0.0, 0.0, inner]])
            parts.append(Core(ends, np.array([[0, 1]]), float(shape[1]), True))
        return parts
    return []
