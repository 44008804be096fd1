"""Stress relaxation of a gel: part of its stress fades while it is held.

A share g of the deviatoric stress of the gel's own law (:mod:`sim_core.energies.neo_hookean`), of which E and nu are
the instantaneous moduli, fades with the time constant tau: F(t) / F(0) = 1 - g (1 - exp(-t / tau)) when held (Simo,
Comput. Methods Appl. Mech. Eng. 60, 1987). In a step from the strain E_0 and the relaxing stress Q, with

    a = exp(-dt/tau),   b = (1 - a) tau/dt,   H = a Q - b g S(E_0),   S = dW/dE

of the distortional energy W, the law adds -(1 - b) g W(E) + H : E, and leaves Q' = H + b g S(E). This b is exact for a
stress that changes linearly during the step, at any dt/tau (Simo's midpoint value exp(-dt/2tau) is 15 % low at dt =
2 tau). With C = 1 + A, A = 2 E, J^2 = det C,

    W / mu = tr A / 2 - (J - 1) + (J - 1)^2 / 6,   S / mu = 1 - (1 - (J - 1) / 3) cof C / J

in which what cancels at small strains is taken out: J^2 - 1 = tr A + tr cof A + det A. Several branches are several
instances.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sim_core.core.jets import Vector
from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import GELS

CRUSHED = 0.1
"""J below which the stress that is kept grows no further."""

FLAT = 1e-12
"""Least J^2, for searches on their way through states without volume."""


def relaxing(e: Any, e_0: Any, d: Any, stress: Any, dt: float, share: float, tau_s: float) -> Any:
    """The incremental energy, and Q'."""
    ratio = dt / tau_s
    a, b = math.exp(-ratio), -math.expm1(-ratio) / ratio
    fresh = b * share * d[3, 3]
    memory = a * stress - fresh * deviatoric(e_0)
    return (b - 1.0) * share * d[3, 3] * distortion(e) + memory.dot(e), memory + fresh * deviatoric(e)


def distortion(e: Any) -> Any:
    """W / mu."""
    a, b, c, f, g, h = 2.0 * e[0], 2.0 * e[1], 2.0 * e[2], e[3], e[4], e[5]
    trace = a + b + c
    beyond = a * b + b * c + c * a - f * f - g * g - h * h + determinant(e)
    j = math.sqrt(max(1.0 + trace + beyond, FLAT))
    swelling = (trace + beyond) / (1.0 + j)
    return (0.5 * trace * swelling - beyond) / (1.0 + j) + swelling * swelling / 6.0


def deviatoric(e: Any) -> Any:
    """S / mu."""
    a, b, c, f, g, h = 2.0 * e[0], 2.0 * e[1], 2.0 * e[2], e[3], e[4], e[5]
    trace = a + b + c
    beyond = a * b + b * c + c * a - f * f - g * g - h * h + determinant(e)
    j = math.sqrt(max(1.0 + trace + beyond, FLAT))
    swelling = (trace + beyond) / (1.0 + j)
    by, even = swelling / 3.0 - 1.0, 4.0 / 3.0 * swelling
    first, second, third = b + c + b * c - f * f, c + a + c * a - g * g, a + b + a * b - h * h
    whole = Vector(
        [
            even + by * first,
            even + by * second,
            even + by * third,
            by * (g * h - a * f - f),
            by * (h * f - b * g - g),
            by * (f * g - c * h - h),
        ]
    )
    return whole / max(j, CRUSHED)


def determinant(e: Any) -> Any:
    """det A."""
    a, b, c, f, g, h = 2.0 * e[0], 2.0 * e[1], 2.0 * e[2], e[3], e[4], e[5]
    return a * (b * c - f * f) + 2.0 * f * g * h - b * g * g - c * h * h


class GelRelaxation(MaterialLaw):
    """A share of the stress of a gel that fades with a time constant."""

    name = "gel_relaxation"
    title = "the gel relaxes"
    words = (
        "The gel's stress fades while it is held deformed: a share g of its shear stress decays with the "
        "time constant tau (a Maxwell element parallel to the spring)."
    )
    signature = (
        "In a hold the measured force goes on falling, and in fast presses the gel is stiffer than in slow ones."
    )
    source = "Simo, Comput. Methods Appl. Mech. Eng. 60, 1987; Simo & Hughes, Computational Inelasticity, box 10.4"
    slot = "gel"
    follows = "sensor"
    passive = True
    scope = GELS
    twins = ("wrench_offset",)
    separated_by = "A press that is held, released and held again in air: a drift of the sensor goes on in air."
    parameters = (
        EffectParameter("share", "-", 0.0, 0.95, (0.25,), 0.0, False, 0.3, "share of the shear stress that fades"),
        EffectParameter(
            "tau_s", "s", 0.01, 100.0, (0.05, 0.25, 1.0), None, True, 2.0, "time constant", "duration_s",
            (0.01, 0.05, 0.25),
        ),
    )  # fmt: skip
    share_of_one = "share"
    parts = ("solid",)
    example = {"share": 0.3, "tau_s": 0.2}
    formula = MaterialFormula(relaxing)

    def state(self) -> Mapping[str, tuple[int, ...]]:
        return {"stress": (6,)}
