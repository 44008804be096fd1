"""Compliance of the end effector: it gives way under load although the pose reads as commanded."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.effects.effect import Effect, EffectParameter
from sim_core.rigs import Rig
from sim_core.scene.scene import Values


class EndEffectorCompliance(Effect):
    """Displacement = c times force, alike in all directions (:class:`sim_core.solve.system.Compliant`)."""

    name = "end_effector_compliance"
    title = "the end effector gives way"
    slot = "robot"
    words = (
        "The hand is not where the robot says: mount, wrist or gripper yield in proportion to the force, by c "
        "metres a newton, which the reported pose does not show."
    )
    parameters = (
        EffectParameter("compliance_m_per_n", "m/N", 1e-8, 0.1, (1e-4, 2e-3), 0.0, True, 2.5, "displacement per force"),
    )

    def applies(self, rig: Rig) -> bool:
        return bool(rig.end_effectors)

    def amend_values(self, rig: Rig, values: Values, given: Mapping[str, float]) -> None:
        if given["compliance_m_per_n"] > 0.0:
            for name in rig.end_effectors:
                values.compliance[name] = np.full(3, given["compliance_m_per_n"])
