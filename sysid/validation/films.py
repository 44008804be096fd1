"""Films that are drawn out and blown up, written as rigs that anybody can write.

Rubber (incompressible neo-Hookean, mu = E / 3) at the stretch s, nominal stress: uniaxial mu (s - s^-2), equibiaxial
mu (s - s^-5) (Treloar, The Physics of Rubber Elasticity, 3rd ed., eq. 5.4 and 5.9).

A film between two clamps at the distance L, held across so that it does not contract, is blown into a cylinder: an arc
of half angle a, stretched by s = a / sin(a) everywhere, whose tension T(s) per width is the pressure times the radius,

    p L / (2 sin(a)) = T(s),    T = h mu (s - s^-3)   or   T = h E / (1 - nu^2) (s^2 - 1) s / 2

for rubber and for the law of stiffer sheets, linear in Green strain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sysid.validation.case import FORCES, STATICS, Case

SIDE, THICKNESS, MODULUS, STRETCH = 0.02, 2e-5, 1.2e6, 5.0
TRELOAR = "Treloar, closed form"
ARC = "closed form of the arc"
STEPS = 16
ANGLES = {"neo_hookean": (2.4, 0.5), "st_venant_kirchhoff": (0.6, 0.3)}
"""Law: half angle of the arc [rad], and Poisson's ratio."""

Tension = Callable[[float], float]


def film(length: float, width: float, cells: tuple[int, int], law: str, nu: float, pattern: str) -> dict[str, Any]:
    """A film as a body of a rig."""
    shape = {"type": "rectangle", "length_m": length, "width_m": width, "cells": list(cells), "pattern": pattern}
    material = {"E_pa": MODULUS, "nu": nu, "thickness_m": THICKNESS, "density_kg_m3": 1000.0}
    return {"type": "sheet", "shape": shape, "material": material, "law": law}


def rig_of(name: str, body: dict[str, Any], **parts: Any) -> Rig:
    """A rig without weight whose steps are equilibria."""
    still = {"gravity_m_s2": [0.0, 0.0, 0.0], "solver": {"dt_s": 1.0, "inertia": False}}
    return parse_rig({"name": name, **still, "bodies": {"film": body}, **parts}, name)


def drawn_rig(biaxial: bool, pattern: str) -> Rig:
    """A square film of which one pair of sides is drawn apart, or both pairs; sides slide along their grips."""
    half, mounts = 0.5 * SIDE, ["along", "across"] if biaxial else ["along"]
    clamps: list[dict[str, Any]] = [
        {"body": "film", "region": {"x_m": [-half, -half]}, "axes": ["x"]},
        {"body": "film", "region": {"y_m": [-half, -half]}, "axes": ["y"]},
        {"body": "film", "region": {}, "axes": ["z"]},
        {"name": "grip", "body": "film", "region": {"x_m": [half, half]}, "axes": ["x"], "mount": "along"},
    ]
    if biaxial:
        clamps.append({"body": "film", "region": {"y_m": [half, half]}, "axes": ["y"], "mount": "across"})
    topics = {m: {"topics": {"target_pose": f"{m}/target", "current_pose": f"{m}/current"}} for m in mounts}
    sensors = {"force": {"type": "wrench", "on": "grip", "topic": "wrench"}}
    body = film(SIDE, SIDE, (4, 4), "neo_hookean", 0.5, pattern)
    return rig_of("drawn_film", body, clamps=clamps, end_effectors=topics, sensors=sensors)


def drawn(biaxial: bool, pattern: str) -> float:
    """Nominal stress over mu of a film at :data:`STRETCH`."""
    simulation = Simulation(build_scene(drawn_rig(biaxial, pattern)))
    for k in range(1, STEPS + 1):
        away = SIDE * (STRETCH - 1.0) * k / STEPS
        ways = {"along": np.array([away, 0.0, 0.0]), "across": np.array([0.0, away, 0.0])}
        simulation.step({m: (ways[m], Rotation.identity()) for m in simulation.scene.rig.end_effectors}, 1.0)
    force = -float(simulation.read()["force"][0])
    return force / (SIDE * THICKNESS * MODULUS / 3.0)


def tension(law: str) -> Tension:
    """Tension per width [N/m] by stretch, without contraction across."""
    if law == "neo_hookean":
        return lambda s: THICKNESS * MODULUS / 3.0 * (s - s**-3)
    return lambda s: THICKNESS * MODULUS / (1.0 - ANGLES[law][1] ** 2) * 0.5 * (s**2 - 1.0) * s


def blown(law: str, cells: int) -> tuple[float, float]:
    """Rise of the middle and tension at a clamp, over those of the arc."""
    (angle, nu), span = ANGLES[law], SIDE
    pull = tension(law)(angle / np.sin(angle))
    pressure, grip = 2.0 * np.sin(angle) * pull / span, span / cells
    half, end = 0.5 * span, 0.5 * span + grip
    clamps: list[dict[str, Any]] = [
        {"body": "film", "region": {"x_m": [-end, -half]}},
        {"name": "grip", "body": "film", "region": {"x_m": [half, end]}},
        {"body": "film", "region": {}, "axes": ["y"]},
    ]
    load: dict[str, Any] = {"name": "gas", "type": "pressure", "body": "film", "region": {"x_m": [-half, half]}}
    load |= {"pressure_pa": pressure, "times_s": [0.0, float(STEPS)], "values": [0.0, 1.0]}
    body = film(2.0 * end, 2.0 * grip, (cells + 2, 2), law, nu, "regular")
    sensors = {"force": {"type": "wrench", "on": "grip", "topic": "wrench"}}
    scene = build_scene(rig_of("blown_film", body, clamps=clamps, loads=[load], sensors=sensors))
    simulation = Simulation(scene)
    for _ in range(STEPS):
        simulation.step({}, 1.0)
    rise = half / np.sin(angle) * (1.0 - np.cos(angle))
    middle = np.abs(scene.bodies["film"].local[:, 0]) < 1e-9
    force = float(np.linalg.norm(simulation.read()["force"][[0, 2]])) / (2.0 * grip)
    return float(simulation.state.x[middle, 2].mean() / rise), force / pull


def film_cases() -> Iterator[Case]:
    """All comparisons of films."""
    for name, biaxial, reference in (
        ("uniaxial", False, STRETCH - STRETCH**-2),
        ("equibiaxial", True, STRETCH - STRETCH**-5),
    ):
        for pattern in ("regular", "irregular"):
            found = drawn(biaxial, pattern)
            yield Case(
                f"rubber film, {name}, stretch {STRETCH:g}", "nominal stress", "mu", reference, found, STATICS,
                f"{pattern} 4 x 4", TRELOAR,
            )  # fmt: skip
    for law, title in (("neo_hookean", "rubber film"), ("st_venant_kirchhoff", "sheet")):
        (*coarser, finest) = (blown(law, cells) for cells in (20, 40))
        angle = ANGLES[law][0]
        words = f"{title} blown into a cylinder, stretch {angle / np.sin(angle):.3g}"
        for k, (quantity, allowed) in enumerate((("rise of the middle", STATICS), ("tension at a clamp", FORCES))):
            yield Case(
                words, quantity, "that of the arc", 1.0, finest[k], allowed, "regular 40 x 2", ARC,
                tuple(run[k] for run in coarser) if quantity.startswith("rise") else (),
            )  # fmt: skip
