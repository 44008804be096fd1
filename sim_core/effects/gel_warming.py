"""Warming of a gel: its stiffness changes from the start of a recording on, and settles.

f(t) = 1 + a (1 - exp(-t / tau))

a factor on the modulus: E grows with the absolute temperature, 0.3 % a kelvin (Treloar, The Physics of Rubber
Elasticity, 3rd ed., eq. 4.9), and the lamps and the chip below a gel warm it like a first-order system."""

from __future__ import annotations

import math

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import FieldMap
from sim_core.effects.scopes import GELS


def warmed(x: float, y: float, z: float, t: float, change: float, tau_s: float) -> float:
    """f."""
    return 1.0 - change * math.expm1(-t / tau_s)


class GelWarming(FieldMap):
    """A gel that warms up, or cools down, while it is used."""

    name = "gel_warming"
    title = "the gel warms up"
    words = "The stiffness of the gel changes in the course of a recording, as its temperature does, and settles."
    signature = "The same press is harder, or softer, from one time to the next, whatever was done in between."
    source = "Treloar, The Physics of Rubber Elasticity, 3rd ed., 1975, eq. 4.9"
    slot = "gel"
    follows = "session"
    scope = GELS
    twins = ("wrench_warm_up", "gel_relaxation")
    separated_by = "The same press every two minutes, with rests in air, and a thermometer."
    parameters = (
        EffectParameter("change", "-", -0.9, 5.0, (0.1, -0.1), 0.0, False, 0.1, "share by which it stiffens"),
        EffectParameter(
            "tau_s", "s", 0.01, 1e5, (10.0,), None, True, 1.5, "time constant of the warming", "duration_s", (0.3,)
        ),
    )
    parts = ("solid",)
    changes = True
    example = {"change": 0.3, "tau_s": 0.2}
    formula = Law(warmed, order=1)
