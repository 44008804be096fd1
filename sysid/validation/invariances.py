"""What must not matter: the orientation of a scene, its units, a second run; and what must be conserved.

The scene has everything: a card, clamped at one end, that sags onto a bonded gel, with contact and friction.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.energies.term import Term
from sim_core.geometry.sheets import rectangle
from sim_core.rigs import parse_rig
from sim_core.scene import Scene, build_scene
from sim_core.solve.step import NewtonSettings, advance, potential
from sim_core.solve.system import System
from sim_core.stepping import Simulation
from sysid.validation.case import STATICS, Case
from sysid.validation.specimens import rest

LENGTH, G = 0.08, 9.81
TIGHT = NewtonSettings(step_tolerance_m=1e-11, force_tolerance=1e-9)
CONSERVED, SYMMETRY = "conservation", "invariance"
EXACT, SOLVED = 1e-10, 1e-5
"""Errors allowed of what holds to round-off, and of what holds as far as equilibrium is solved for."""


def card_on_gel(turn: Rotation) -> Scene:
    """The scene, turned as a whole."""

    def place(position: list[float]) -> dict[str, list[float]]:
        rpy = [float(a) for a in turn.as_euler("xyz", degrees=True)]
        return {"position_m": [float(c) for c in turn.apply(position)], "rpy_deg": rpy}

    gel = {"type": "block", "size_m": [0.03, 0.03, 0.008], "cells": [4, 4, 2]}
    card = {"type": "rectangle", "length_m": LENGTH, "width_m": 0.02, "cells": [12, 4], "pattern": "irregular"}
    return build_scene(
        parse_rig(
            {
                "name": "card_on_gel",
                "gravity_m_s2": [float(g) for g in turn.apply([0.0, 0.0, -G])],
                "solver": {"dt_s": 0.01},
                "bodies": {
                    "gel": {
                        "type": "gel",
                        "shape": gel,
                        "pose": place([0.02, 0.0, -0.008]),
                        "material": {"E_pa": 5e4, "nu": 0.45, "density_kg_m3": 1000.0},
                        "bonded": "bottom",
                        "mount": "world",
                    },
                    "card": {
                        "type": "sheet",
                        "shape": card,
                        "pose": place([0.0, 0.0, 0.0]),
                        "material": {"E_pa": 2e8, "nu": 0.3, "thickness_m": 2e-4, "density_kg_m3": 1000.0},
                    },
                },
                "clamps": [{"body": "card", "region": {"x_m": [-0.05, -0.03]}}],
                "contacts": [{"between": ["card", "gel"], "friction": 0.4}],
            },
            "validation",
        )
    )


def settled(turn: Rotation) -> tuple[Scene, Simulation]:
    """The scene at rest, the card on the gel."""
    scene = card_on_gel(turn)
    simulation = Simulation(scene, TIGHT)
    assert any(force.any() for force in simulation.contact_forces().values())
    return scene, simulation


def inner_forces(scene: Scene, simulation: Simulation) -> np.ndarray:
    """What terms exert on the nodes, dE/dx [N] ``(n, 3)``: reactions without the weight."""
    return np.asarray(scene.system.mass @ np.tile(scene.system.gravity, (len(scene.rest), 1)) - simulation.reactions())


def turned_scene() -> tuple[float, float, float]:
    """Departures between the scene at rest and its like in another orientation: positions over the card's length,
    stored energy, and force of the clamp, both relative."""
    turn = Rotation.random(random_state=21)
    found = []
    for r in (Rotation.identity(), turn):
        scene, simulation = settled(r)
        held = scene.bodies["card"].nodes[scene.held("card")]
        force = inner_forces(scene, simulation)[held].sum(axis=0)
        energy = potential(scene.system, simulation.state).energy
        found.append((r.inv().apply(simulation.state.x), energy, r.inv().apply(force)))
    (x, energy, force), (other_x, other_energy, other_force) = found
    return (
        float(np.abs(other_x - x).max() / LENGTH),
        float(other_energy / energy - 1.0),
        float(np.linalg.norm(other_force - force) / np.linalg.norm(force)),
    )


def balance() -> tuple[float, float, float]:
    """Of the scene at rest, over the weight of card and gel: what holds it less that weight; the sum of all internal
    forces, contact included; and the largest imbalance of a free node."""
    scene, simulation = settled(Rotation.identity())
    system = scene.system
    weight = float(system.mass.sum()) * G
    inner, gradient = inner_forces(scene, simulation), -simulation.reactions()
    held = gradient[system.prescribed.any(axis=1)].sum(axis=0)
    free = float(np.abs(gradient[~system.prescribed]).max())
    excess = float(np.linalg.norm(held - [0.0, 0.0, weight]))
    return excess / weight, float(np.abs(inner.sum(axis=0)).max()) / weight, free / weight


def repeated() -> float:
    """Largest difference [m] between two runs of the scene, driven by a change of gravity."""
    ends = []
    for _ in range(2):
        scene, simulation = settled(Rotation.identity())
        scene.system.gravity = np.array([2.0, 1.0, -12.0])
        simulation.refresh()
        for _ in range(5):
            simulation.step({}, 0.01)
        ends.append(np.concatenate([simulation.state.x.ravel(), simulation.state.v.ravel()]))
    return float(np.abs(ends[1] - ends[0]).max())


def free_card(
    scale: float, kilogram: float, second_order: bool = False, gravity: float = 0.0, held: bool = False
) -> System:
    """A card with lengths in units of 1/``scale`` m, masses in units of 1/``kilogram`` kg, times in s."""
    mesh = rectangle(0.06 * scale, 0.02 * scale, (9, 3), "irregular")
    axis = np.array([1.0, 0.0, 0.0])
    terms: list[Term] = [
        Membrane("membrane", mesh.nodes, mesh.triangles, axis),
        Bending("bending", mesh, 0, axis),
    ]
    pascal, thickness = kilogram / scale, 2e-4 * scale
    for term in terms:
        term.configure({"E_pa": 1e8 * pascal, "nu": 0.3, "thickness_m": thickness})
    mass = sp.diags(1000.0 * kilogram / scale**3 * thickness * mesh.node_areas).tocsr()
    prescribed = np.zeros((len(mesh.nodes), 3), dtype=bool)
    if held:
        prescribed[mesh.nodes[:, 0] < -0.02 * scale] = True
    return System(
        mesh.nodes, mass, prescribed, terms, np.array([0.0, 0.0, -gravity * scale]), inertia=not held,
        second_order=second_order,
    )  # fmt: skip


def units() -> float:
    """Largest difference between a sagging card in metres, kilograms and in millimetres, tonnes, over its length."""
    shapes = []
    for scale, kilogram in ((1.0, 1.0), (1e3, 1e-3)):
        system = free_card(scale, kilogram, gravity=G, held=True)
        settings = NewtonSettings(step_tolerance_m=1e-11 * scale)
        state, _ = advance(system, rest(system), system.nodes, 1.0, settings)
        shapes.append(state.x / scale)
    return float(np.abs(shapes[1] - shapes[0]).max() / 0.06)


def flight(second_order: bool, steps: int, bend: float = 0.0) -> tuple[float, float]:
    """Relative change of linear and angular momentum of a card that is thrown, spinning and bent by ``bend`` [1/m],
    in 0.1 s."""
    system = free_card(1.0, 1.0, second_order)
    spin, velocity = np.array([3.0, 8.0, 5.0]), np.array([0.4, -0.2, 0.7])
    state = rest(system)
    x = state.x + np.column_stack([0.0 * state.x[:, 0], 0.0 * state.x[:, 0], 0.5 * bend * state.x[:, 0] ** 2])
    masses = system.mass.diagonal()[:, None]

    def momenta(x: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        centre = (masses * x).sum(axis=0) / masses.sum()
        return (masses * v).sum(axis=0), (masses * np.cross(x - centre, v)).sum(axis=0)

    centre = (masses * x).sum(axis=0) / masses.sum()
    state = replace(state, x=x, v=velocity + np.cross(spin, x - centre))
    before = momenta(state.x, state.v)
    for _ in range(steps):
        state, _ = advance(system, state, system.nodes, 0.1 / steps, TIGHT)
    after = momenta(state.x, state.v)
    change = [float(np.linalg.norm(b - a) / np.linalg.norm(a)) for a, b in zip(before, after, strict=True)]
    return change[0], change[1]


def invariance_cases() -> Iterator[Case]:
    """All comparisons of what must not matter."""
    mesh = "irregular 12 x 4, gel 4 x 4 x 2"
    names = ("positions", "stored energy", "force of the clamp")
    for quantity, found in zip(names, turned_scene(), strict=True):
        name = "card on a gel, turned as a whole"
        yield Case(name, f"departure, {quantity}", "1", 0.0, found, SOLVED, mesh, SYMMETRY, scale=1.0)
    names = ("reactions less the weight", "sum of internal forces", "imbalance of a free node")
    for quantity, found in zip(names, balance(), strict=True):
        yield Case("card on a gel, at rest", quantity, "weight", 0.0, found, SOLVED, mesh, CONSERVED, scale=1.0)
    yield Case("card on a gel, run twice", "difference", "m", 0.0, repeated(), 0.0, mesh, SYMMETRY, scale=1.0)
    mesh = "irregular 9 x 3"
    name = "sagging card in m, kg and in mm, t"
    yield Case(name, "difference of shapes", "length", 0.0, units(), SOLVED, mesh, SYMMETRY, scale=1.0)
    for second_order in (False, True):
        name = f"card in free flight, {'BDF2' if second_order else 'implicit Euler'}"
        linear = flight(second_order, 200, bend=4.0)[0]
        yield Case(name, "change of momentum, vibrating", "1", 0.0, linear, EXACT, mesh, CONSERVED, scale=1.0)
        angular, coarser = (flight(second_order, steps)[1] for steps in (400, 200))
        yield Case(
            name, "change of angular momentum", "1", 0.0, angular, STATICS, mesh + ", 400 steps", CONSERVED, (coarser,),
            scale=1.0,
        )  # fmt: skip
