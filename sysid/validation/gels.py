"""A rigid sphere pressed on a layer of gel that is bonded to a rigid base: force, and what markers show.

The Lebedev-Ufliand equation of the frictionless contact, solved numerically (half-space limit: Hertz within
1e-4). Given per Poisson's ratio at a contact radius a of half the layer's thickness h: chi = sqrt(R d)/h and
the force over that of Hertz at the same depth d, F_Hertz = 4/3 E/(1 - nu^2) sqrt(R) d^1.5. Small strain, so
the sphere is large against the layer. Markers on the surface move inward at nu = 0.3, hardly at 0.45 and outward at
0.49: their radial motion tells Poisson's ratio.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sysid.validation.case import FORCES, STATICS, Case, NotCovered

LAYER = {0.3: (0.43556, 1.59091), 0.45: (0.424178, 1.75048), 0.49: (0.418804, 1.83201)}
"""Poisson's ratio: sqrt(R d)/h and F/F_Hertz at a/h = 0.5."""

MARKERS: dict[float, dict[float, tuple[float, float | None]]] = {
    0.3: {
        0.5: (-0.0918123, 0.835277),
        0.9: (-0.127412, 0.466285),
        1.5: (-0.0508462, 0.0980923),
        2.0: (-0.0172708, 0.0281996),
    },
    0.45: {
        0.5: (-0.00772487, 0.826318),
        0.9: (-0.0045472, 0.437257),
        1.5: (0.034723, 0.0567988),
        2.0: (0.048077, -0.00591698),
    },
    0.49: {2.0: (0.0765, None)},
}
"""Poisson's ratio: at the distances r/a, radial motion (outward) and sinking of the surface over the depth."""

THICKNESS, HALF_SIDE, RADIUS, MODULUS = 4e-3, 20e-3, 40e-3, 2e5
SOURCE = "Lebedev-Ufliand equation"


@dataclass(frozen=True)
class Pressed:
    """``force``: F / F_Hertz. ``r``: distances of points of the surface from the axis, over the contact radius;
    ``moved``: how far each has moved outward and sunk, over the depth, ``(n, 2)``."""

    force: float
    r: np.ndarray
    moved: np.ndarray

    def at(self, r: float) -> tuple[float, float]:
        """Motion of a marker at the distance ``r``."""
        outward, sunk = PchipInterpolator(self.r, self.moved)(r)
        return float(outward), float(sunk)


def layer_rig(nu: float, cells: tuple[int, int]) -> Rig:
    """A quarter of the layer and the sphere above it, with the contact that rigs have by default. ``cells``: along half
    a side and through the thickness."""
    graded = [{"towards": place, "ratio": ratio} for place, ratio in
              (("x_middle", 0.12), ("y_middle", 0.12), ("top", 0.5))]  # fmt: skip
    layer = {
        "type": "block",
        "size_m": [2 * HALF_SIDE, 2 * HALF_SIDE, THICKNESS],
        "cells": [2 * cells[0], 2 * cells[0], cells[1]],
        "graded": graded,
        "symmetry": ["x", "y"],
    }
    return pressed_rig("sphere_on_layer", layer, (MODULUS, nu), {"type": "sphere", "radius_m": RADIUS}, RADIUS + 1e-4)


def pressed_rig(
    name: str, layer: dict[str, Any], material: tuple[float, float], presser: dict[str, Any], start: float
) -> Rig:
    """A block of gel, bonded below, whose top is at z = 0, and a rigid body above it, with the contact that rigs have
    by default. ``material``: Young's modulus [Pa] and Poisson's ratio; ``start``: height of the body's origin [m]."""
    modulus, nu = material
    return parse_rig(
        {
            "name": name,
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 1.0, "inertia": False},
            "bodies": {
                "gel": {
                    "type": "gel",
                    "shape": layer,
                    "material": {"E_pa": modulus, "nu": nu, "density_kg_m3": 1000.0},
                    "pose": {"position_m": [0.0, 0.0, -0.5 * layer["size_m"][2]]},
                    "bonded": "bottom",
                    "mount": "world",
                },
                "presser": {"type": "rigid", "shape": presser, "mount": "hand"},
            },
            "end_effectors": {"hand": {"start": {"position_m": [0.0, 0.0, start]}}},
            "contacts": [{"between": ["gel", "presser"]}],
            "sensors": {"wrench": {"type": "wrench", "on": "presser", "topic": "wrench"}},
        },
        name,
    )


def sphere_on_layer(nu: float, cells: tuple[int, int], steps: int = 4) -> Pressed:
    """Force on the sphere and motion of the surface, as :func:`layer_rig` gives them."""
    depth = (LAYER[nu][0] * THICKNESS) ** 2 / RADIUS
    simulation = Simulation(build_scene(layer_rig(nu, cells)))
    for k in range(1, steps + 1):
        place = np.array([0.0, 0.0, RADIUS - depth * k / steps])
        simulation.step({"hand": (place, Rotation.identity())}, 1.0)
    force = 4.0 * float(simulation.read()["wrench"][2])
    hertz = 4.0 / 3.0 * MODULUS / (1.0 - nu**2) * np.sqrt(RADIUS) * depth**1.5
    nodes = simulation.scene.bodies["gel"].rest
    line = np.flatnonzero((np.abs(nodes[:, 1]) < 1e-9) & (nodes[:, 2] > -1e-9))
    line = line[np.argsort(nodes[line, 0])]
    own = simulation.scene.bodies["gel"].nodes[line]
    moved = (simulation.state.x[own] - nodes[line])[:, [0, 2]] * [1.0, -1.0] / depth
    return Pressed(float(force / hertz), nodes[line, 0] / (0.5 * THICKNESS), moved)


def gel_cases() -> Iterator[Case | NotCovered]:
    """All comparisons of a sphere on a layer. Errors of markers are relative to the depth."""
    mesh = "quarter, 12 x 12 x 5 quadratic"
    for nu, (_, reference) in LAYER.items():
        pressed = sphere_on_layer(nu, (12, 5))
        name = f"sphere on a bonded layer, nu = {nu:g}"
        yield Case(name, "force", "Hertz", reference, pressed.force, FORCES, mesh, SOURCE)
        for r, expected in MARKERS[nu].items():
            for quantity, answer, found in zip(("outward", "downward"), expected, pressed.at(r), strict=True):
                if answer is not None:
                    what = f"marker at {r:g} a, {quantity}"
                    yield Case(name, what, "depth", answer, found, STATICS, mesh, SOURCE, scale=1.0)
    yield NotCovered(
        "half space under a sphere, a cone",
        "a contact radius of a twentieth of the thickness still costs 5 % against the half space; bonded layers under "
        "spheres and a punch are the sharper test, and there is no rigid cone",
        "Hertz, Sneddon",
    )
    yield NotCovered("pull-off from an adhesive sphere", "contact has no adhesion", "Johnson, Kendall & Roberts 1971")
