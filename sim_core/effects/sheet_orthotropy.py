"""Orthotropy of a sheet: it is stiffer along one direction (grain, warp, machine direction)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.effects.effect import Effect, EffectParameter
from sim_core.rigs import Rig, Sheet
from sim_core.scene.scene import Values


class SheetOrthotropy(Effect):
    """E_1 / E_2 = r at the angle phi from the sheet's x axis; the geometric mean stays E."""

    name = "sheet_orthotropy"
    title = "the sheet has a grain"
    slot = "sheet"
    words = (
        "The sheet is not equally stiff in all directions: its modulus along the grain and across it "
        "differ by the factor r, in stretching and in bending alike."
    )
    parameters = (
        EffectParameter("modulus_ratio", "-", 0.05, 20.0, (2.0, 0.5), 1.0, True, 0.7, "E_1 over E_2"),
        EffectParameter("grain_angle_rad", "rad", -1.6, 1.6, (0.0, 0.6), None, False, 0.8, "direction 1 against x"),
    )

    def applies(self, rig: Rig) -> bool:
        return any(isinstance(b, Sheet) for b in rig.bodies.values())

    def equivalents(self, given: Mapping[str, float]) -> tuple[Mapping[str, float], ...]:
        """Direction 2 called direction 1, and either direction turned round."""
        ratio, angle = given["modulus_ratio"], given["grain_angle_rad"]
        return (
            *({"modulus_ratio": 1.0 / ratio, "grain_angle_rad": angle + s * np.pi / 2} for s in (-1.0, 1.0)),
            *({"modulus_ratio": ratio, "grain_angle_rad": angle + s * np.pi} for s in (-1.0, 1.0)),
        )

    def amend_values(self, rig: Rig, values: Values, given: Mapping[str, float]) -> None:
        for name, body in rig.bodies.items():
            if isinstance(body, Sheet):
                for term in ("membrane", "bending"):
                    values.terms[f"{name}.{term}"].update(
                        anisotropy_ratio=given["modulus_ratio"], grain_angle_rad=given["grain_angle_rad"]
                    )
