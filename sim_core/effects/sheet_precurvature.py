"""Curvature of a sheet at rest: nothing strains it where it is curved, and it is flat only when it is held so.

    psi(kappa) = -kappa . D kappa_0:    M = D (kappa - kappa_0)

with the bending stiffness D and the curvatures kappa_0 at rest along x and y of the sheet, and its twist (Timoshenko &
Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed., sec. 14: a plate with initial curvature). Paper curls, and what
was rolled stays so. A curvature along x is positive where the ends of least and greatest x rise towards the sheet's z.
"""

from __future__ import annotations

from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import SHEETS

NAMES = ("x_per_m", "y_per_m", "twist_per_m")


def curled(e: Any, d: Any, x_per_m: float, y_per_m: float, twist_per_m: float) -> Any:
    """psi(kappa)."""
    moment = d @ e
    return -(moment[0] * x_per_m + moment[1] * y_per_m + moment[2] * 2.0 * twist_per_m)


class SheetPrecurvature(MaterialLaw):
    """A sheet that is curled."""

    name = "sheet_precurvature"
    title = "the sheet is curled"
    words = "The sheet is not flat at rest: it is curved, or twisted, alike all over, where nothing holds it."
    signature = "The sheet is off its place in the same direction all the time, also before anything touches it."
    source = "Timoshenko & Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed. (initial curvature)"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("gravity_direction", "sheet_density", "tool_offset")
    separated_by = "The same motion with the sheet turned over: what is curled changes its sign, weight does not."
    parameters = tuple(
        EffectParameter(n, "1/m", -1e3, 1e3, (0.5,), 0.0, False, 1.0, words)
        for n, words in zip(NAMES, ("curvature along x", "curvature along y", "twist"), strict=True)
    )
    parts = ("bending",)
    example = {"x_per_m": 0.4, "y_per_m": -0.3, "twist_per_m": 0.2}
    formula = MaterialFormula(curled)
