"""Direction of gravity: the base of the robot, in whose frame the rig has gravity, does not stand level.

    g' = exp(a) g,    a = (a_x, a_y, 0)

with a rotation vector a about the horizontal axes of the base frame (z up, REP 103); the size of gravity stays.
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import RigMap
from sim_core.effects.scopes import Scope
from sim_core.rigs import Rig


def weight(rig: Rig) -> tuple[str, ...]:
    """Gravity, where it acts on anything."""
    heavy = any(body.type != "rigid" for body in rig.bodies.values())
    return ("gravity",) if any(rig.gravity_m_s2) and heavy else ()


class GravityDirection(RigMap):
    """A base that does not stand level."""

    name = "gravity_direction"
    title = "the base does not stand level"
    words = "Gravity does not point down in the robot's base frame: the base is tilted about its horizontal axes."
    signature = "Sheets droop sideways, and loads change when the same motion is made in another direction."
    source = "REP 103 (axes); rotation vector of SO(3)"
    slot = "robot"
    follows = "robot"
    passive = True
    scope = Scope("gravity, and a body that it acts on", weight)
    twins = ("wrench_offset",)
    separated_by = "The same motion with the hand turned by 180 degrees about the vertical."
    parameters = tuple(
        EffectParameter(f"tilt_{a}_rad", "rad", -0.5, 0.5, (0.03,), 0.0, False, 0.03, f"tilt about {a}") for a in "xy"
    )
    example = {"tilt_x_rad": 0.05, "tilt_y_rad": -0.1}

    def amend_rig(self, rig: Rig, targets: tuple[str, ...], values: Values) -> Rig:
        if self.vanishes(values):
            return rig
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_rotvec([values["tilt_x_rad"], values["tilt_y_rad"], 0.0])
        turned = turn.apply(np.asarray(rig.gravity_m_s2))
        return rig.model_copy(update={"gravity_m_s2": tuple(float(g) for g in turned)})
