"""Plates written as rigs that anybody can write: nearly incompressible ones under pressure, and one that is free.

Clamped square plate under a uniform pressure q: the centre sags by 0.00126532 q a^4 / D whatever Poisson's ratio
(:mod:`sysid.validation.plates`), here at nu = 0.5, where D = E h^3 / 9.

Free square plate, nu = 0.3: the slowest vibration is w = f(x) f(y) with both factors odd, at omega a^2 sqrt(rho h / D)
= 13.468198 (Ritz series of Legendre polynomials, eight digits; Leissa, Vibration of Plates, NASA SP-160, 1969, ch. 4.3,
has 13.489 from fewer terms). Both medians are at rest in it; they are what holds the plate here.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sim_core.rigs import Rig, parse_rig
from sim_core.scene import build_scene
from sim_core.stepping import Simulation
from sysid.validation.case import FREQUENCIES, STATICS, Case
from sysid.validation.plates import SAG, TIMOSHENKO
from sysid.validation.small_motions import natural_vibrations

SIDE, THICKNESS, MODULUS, DENSITY = 0.1, 5e-4, 1e9, 1000.0
FREE, FREE_NU = 13.468198, 0.3
RITZ = "Ritz series of Legendre polynomials; Leissa 1969"


def rigidity(nu: float) -> float:
    """Bending stiffness D [N m]."""
    return MODULUS * THICKNESS**3 / 12.0 / (1.0 - nu**2)


def plate_rig(side: float, cells: int, nu: float, pattern: str, **parts: Any) -> Rig:
    """A square plate without weight whose steps are equilibria."""
    shape = {"type": "rectangle", "length_m": side, "width_m": side, "cells": [cells, cells], "pattern": pattern}
    material = {"E_pa": MODULUS, "nu": nu, "thickness_m": THICKNESS, "density_kg_m3": DENSITY}
    plate = {"type": "sheet", "shape": shape, "material": material}
    still = {"gravity_m_s2": [0.0, 0.0, 0.0], "solver": {"dt_s": 1.0, "inertia": False}}
    return parse_rig({"name": "plate", **still, "bodies": {"plate": plate}, **parts}, "plate")


def pressed(nu: float, cells: int) -> float:
    """Centre deflection over q a^4 / D of a clamped plate under a small pressure."""
    whole = SIDE * (cells + 2) / cells
    near, far = 0.5 * SIDE, 0.5 * whole
    rims = [{k: v} for k in ("x_m", "y_m") for v in ([-far, -near], [near, far])]
    pressure = 1e-3 * THICKNESS * rigidity(nu) / SIDE**4 / SAG["clamped"]
    rig = plate_rig(
        whole, cells + 2, nu, "crossed",
        clamps=[{"body": "plate", "region": region} for region in rims],
        loads=[{"name": "gas", "type": "pressure", "body": "plate", "pressure_pa": pressure}],
    )  # fmt: skip
    x = Simulation(build_scene(rig)).state.x
    centre = int(np.argmin(np.linalg.norm(x[:, :2], axis=1)))
    return float(x[centre, 2] * rigidity(nu) / (pressure * SIDE**4))


def free_frequency(pattern: str, cells: int) -> float:
    """omega a^2 sqrt(rho h / D) of the slowest vibration of a plate whose medians do not move."""
    held = [{"region": {}, "axes": ["x", "y"]}, {"region": {"x_m": [0.0, 0.0]}, "axes": ["z"]}]
    held.append({"region": {"y_m": [0.0, 0.0]}, "axes": ["z"]})
    rig = plate_rig(SIDE, cells, FREE_NU, pattern, clamps=[{"body": "plate", **clamp} for clamp in held])
    scene = build_scene(rig)
    omega, _ = natural_vibrations(scene.system, 1)
    return float(omega[0] * SIDE**2 * np.sqrt(DENSITY * THICKNESS / rigidity(FREE_NU)))


def rig_plate_cases() -> Iterator[Case]:
    """All comparisons of plates of rigs."""
    *coarser, finest = (pressed(0.5, n) for n in (16, 32))
    yield Case(
        "square plate, clamped edges, nu = 0.5", "centre deflection", "q a^4/D", SAG["clamped"], finest, STATICS,
        "crossed 32 x 32", TIMOSHENKO, tuple(coarser),
    )  # fmt: skip
    for pattern in ("regular", "crossed"):
        *coarser, finest = (free_frequency(pattern, n) for n in (12, 24))
        yield Case(
            f"free plate, nu = {FREE_NU:g}", "frequency 1", "lambda", FREE, finest, FREQUENCIES,
            f"{pattern} 24 x 24", RITZ, tuple(coarser),
        )  # fmt: skip
