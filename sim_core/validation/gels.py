"""Gels with known answers: a rigid sphere pressed on a layer that is bonded to a rigid base.

The Lebedev-Ufliand equation of the frictionless contact, solved numerically (half-space limit: Hertz within
1e-4). Given per Poisson's ratio at a contact radius of half the layer's thickness h: chi = sqrt(R d)/h and
the force over that of Hertz at the same depth d, F_Hertz = 4/3 E/(1 - nu^2) sqrt(R) d^1.5. Small strain, so
the sphere is large against the layer.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import scipy.sparse as sp

from sim_core.contact.rigid import RigidContact
from sim_core.contact.samples import face_samples
from sim_core.contact.shapes import SPHERE
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.geometry.solids import block
from sim_core.solve.step import State, advance
from sim_core.solve.system import System
from sim_core.validation.case import FORCES, Case

LAYER = {0.3: (0.43556, 1.59091), 0.45: (0.424178, 1.75048)}
"""Poisson's ratio: sqrt(R d)/h and F/F_Hertz at a/h = 0.5."""

THICKNESS, HALF_SIDE, RADIUS, MODULUS = 4e-3, 20e-3, 40e-3, 2e5
CONTACT = {"stiffness_pa_per_m": 2e11, "range_m": 4e-7, "friction": 0.0}
SOURCE = "Lebedev-Ufliand equation"


def sphere_on_layer(nu: float, cells: tuple[int, int], steps: int = 4) -> float:
    """F / F_Hertz of a quarter of the layer. ``cells``: along half a side and through the thickness."""
    mesh = block(
        (2 * HALF_SIDE, 2 * HALF_SIDE, THICKNESS),
        (2 * cells[0], 2 * cells[0], cells[1]),
        centre_ratio=0.12,
        top_ratio=0.5,
    )
    centre = mesh.nodes[mesh.tets[:, :4]].mean(axis=1)
    tets = mesh.tets[(centre[:, 0] > 0.0) & (centre[:, 1] > 0.0)]
    kept, tets = np.unique(tets, return_inverse=True)
    tets = tets.reshape(-1, 10)
    nodes = mesh.nodes[kept] - [0.0, 0.0, THICKNESS]
    number = np.full(len(mesh.nodes), -1)
    number[kept] = np.arange(len(kept))
    top = number[mesh.surface[mesh.face_sets["top"]]]
    top = top[(top >= 0).all(axis=1)]
    top = top[(nodes[top[:, :3]].mean(axis=1)[:, :2] > 0.0).all(axis=1)]
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
    state = State(0.0, everything, np.zeros_like(everything), system.initial_internals())
    for k in range(1, steps + 1):
        targets = everything.copy()
        targets[body, 2] = RADIUS - depth * k / steps
        state, _ = advance(system, state, targets, 1.0)
    force = -4.0 * float(system.static_gradient()[body, 2])
    hertz = 4.0 / 3.0 * MODULUS / (1.0 - nu**2) * np.sqrt(RADIUS) * depth**1.5
    return float(force / hertz)


def gel_cases() -> Iterator[Case]:
    """All comparisons of gels."""
    for nu, (_, reference) in LAYER.items():
        yield Case(
            f"sphere on a bonded layer, nu = {nu:g}", "force", "Hertz", reference, sphere_on_layer(nu, (9, 4)),
            FORCES, "quarter, 9 x 9 x 4 quadratic", SOURCE,
        )  # fmt: skip
