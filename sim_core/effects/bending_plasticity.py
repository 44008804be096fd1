"""Bending plasticity of a sheet: it keeps part of a bend that went beyond a yield curvature."""

from __future__ import annotations

import math
from collections.abc import Mapping

from sim_core.effects.effect import Effect, EffectParameter
from sim_core.rigs import Rig, Sheet
from sim_core.scene.scene import Values


class BendingPlasticity(Effect):
    """Elastic up to the yield curvature, linear hardening beyond (:mod:`sim_core.energies.plastic_flow`).

    Without hardening nothing would say where along a sheet it bends on, hence its lower bound.
    """

    name = "bending_plasticity"
    title = "the sheet keeps a bend"
    slot = "sheet"
    words = (
        "The sheet does not spring back fully: where it was bent beyond the yield curvature it keeps a "
        "permanent curvature, whatever the speed."
    )
    parameters = (
        EffectParameter(
            "yield_curvature_per_m", "1/m", 0.1, 1e4, (2.0, 5.0, 10.0, 20.0, 40.0), math.inf, True, 1.5,
            "curvature at which flow begins",
        ),
        EffectParameter(
            "hardening_ratio", "-", 0.01, 5.0, (0.2,), None, False, 0.5, "hardening over bending stiffness"
        ),
    )  # fmt: skip

    def applies(self, rig: Rig) -> bool:
        return any(isinstance(b, Sheet) for b in rig.bodies.values())

    def amend_values(self, rig: Rig, values: Values, given: Mapping[str, float]) -> None:
        for name, body in rig.bodies.items():
            if isinstance(body, Sheet):
                values.terms[f"{name}.bending"].update(given)
