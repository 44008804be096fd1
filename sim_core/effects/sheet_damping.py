"""Damping of a sheet, proportional to its mass and to its stiffness (Rayleigh).

    C = alpha M + beta K:    a vibration of angular frequency w is damped by the ratio alpha / (2 w) + beta w / 2

added to what the rig says (Clough & Penzien, Dynamics of Structures, 3rd ed., eq. 12-37).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MaterialMap
from sim_core.effects.scopes import SHEETS


class SheetDamping(MaterialMap):
    """A sheet that loses energy as it moves."""

    name = "sheet_damping"
    title = "the sheet is damped"
    words = "Motion of the sheet is braked in proportion to its speed, and to the rate at which it bends and stretches."
    signature = "The simulated sheet rings for longer than the real one, and overshoots where it is stopped."
    source = "Clough & Penzien, Dynamics of Structures, 3rd ed., eq. 12-37"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("air_drag", "viscoelastic_sheet")
    separated_by = "Free ringing at two free lengths: the frequency tells the parts, the amplitude tells air drag."
    parameters = (
        EffectParameter("mass_per_s", "1/s", 0.0, 1e3, (1.0,), 0.0, False, 3.0, "alpha"),
        EffectParameter("stiffness_s", "s", 0.0, 1.0, (1e-3,), 0.0, False, 5e-3, "beta"),
    )
    example = {"mass_per_s": 3.0, "stiffness_s": 0.01}

    def amend_material(self, material: Any, values: Values) -> Mapping[str, float]:
        return {
            "mass_damping_per_s": material.mass_damping_per_s + values["mass_per_s"],
            "stiffness_damping_s": material.stiffness_damping_s + values["stiffness_s"],
        }
