"""A strip pressed end-on against a rough plane: when does its tip slip?

A strip is clamped normal to a plane, tip on the plane right under the clamp, and the clamp is lowered by eps L. While
the tip sticks, geometry alone sets the ratio of its tangential force to the normal one, B theta'' = -N sin(theta) -
T cos(theta), theta(0) = theta'(L) = 0, no offset of the tip; it slips where T / N = mu. Beyond mu = 0.3564 it never
does: it lies down first. Sano, Yamaguchi & Wada, Phys. Rev. Lett. 118, 2017; Romero et al., ACM Trans. Graph. 40(4),
2021. Solutions: :mod:`sysid.validation.planar_elastica`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sim_core.contact.rigid import RigidContact
from sim_core.contact.samples import sheet_samples
from sim_core.contact.shapes import HALF_SPACE
from sim_core.solve.step import State, advance, contact_force
from sim_core.solve.system import System
from sysid.validation import planar_elastica
from sysid.validation.case import FORCES, THRESHOLDS, Case, compare
from sysid.validation.specimens import MESHES, Strip, described, rest, strip

STICKING = (0.05, 0.1, 0.2, 0.3)
"""Lowerings over the length, while the tip sticks."""

ONSET = {0.1: 0.0468742, 0.15: 0.0969046, 0.2: 0.1548674, 0.25: 0.2144636, 0.3: 0.2715634, 0.35: 0.3239935}
"""mu: lowering over the length at which the tip slips."""

STRIP = {"E_pa": 1e9, "nu": 0.0, "thickness_m": 2e-4}
LENGTH, WIDTH = 0.2, 0.02
STIFFNESS = STRIP["E_pa"] * WIDTH * STRIP["thickness_m"] ** 3 / 12.0
CONTACT = {"stiffness_pa_per_m": 1e9, "range_m": 2e-5}
SOURCE = "Sano et al. 2017, boundary value problem"


@dataclass
class Pressed:
    """A strip from its clamp at x = 0 to the plane at its tip, which faces it."""

    system: System
    contact: RigidContact
    held: np.ndarray
    push: np.ndarray
    state: State

    def lower(self, eps: float) -> State:
        """Equilibrium with the clamp lowered by eps L, from where the strip is; it stays there."""
        targets = self.system.nodes.copy()
        targets[self.held, 0] += eps * LENGTH
        state, _ = advance(self.system, self.state, targets, 1.0)
        return state

    def forces(self) -> tuple[float, float]:
        """N and T on the tip, times L^2 / B, at the last equilibrium."""
        force = contact_force(self.system, self.contact.name)[:-1].sum(axis=0) * LENGTH**2 / STIFFNESS
        return float(-force[0]), float(abs(force[2]))


def slips(state: State) -> bool:
    """Whether all points that touch slid in the last step."""
    contact = state.internals["contact"]
    return bool((contact["slip_speed"][contact["load"] > 0.0] > 0.0).all())


def pressed_strip(mu: float, pattern: str, cells: tuple[int, int]) -> Pressed:
    """The strip, just buckled: a light push at the middle shows the way out and is taken off."""
    free: Strip = strip(LENGTH, WIDTH, STRIP, cells, pattern)
    count = len(free.mesh.nodes)
    thickness = STRIP["thickness_m"]
    origin = np.array([LENGTH + 0.5 * thickness + CONTACT["range_m"], 0.0, 0.0])
    facing = np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    contact = RigidContact(
        "contact",
        sheet_samples(free.mesh, 0, thickness),
        count,
        np.array([HALF_SPACE, 0, 0, 0, 0], dtype=float),
        facing,
    )
    contact.configure({**CONTACT, "friction": mu})
    system = System(
        np.vstack([free.mesh.nodes, origin]),
        sp.block_diag([free.system.mass, sp.csr_matrix((1, 1))]).tocsr(),
        np.vstack([free.system.prescribed, np.ones((1, 3), dtype=bool)]),
        [*free.system.terms, contact],
        np.zeros(3),
        inertia=False,
    )
    push = np.append(free.middle() / np.count_nonzero(free.middle()), 0.0)
    made = Pressed(system, contact, np.append(free.ends[0], False), push, rest(system))
    for eps in (2e-5, 4e-5):
        made.state = made.lower(eps)
    for share in (0.02, 0.05, 0.0):
        system.loads[:, 2] = share * STIFFNESS / LENGTH**2 * push
        made.state = made.lower(2e-3)
    return made


def sticking(pattern: str, cells: tuple[int, int]) -> list[tuple[float, float]]:
    """N and T at the lowerings of :data:`STICKING`, on a plane too rough to slip on."""
    made, found, before = pressed_strip(0.8, pattern, cells), [], 2e-3
    for eps in STICKING:
        for part in np.linspace(before, eps, 2 + round(50 * (eps - before)))[1:]:
            made.state = made.lower(float(part))
        found.append(made.forces())
        before = eps
    return found


def onset(mu: float, pattern: str, cells: tuple[int, int], parts: int = 60) -> float:
    """Lowering over the length at which the tip slips, to 0.5 %: the step that slips is halved, again and again."""
    made = pressed_strip(mu, pattern, cells)
    eps, step = 2e-3, 0.35 / parts
    while step > 0.005 * eps and eps < 0.4:
        state = made.lower(eps + step)
        if slips(state):
            step *= 0.5
        else:
            made.state, eps = state, eps + step
    return eps


def rough_plane_cases() -> Iterator[Case]:
    """All comparisons of a strip on a rough plane."""
    for pattern in ("regular", "irregular"):
        runs = zip(*(sticking(pattern, cells) for cells in MESHES), strict=True)
        for eps, found in zip(STICKING, runs, strict=True):
            yield from compare(
                f"strip on a rough plane, lowered by {eps:g} L", ("normal force", "tangential force"),
                planar_elastica.pressed(eps), found, FORCES, described(pattern, MESHES), SOURCE, unit="B/L^2",
            )  # fmt: skip
    for pattern in ("regular", "irregular"):
        for mu, answer in ONSET.items():
            yield Case(
                f"strip on a rough plane, mu = {mu:g}", "lowering at slip", "L", answer, onset(mu, pattern, (40, 4)),
                THRESHOLDS, f"{pattern} 40 x 4", SOURCE,
            )  # fmt: skip
