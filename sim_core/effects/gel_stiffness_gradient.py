"""Gradient of a gel's stiffness: it gets stiffer from one side to the other, or towards its bond.

f(X) = exp(g_x x + g_y y + g_z z)

a factor on the modulus at the place X of the gel at rest, in its own frame, 1 at the origin: of a cure from one side
(Kloxin et al., Advanced Materials 22, 2010), or a pressed mould.
"""

from __future__ import annotations

import math

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import FieldMap
from sim_core.effects.scopes import GELS

NAMES = ("x_per_m", "y_per_m", "z_per_m")


def exponential(x: float, y: float, z: float, t: float, x_per_m: float, y_per_m: float, z_per_m: float) -> float:
    """f."""
    return math.exp(x_per_m * x + y_per_m * y + z_per_m * z)


class GelStiffnessGradient(FieldMap):
    """A gel that is stiffer on one side."""

    name = "gel_stiffness_gradient"
    title = "the gel is stiffer on one side"
    words = "The stiffness of the gel grows from one side to the other, or through it, by a constant share a length."
    signature = "Presses in the middle lean to one side, and the same press is harder on one side of the sensor."
    source = "Kloxin et al., Advanced Materials 22, 2010 (gradients of cure)"
    slot = "gel"
    follows = "sensor"
    passive = True
    scope = GELS
    twins = ("gel_soft_spot", "tool_offset", "wrench_frame")
    separated_by = "The same tip pressed into both sides of the sensor."
    parameters = tuple(
        EffectParameter(n, "1/m", -1e4, 1e4, (20.0,), 0.0, False, 50.0, f"growth of the stiffness along {n[0]}")
        for n in NAMES
    )
    parts = ("solid",)
    example = {"x_per_m": 60.0, "y_per_m": -40.0, "z_per_m": 80.0}

    formula = Law(exponential, order=1)
