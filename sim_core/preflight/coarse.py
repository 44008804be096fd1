"""Sheets whose cells are too coarse for the drums that they may lie around."""

from __future__ import annotations

import numpy as np

from sim_core.postprocess import Layout
from sim_core.preflight.finding import Finding
from sim_core.rigs import Rigid, Sheet
from sim_core.scene.assembly import BuiltBody, contact_triangles

WIDEST = 0.5
"""Length of the edges of a sheet over the radius of what it may lie on, from which on the ratio of tensions around half
a turn is off by 2 %: each edge turns by D = L/R, and 2 atanh(mu tan(D/2)) is more than mu D by D^2/12."""


def coarse_findings(layout: Layout) -> list[Finding]:
    """A finding for each sheet that may rub on a cylinder and has cells too long to lie around it."""
    found = []
    for contact in layout.rig.contacts:
        one, other = contact.between
        for sheet, drum in ((one, other), (other, one)):
            spec = layout.rig.bodies[drum]
            if not (isinstance(layout.rig.bodies[sheet], Sheet) and isinstance(spec, Rigid)):
                continue
            if spec.shape.type != "cylinder" or contact.friction == 0.0:
                continue
            radius, edge = spec.shape.radius_m, _edge(layout.bodies[sheet])
            if edge > WIDEST * radius:
                found.append(
                    Finding(
                        "coarse cells",
                        f"The cells of {sheet} are {1e3 * edge:.3g} mm long, too coarse to lie around {drum}, "
                        f"whose radius is {1e3 * radius:.3g} mm: friction around it would be wrong.",
                        f"Use cells of at most {1e3 * WIDEST * radius:.3g} mm where it may touch.",
                    )
                )
    return found


def _edge(body: BuiltBody) -> float:
    """Typical length [m] of the shortest edges of the triangles of a sheet: long ones may lie along the axis."""
    corners = body.drawn[contact_triangles(body) - int(body.nodes[0])]
    return float(np.median(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min(axis=1)))
