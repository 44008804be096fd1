"""Thickness of a sheet: it is thicker, or thinner, than the rig says.

    h' = (1 + a) h:    membrane E h, bending E h^3 / (12 (1 - nu^2)), mass rho h

so that bending tells it from a modulus (Timoshenko & Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed., eq. 3 and
chapter 13). Contact finds the surfaces half a thickness from the middle, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MaterialMap
from sim_core.effects.scopes import SHEETS


class SheetThickness(MaterialMap):
    """A sheet that is thicker than it is said to be."""

    name = "sheet_thickness"
    title = "the sheet is thicker"
    words = "The sheet is thicker, or thinner, than the rig says: it stretches, bends, weighs and touches accordingly."
    signature = "Bending forces are off by three times the share by which tensions and weight are."
    source = "Timoshenko & Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed., eq. 3"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("sheet_density", "sheet_orthotropy")
    separated_by = "A bend and a pull of the same sheet: a modulus changes both by the same share."
    parameters = (EffectParameter("excess", "-", -0.9, 5.0, (0.05,), 0.0, False, 0.1, "share by which it is thicker"),)
    example = {"excess": 0.1}

    def amend_material(self, material: Any, values: Values) -> Mapping[str, float]:
        return {"thickness_m": (1.0 + values["excess"]) * material.thickness_m}
