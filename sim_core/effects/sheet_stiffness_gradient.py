"""Gradient of a sheet's stiffness: it gets stiffer from one side to the other, in stretching and in bending.

f(X) = exp(g_x x + g_y y)

a factor on the stiffness at the place X of the flat sheet, 1 in its middle: the first mode of a stiffness field (Avril
et al., Experimental Mechanics 48, 2008, sec. 5)."""

from __future__ import annotations

import math

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import FieldMap
from sim_core.effects.scopes import SHEETS

NAMES = ("x_per_m", "y_per_m")


def exponential(x: float, y: float, z: float, t: float, x_per_m: float, y_per_m: float) -> float:
    """f."""
    return math.exp(x_per_m * x + y_per_m * y)


class SheetStiffnessGradient(FieldMap):
    """A sheet that is stiffer on one side."""

    name = "sheet_stiffness_gradient"
    title = "the sheet is stiffer on one side"
    words = "The stiffness of the sheet grows from one side to the other, by a constant share a length."
    signature = "Forces are too large on one side of the sheet and too small on the other."
    source = "Avril et al., Experimental Mechanics 48, 2008 (stiffness fields)"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("sheet_soft_spot", "gravity_direction", "sheet_orthotropy")
    separated_by = "The same motion with the sheet turned round by 180 degrees."
    parameters = tuple(
        EffectParameter(n, "1/m", -1e3, 1e3, (3.0,), 0.0, False, 5.0, f"growth of the stiffness along {n[0]}")
        for n in NAMES
    )
    parts = ("membrane", "bending")
    example = {"x_per_m": 8.0, "y_per_m": -15.0}

    formula = Law(exponential, order=1)
