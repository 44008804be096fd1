"""Bending plasticity of a sheet: it keeps part of a bend that went beyond a yield curvature.

Elastic up to the yield curvature, linear hardening beyond (:mod:`sim_core.energies.plastic_flow`). Without hardening
nothing would say where along a sheet it bends on, hence its lower bound.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MechanicsMap
from sim_core.effects.scopes import SHEETS
from sim_core.rigs import Rig

if TYPE_CHECKING:
    from sim_core.scene.scene import Values as SceneValues


class BendingPlasticity(MechanicsMap):
    """A sheet that yields in bending."""

    name = "bending_plasticity"
    title = "the sheet keeps a bend"
    words = (
        "The sheet does not spring back fully: where it was bent beyond the yield curvature it keeps a "
        "permanent curvature, whatever the speed."
    )
    signature = "After a strong bend the simulated sheet returns to a shape from which the real one stays away."
    source = "Ortiz & Stainier, Comput. Methods Appl. Mech. Eng. 171, 1999; linear hardening in moment and curvature"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("viscoelastic_sheet",)
    separated_by = "A bend that is held for long and one that is not: what yields keeps the same curvature in both."
    parameters = (
        EffectParameter(
            "yield_curvature_per_m", "1/m", 0.1, 1e4, (2.0, 5.0, 10.0, 20.0, 40.0), math.inf, True, 1.5,
            "curvature at which flow begins",
        ),
        EffectParameter(
            "hardening_ratio", "-", 0.01, 5.0, (0.2,), None, False, 0.5, "hardening over bending stiffness"
        ),
    )  # fmt: skip
    lasting = ("plastic_curvature", "accumulated_curvature")
    example = {"yield_curvature_per_m": 1.0, "hardening_ratio": 0.2}

    def amend_values(self, rig: Rig, targets: tuple[str, ...], found: SceneValues, values: Values) -> None:
        for name in targets:
            found.terms[f"{name}.bending"].update(values)
