"""A rigid punch with a flat end that is pressed on a layer of gel, bonded to a rigid base: force against depth.

The pressure of a sharp punch is singular at its rim, so the error falls with the size of the cells there and the mesh
is refined along it. The exact force is that of :mod:`sysid.validation.bonded_layer`: on this layer 1.8 times that
on a half space, 2 E* a d. Rims of rigid cylinders are rounded for contact: by 0.01 of the radius here, as the rig says,
and by 0.1 of it (0.2 mm) where it does not. The first is held against a sharp punch, the second against the profile
that it has, with which the contact grows. Small strain: the depth is 1 % of the radius.

Errors measured with cells of 0.6, 0.3, 0.15 and 0.1 mm along the rim, on a radius of 2 mm: 5.6, 2.7, 0.3 and -0.3 % of
the sharp one, whose own rounding is in them; 3.7, 2.2 and 1.6 % of the other from 0.3 mm on, as the edge of its contact
lies in a rounding that is as wide as a cell.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sysid.validation.bonded_layer import punch, rounded_punch
from sysid.validation.case import FORCES, Case
from sysid.validation.gels import pressed_rig

RADIUS, THICKNESS, HALF_SIDE, MODULUS = 2e-3, 4e-3, 20e-3, 2e5
SHARP, DEFAULT = 2e-5, 2e-4
"""Radius of the rounding of the rim [m]: of a punch that is all but sharp, and where the rig does not say."""

DEPTH, START = 0.01 * RADIUS, 5e-5
EDGES = (6e-4, 3e-4, 1.5e-4)
"""Of the cells along the rim [m]."""

SOURCE = "Lebedev-Ufliand equation"


def punch_rig(nu: float, edge: float, rim: float | None) -> Rig:
    """A quarter of the layer and the punch above it. ``edge``: of the cells along the rim [m]; ``rim``: the radius of
    its rounding [m], where the rig says it."""
    count, wide = int(np.ceil(np.pi * RADIUS / edge)), edge / 3.0
    angles = 0.5 * np.pi * (np.arange(count) + 0.5) / count
    along = RADIUS * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    top = 0.5 * THICKNESS
    boxes = [
        {"x_m": [x - wide, x + wide], "y_m": [y - wide, y + wide], "z_m": [top - wide, top], "edge_m": edge}
        for x, y in along.tolist()
    ]
    layer = {
        "type": "block",
        "size_m": [2 * HALF_SIDE, 2 * HALF_SIDE, THICKNESS],
        "cells": [18, 18, 4],
        "graded": [{"towards": place, "ratio": 0.12} for place in ("x_middle", "y_middle")]
        + [{"towards": "top", "ratio": 0.5}],
        "refine": boxes,
        "symmetry": ["x", "y"],
    }
    steel = {"type": "cylinder", "radius_m": RADIUS, "length_m": 2 * RADIUS}
    if rim is not None:
        steel["edge_radius_m"] = rim
    return pressed_rig("punch_on_layer", layer, (MODULUS, nu), steel, RADIUS + START)


def punch_force(nu: float, edge: float, rim: float | None) -> float:
    """Force over 2 E* a d of the punch at :data:`DEPTH`, as :func:`punch_rig` gives it."""
    simulation = Simulation(build_scene(punch_rig(nu, edge, rim)))
    simulation.step({"hand": (np.array([0.0, 0.0, RADIUS - DEPTH]), Rotation.identity())}, 1.0)
    force = 4.0 * float(simulation.read()["wrench"][2])
    return force * (1.0 - nu**2) / (2.0 * MODULUS * RADIUS * DEPTH)


def rounded(nu: float) -> float:
    """The same of the layer without a side, and a rim of :data:`DEFAULT`."""
    shape = (RADIUS / THICKNESS, DEFAULT / THICKNESS, DEPTH / THICKNESS)
    return rounded_punch(nu, *shape) / (shape[0] * shape[2])


def punch_cases() -> Iterator[Case]:
    """All comparisons of flat punches."""
    nu, relative = 0.45, RADIUS / THICKNESS
    *coarser, finest = (punch_force(nu, edge, SHARP) for edge in EDGES)
    mesh = f"quarter, rim cells {1e3 * EDGES[-1]:g} mm"
    yield Case(
        f"flat punch on a bonded layer, nu = {nu:g}", "force", "2 E* a d", punch(nu, relative), finest, FORCES, mesh,
        SOURCE, tuple(coarser), remark="of a sharp punch; the rim of this one is rounded by 0.01 of its radius",
    )  # fmt: skip
    yield Case(
        "the same, rim rounded by 0.1 of the radius", "force", "2 E* a d", rounded(nu),
        punch_force(nu, EDGES[-1], None), FORCES, mesh, SOURCE,
    )  # fmt: skip
