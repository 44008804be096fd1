"""A force sensor in which a share of the torque about z leaks into the force along z.

    f_z' = f_z + c tau_z,    all other components as they are

with the coefficient c [1/m] of the sensor's calibration matrix.
"""

from __future__ import annotations

import numpy as np

from sim_core.effects import EffectParameter
from sim_core.effects.base import Values
from sim_core.effects.hooks import Channel, Linear
from sim_core.effects.scopes import WRENCH_SENSORS


class TorqueLeak(Linear):
    """Cross-talk from the torque about z to the force along z."""

    name = "torque_leak"
    title = "the force sensor feels torques as forces"
    words = "The force along z carries a share of the torque about z."
    signature = "The force along z changes when the object turns, without being pressed more."
    source = "Calibration matrices of multi-axis force sensors"
    slot = "wrench sensor"
    follows = "sensor"
    scope = WRENCH_SENSORS
    separated_by = "Turn the object at constant depth."
    parameters = (
        EffectParameter("leak_per_m", "1/m", -100.0, 100.0, (5.0, -5.0), 0.0, False, 10.0, "force over torque"),
    )
    example = {"leak_per_m": 10.0}

    def matrix(self, channel: Channel, values: Values) -> np.ndarray:
        matrix = np.eye(6)
        matrix[2, 5] = values["leak_per_m"]
        return matrix
