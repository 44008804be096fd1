"""A flat circular membrane, held at its rim, that a uniform pressure blows into a dome (Hencky 1915).

With e = q a / (E h) small, the deflection w = a e^(1/3) W and the tensions E h e^(2/3) (s, t), radial and around, of a
film without bending stiffness, functions of r / a = x (Hencky, Z. Math. Phys. 63, 1915; Fichter, NASA TP-3658, 1997):

    s W' = -x / 2,    t = (x s)',    x (s + t)' = -W'^2 / 2    or    8 s^2 (s'' + 3 s' / x) = -1

equilibrium across and along the film, and compatibility of the strains. So s is a series of even powers of x whose
first coefficient the rim sets, s' + (1 - nu) s = 0 at x = 1, where the film does not move. The series is summed here
(at nu = 0.3: W(0) = 0.6534, s(0) = 0.4311). What the theory leaves out, that the pressure follows the film and
that slopes are not small, is of the order of e^(2/3), here 7e-4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.simulate import Simulation
from sysid.validation.case import STATICS, Case, compare

RADIUS, THICKNESS, MODULUS, LOAD = 0.05, 2e-6, 3e9, 2e-5
"""Radius and thickness [m] and modulus [Pa] of a film of polyester, and q a / (E h): it rises by 0.9 mm."""

STEPS, TERMS = 8, 60
HENCKY = "Hencky 1915, series"


@dataclass(frozen=True)
class Dome:
    """W at the centre, and s at the centre and at the rim."""

    rise: float
    centre: float
    rim: float


def series(first: float) -> np.ndarray:
    """Coefficients of s by powers of x^2, given the first ``(TERMS,)``.

    (k + 1)(k + 2) 4 s_(k+1) is the coefficient of x^2k in s'' + 3 s' / x = -1 / (8 s^2); that of 1 / s^2 follows from
    s^2 (1 / s^2) = 1.
    """
    s, square, inverse = np.zeros(TERMS), np.zeros(TERMS), np.zeros(TERMS)
    s[0] = first
    for k in range(TERMS - 1):
        square[k] = s[: k + 1] @ s[k::-1]
        inverse[k] = (float(k == 0) - square[1 : k + 1] @ inverse[:k][::-1]) / square[0]
        s[k + 1] = -inverse[k] / (32.0 * (k + 1) * (k + 2))
    return s


def hencky(nu: float) -> Dome:
    """The dome of a film with Poisson's ratio ``nu``."""
    powers = 2.0 * np.arange(TERMS)

    def slip(first: float) -> float:
        return float(series(first) @ (powers + 1.0 - nu))

    first = brentq(slip, 0.25, 1.0, xtol=1e-14)
    s = series(first)
    x, weights = np.polynomial.legendre.leggauss(60)
    x, weights = 0.5 * (x + 1.0), 0.5 * weights
    rise = float(weights @ (0.5 * x / np.polynomial.polynomial.polyval(x**2, s)))
    return Dome(rise, float(first), float(s.sum()))


def dome_rig(nu: float, sides: int) -> Rig:
    """The film, its rim a polygon of ``sides``, each as long as its cells and each corner a pin."""
    angle = 2.0 * np.pi * np.arange(sides) / sides
    corners = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    edge = float(np.linalg.norm(corners[1] - corners[0]))
    pins: list[dict[str, Any]] = []
    for k, (x, y) in enumerate(corners.tolist()):
        near = {"x_m": [x - 0.1 * edge, x + 0.1 * edge], "y_m": [y - 0.1 * edge, y + 0.1 * edge]}
        pins.append({"name": f"pin_{k}", "body": "film", "region": near, "axes": ["x", "y", "z"]})
    film = {
        "type": "sheet",
        "shape": {"type": "outline", "polygon_m": corners.tolist(), "edge_m": edge},
        "material": {"E_pa": MODULUS, "nu": nu, "thickness_m": THICKNESS, "density_kg_m3": 1390.0},
    }
    gas = {
        "name": "gas",
        "type": "pressure",
        "body": "film",
        "pressure_pa": LOAD * MODULUS * THICKNESS / RADIUS,
        "times_s": [0.0, float(STEPS)],
        "values": [0.0, 1.0],
    }
    return parse_rig(
        {
            "name": "blown_dome",
            "gravity_m_s2": [0.0, 0.0, 0.0],
            "solver": {"dt_s": 1.0, "inertia": False},
            "bodies": {"film": film},
            "clamps": pins,
            "loads": [gas],
            "sensors": {f"on_{k}": {"type": "wrench", "on": f"pin_{k}", "topic": f"pin_{k}"} for k in range(sides)},
        },
        "blown_dome",
    )


def dome(nu: float, sides: int) -> tuple[float, float]:
    """W at the centre, and s at the rim: the mean pull of the film inwards on its pins."""
    scene = build_scene(dome_rig(nu, sides))
    simulation = Simulation(scene)
    for _ in range(STEPS):
        simulation.step({}, 1.0)
    film = scene.bodies["film"]
    near = np.argsort(np.linalg.norm(film.local[:, :2], axis=1))[:6]
    # A parabola through the nodes nearest to the centre.
    xy, z = film.local[near, :2], simulation.state.x[film.nodes[near], 2]
    top = np.linalg.lstsq(np.column_stack([np.ones(6), (xy**2).sum(axis=1)]), z, rcond=None)[0][0]
    angle = 2.0 * np.pi * np.arange(sides) / sides
    outward = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    read = simulation.read()
    pull = -sum(float(read[f"on_{k}"][:2] @ outward[k]) for k in range(sides))
    unit = 2.0 * np.pi * RADIUS * MODULUS * THICKNESS * LOAD ** (2 / 3)
    return float(top / (RADIUS * LOAD ** (1 / 3))), pull / unit


def hencky_cases() -> Iterator[Case]:
    """All comparisons of domes."""
    for nu in (0.3, 0.45):
        exact = hencky(nu)
        yield from compare(
            f"circular membrane under pressure, nu = {nu:g}", ("rise of the centre", "tension at the rim"),
            (exact.rise, exact.rim), [dome(nu, sides) for sides in (24, 48, 96)], STATICS,
            "irregular, 96 along the rim", HENCKY,
        )  # fmt: skip
