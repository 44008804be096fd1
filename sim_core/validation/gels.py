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

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import PchipInterpolator

from sim_core.contact.rigid import RigidContact
from sim_core.contact.samples import face_samples
from sim_core.contact.shapes import SPHERE
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.geometry.solids import block
from sim_core.solve.step import advance
from sim_core.solve.system import System
from sim_core.validation.case import FORCES, STATICS, Case, NotCovered
from sim_core.validation.specimens import rest

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
CONTACT = {"stiffness_pa_per_m": 2e11, "range_m": 4e-7, "friction": 0.0}
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


def sphere_on_layer(nu: float, cells: tuple[int, int], steps: int = 4) -> Pressed:
    """A quarter of the layer. ``cells``: along half a side and through the thickness."""
    mesh = block(
        (2 * HALF_SIDE, 2 * HALF_SIDE, THICKNESS),
        (2 * cells[0], 2 * cells[0], cells[1]),
        {"x_middle": 0.12, "y_middle": 0.12, "top": 0.5},
        cut=(0, 1),
    )
    nodes, tets = mesh.nodes - [0.0, 0.0, THICKNESS], mesh.tets
    top = mesh.surface[mesh.face_sets["top"]]
    chi, _ = LAYER[nu]
    depth = (chi * THICKNESS) ** 2 / RADIUS

    everything = np.vstack([nodes, [0.0, 0.0, RADIUS + 1e-6]])
    body = len(nodes)
    elastic = NeoHookean("gel", tets, everything)
    elastic.configure({"E_pa": MODULUS, "nu": nu})
    sphere = RigidContact(
        "contact", face_samples(top, everything), body, np.array([SPHERE, RADIUS, 0, 0, 0]), np.eye(3)
    )
    sphere.configure(CONTACT)
    prescribed = np.zeros((len(everything), 3), dtype=bool)
    prescribed[:body, 0] = nodes[:, 0] < 1e-9
    prescribed[:body, 1] = nodes[:, 1] < 1e-9
    prescribed[:body][nodes[:, 2] < -THICKNESS + 1e-9] = True
    prescribed[body] = True
    empty = sp.csr_matrix((len(everything),) * 2)
    system = System(everything, empty, prescribed, [elastic, sphere], np.zeros(3), inertia=False)
    state = rest(system)
    for k in range(1, steps + 1):
        targets = everything.copy()
        targets[body, 2] = RADIUS - depth * k / steps
        state, _ = advance(system, state, targets, 1.0)
    force = -4.0 * float(system.static_gradient()[body, 2])
    hertz = 4.0 / 3.0 * MODULUS / (1.0 - nu**2) * np.sqrt(RADIUS) * depth**1.5
    line = np.flatnonzero((np.abs(nodes[:, 1]) < 1e-9) & (nodes[:, 2] > -1e-9))
    line = line[np.argsort(nodes[line, 0])]
    moved = (state.x[line] - nodes[line])[:, [0, 2]] * [1.0, -1.0] / depth
    return Pressed(float(force / hertz), nodes[line, 0] / (0.5 * THICKNESS), moved)


def gel_cases() -> Iterator[Case | NotCovered]:
    """All comparisons of a sphere on a layer. Errors of markers are relative to the depth."""
    mesh = "quarter, 12 x 12 x 5 quadratic"
    for nu, (_, reference) in LAYER.items():
        pressed = sphere_on_layer(nu, (12, 5))
        name = f"sphere on a bonded layer, nu = {nu:g}"
        yield Case(name, "force", "Hertz", reference, pressed.force, FORCES, mesh, SOURCE)
        for r, answers in MARKERS[nu].items():
            for quantity, answer, found in zip(("outward", "downward"), answers, pressed.at(r), strict=True):
                if answer is not None:
                    what = f"marker at {r:g} a, {quantity}"
                    yield Case(name, what, "depth", answer, found, STATICS, mesh, SOURCE, scale=1.0)
    yield NotCovered(
        "half space under a sphere, a punch, a cone",
        "a contact radius of a twentieth of the thickness still costs 5 % against the half space; the bonded layer "
        "above is the sharper test, and there is no rigid cone",
        "Hertz, Sneddon",
    )
    yield NotCovered("pull-off from an adhesive sphere", "contact has no adhesion", "Johnson, Kendall & Roberts 1971")
