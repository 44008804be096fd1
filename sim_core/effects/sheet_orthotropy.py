"""Orthotropy of a sheet: it is stiffer along one direction (grain, warp, machine direction).

E_1 / E_2 = r at the angle phi from the sheet's x axis; the geometric mean of the two stays E, and nu that of the mean
(:func:`sim_core.materials.elastic.plane_stress`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MechanicsMap
from sim_core.effects.scopes import SHEETS
from sim_core.rigs import Rig

if TYPE_CHECKING:
    from sim_core.scene.scene import Values as SceneValues


class SheetOrthotropy(MechanicsMap):
    """A sheet with a grain."""

    name = "sheet_orthotropy"
    title = "the sheet has a grain"
    words = (
        "The sheet is not equally stiff in all directions: its modulus along the grain and across it "
        "differ by the factor r, in stretching and in bending alike."
    )
    signature = "Pulled or bent along one direction the sheet is stiffer than simulated, across it softer."
    source = "Jones, Mechanics of Composite Materials, 2nd ed., eq. 2.61 (plane stress)"
    slot = "sheet"
    passive = True
    scope = SHEETS
    separated_by = "The same motion with the sheet turned by 90 degrees."
    parameters = (
        EffectParameter("modulus_ratio", "-", 0.05, 20.0, (2.0, 0.5), 1.0, True, 0.7, "E_1 over E_2"),
        EffectParameter("grain_angle_rad", "rad", -1.6, 1.6, (0.0, 0.6), None, False, 0.8, "direction 1 against x"),
    )
    example = {"modulus_ratio": 2.0, "grain_angle_rad": 0.4}

    def equivalents(self, values: Values) -> tuple[Values, ...]:
        """Direction 2 called direction 1, and either direction turned round."""
        ratio, angle = values["modulus_ratio"], values["grain_angle_rad"]
        return (
            *({"modulus_ratio": 1.0 / ratio, "grain_angle_rad": angle + s * np.pi / 2} for s in (-1.0, 1.0)),
            *({"modulus_ratio": ratio, "grain_angle_rad": angle + s * np.pi} for s in (-1.0, 1.0)),
        )

    def amend_values(self, rig: Rig, targets: tuple[str, ...], found: SceneValues, values: Values) -> None:
        for name in targets:
            for term in ("membrane", "bending"):
                found.terms[f"{name}.{term}"].update(
                    anisotropy_ratio=values["modulus_ratio"], grain_angle_rad=values["grain_angle_rad"]
                )
