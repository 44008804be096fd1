"""Gain of a wrench sensor: each component is read too large or too small by a share of itself.

reading_i = (1 + a_i) truth_i

(a calibration matrix with errors on its diagonal: Bicchi, Robotics and Autonomous Systems 10, 1992).
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Channel, Linear
from sim_core.effects.scopes import WRENCH_SENSORS

COMPONENTS = tuple(f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz")


class WrenchGain(Linear):
    """A wrench sensor whose sensitivity is not that of its calibration."""

    name = "wrench_gain"
    title = "the force sensor's gain is off"
    words = "Each component of the wrench is read too large or too small by a constant share of itself."
    signature = "The residual of the wrench is proportional to the wrench itself, whatever the motion and its speed."
    source = "Bicchi, Robotics and Autonomous Systems 10, 1992 (errors of the calibration matrix)"
    slot = "wrench sensor"
    follows = "sensor"
    passive = True
    scope = WRENCH_SENSORS
    twins = ("wrench_crosstalk", "end_effector_compliance")
    separated_by = "A known weight that hangs from the sensor: all stiffnesses together look the same without one."
    parameters = tuple(
        EffectParameter(c, "-", -0.9, 9.0, (0.05,), 0.0, False, 0.05, f"share by which {c} is read too large")
        for c in COMPONENTS
    )
    example = {c: 0.1 + 0.02 * k for k, c in enumerate(COMPONENTS)}

    def matrix(self, channel: Channel, values: Values) -> np.ndarray:
        return np.diag([1.0 + values[c] for c in COMPONENTS])
