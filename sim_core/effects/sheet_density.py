"""Density of a sheet: it is heavier, or lighter, than the rig says.

rho' = (1 + a) rho

A coat of print, glue on a joint, or moisture: paper takes up some 5 % of its mass in room air, 10 % in damp air (Alava
& Niskanen, Rep. Prog. Phys. 69, 2006, sec. 7)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MaterialMap
from sim_core.effects.scopes import SHEETS


class SheetDensity(MaterialMap):
    """A sheet that is heavier than it is said to be."""

    name = "sheet_density"
    title = "the sheet is heavier"
    words = "The sheet weighs more, or less, than the rig says, by a share of its mass."
    signature = "The sheet droops too little where it hangs free, and lags too little in quick motion."
    source = "Alava & Niskanen, Rep. Prog. Phys. 69, 2006 (moisture in paper)"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("gravity_direction", "sheet_precurvature", "wrench_offset")
    separated_by = "The same motion with the sheet turned over: a weight does not turn with the sheet, a shape does."
    parameters = (EffectParameter("excess", "-", -0.95, 20.0, (0.1,), 0.0, False, 0.2, "share by which it is heavier"),)
    example = {"excess": 0.3}

    def amend_material(self, material: Any, values: Values) -> Mapping[str, float]:
        return {"density_kg_m3": (1.0 + values["excess"]) * material.density_kg_m3}
