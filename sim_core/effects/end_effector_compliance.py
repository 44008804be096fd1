"""Compliance of the end effector: it gives way under load although the pose reads as commanded.

displacement = c * force,    alike in all directions (:class:`sim_core.solve.unknowns.Compliant`)
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MechanicsMap
from sim_core.effects.scopes import END_EFFECTORS
from sim_core.rigs import Rig

if TYPE_CHECKING:
    from sim_core.scene.scene import Values as SceneValues


class EndEffectorCompliance(MechanicsMap):
    """A hand that yields to force."""

    name = "end_effector_compliance"
    title = "the end effector gives way"
    words = (
        "The hand is not where the robot says: mount, wrist or gripper yield in proportion to the force, by c "
        "metres a newton, which the reported pose does not show."
    )
    signature = "All forces rise more slowly with depth than simulated, whatever is touched."
    source = "Hooke's law of the mount"
    slot = "robot"
    follows = "robot"
    passive = True
    scope = END_EFFECTORS
    separated_by = "A press on something rigid, or of another object with the same robot."
    parameters = (
        EffectParameter("compliance_m_per_n", "m/N", 1e-8, 0.1, (1e-4, 2e-3), 0.0, True, 2.5, "displacement per force"),
    )
    example = {"compliance_m_per_n": 0.0002}

    def amend_values(self, rig: Rig, targets: tuple[str, ...], found: SceneValues, values: Values) -> None:
        if values["compliance_m_per_n"] > 0.0:
            for name in targets:
                found.compliance[name] = np.full(3, values["compliance_m_per_n"])
