"""Swelling of a sheet: at rest it is longer, or shorter, than the rig says, in each of its directions.

    psi(e) = -e . D e_0:    N = D (e - e_0)

with the membrane stiffness D and the strains e_0 along x and y at which it bears no tension: of moisture or heat
(Timoshenko & Goodier, Theory of Elasticity, 3rd ed., eq. 239). Paper grows by 0.1 to 1 % across its grain as it gets
damp."""

from __future__ import annotations

from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import SHEETS


def swollen(e: Any, d: Any, strain_x: float, strain_y: float) -> Any:
    """psi(e)."""
    tension = d @ e
    return -(tension[0] * strain_x + tension[1] * strain_y)


class SheetSwelling(MaterialLaw):
    """A sheet that has grown, or shrunk."""

    name = "sheet_swelling"
    title = "the sheet has swollen"
    words = "The sheet is longer, or shorter, than it is said to be, along x and along y: of moisture, heat or wear."
    signature = "Tensions are off by a constant where the sheet is held at its edges, and it bulges or is drawn tight."
    source = "Timoshenko & Goodier, Theory of Elasticity, 3rd ed., chapter 13 (thermal strain)"
    slot = "sheet"
    follows = "session"
    passive = True
    scope = SHEETS
    twins = ("sheet_precurvature", "tool_offset")
    separated_by = "Points on the sheet where it hangs free: their distances grow by the same share everywhere."
    parameters = tuple(
        EffectParameter(f"strain_{a}", "-", -0.2, 0.5, (2e-3,), 0.0, False, 5e-3, f"strain at rest along {a}")
        for a in "xy"
    )
    parts = ("membrane",)
    example = {"strain_x": 0.004, "strain_y": -0.003}
    formula = MaterialFormula(swollen)
