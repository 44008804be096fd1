"""Constants of the contact law where the rig gives none: contact that does not shift surfaces.

Two surfaces under the pressure p stand the gap g(p) = s w apart, p = P (1 - s)^2 / s, where w is the range of the law
and P = k w its scale of pressure (:mod:`sim_core.contact.pressure_and_friction`). Seen from the gap r w, which belongs
to the pressure that is typical, they are displaced by (s - r) w, never by more than w. So that the displacement is
small against what contact resolves,

    w = least of:  0.5 % of the edges of a gel's surface,  30 % of the thickness of a sheet,  30 um
    P = a quarter of Young's modulus of the softer gel;  150 kPa where there is none
    r = 0.6 on gels (6.7 % of Young's modulus),  0.9 elsewhere (1.7 kPa)

and the gap is counted from r w before the surfaces, as far as their thicknesses allow: points of surfaces that are
simulated have to stay on their side of each other. The force of a sphere on a gel is then off by 0.5 % at most, where
the contact is two cells wide or more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.rigs import Gel, Rig, Sheet
from sim_core.rigs.schema import Contact
from sim_core.scene.assembly import BuiltBody, contact_triangles

OF_EDGE, OF_THICKNESS, WIDEST_M = 5e-3, 0.3, 3e-5
"""Range as a share of the edges of a gel's surface and of the thickness of a sheet, and the widest [m], the roughness
of paper and skins."""

OF_MODULUS, PRESSURE_PA = 0.25, 1.5e5
"""Scale of pressure as a share of Young's modulus of a gel, and without a gel [Pa]."""

REST_ON_GEL, REST = 0.6, 0.9
"""Share of the range that is left at the typical pressure."""

FINE = 5.0
"""Percentile of the edges of a surface that counts: its finest, where fields are steep."""

OF_OFFSET = 0.5
"""Share of the distance without gap of two simulated surfaces that may be taken out of it."""


@dataclass(frozen=True)
class ContactConstants:
    """``range_m`` [m]; ``stiffness_pa_per_m`` [Pa/m]; ``displacement_m``: gap at the typical pressure [m]."""

    range_m: float
    stiffness_pa_per_m: float
    displacement_m: float


def finest_edge(body: BuiltBody) -> float:
    """Length [m] of the finest edges of a body's surface as the rig has it."""
    corners = body.drawn[contact_triangles(body) - int(body.nodes[0])]
    return float(np.percentile(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), FINE))


def constants_of(rig: Rig, contact: Contact, edges: dict[str, float]) -> ContactConstants:
    """Constants of a contact. ``edges``: :func:`finest_edge` of the gels [m], by name.

    What the rig gives stands. A range without a stiffness keeps the scale of pressure; a stiffness without a range is
    within the range of such bodies.
    """
    specs = {name: rig.bodies[name] for name in contact.between}
    gels = {name: spec for name, spec in specs.items() if isinstance(spec, Gel)}
    sheets = [spec for spec in specs.values() if isinstance(spec, Sheet)]
    pressure = min((OF_MODULUS * gel.material.E_pa for gel in gels.values()), default=PRESSURE_PA)
    span = contact.range_m
    if span is None:
        spans = [OF_EDGE * edges[name] for name in gels]
        spans += [OF_THICKNESS * sheet.material.thickness_m for sheet in sheets]
        span = min([WIDEST_M, *spans])
    stiffness = contact.stiffness_pa_per_m or pressure / span
    return ContactConstants(span, stiffness, (REST_ON_GEL if gels else REST) * span)
