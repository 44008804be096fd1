"""Frame of a wrench sensor: it is mounted with a small turn and shift against the frame in which it is said to read.

    f' = R^T f,    m' = R^T (m - r x f),    R = exp phi

of force f and torque m about the origin of the nominal frame, with the shift r and the rotation vector phi of the
true frame in it (transport of a wrench: Murray, Li & Sastry, A Mathematical Introduction to Robotic Manipulation, 1994,
sec. 2.5).
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Channel, Linear
from sim_core.effects.scopes import WRENCH_SENSORS


class WrenchFrame(Linear):
    """A wrench sensor that is mounted askew."""

    name = "wrench_frame"
    title = "the force sensor is mounted askew"
    words = "The wrench sensor is turned and shifted by a constant amount against its nominal frame."
    signature = (
        "Loads lean to one side by the same angle whatever their size; torques are off by an arm times the force."
    )
    source = "Murray, Li & Sastry, A Mathematical Introduction to Robotic Manipulation, 1994, sec. 2.5"
    slot = "wrench sensor"
    follows = "sensor"
    passive = True
    scope = WRENCH_SENSORS
    twins = ("wrench_crosstalk", "tool_offset")
    separated_by = "A camera: a sensor that is turned leaves the motion of what it touches as it is."
    parameters = (
        *(EffectParameter(f"{a}_m", "m", -0.1, 0.1, (1e-3,), 0.0, False, 2e-3, f"shift along {a}") for a in "xyz"),
        *(EffectParameter(f"r{a}_deg", "deg", -45.0, 45.0, (1.0,), 0.0, False, 2.0, f"turn about {a}") for a in "xyz"),
    )
    example = {"x_m": 0.002, "y_m": -0.003, "z_m": 0.004, "rx_deg": 3.0, "ry_deg": -4.0, "rz_deg": 5.0}

    def matrix(self, channel: Channel, values: Values) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        x, y, z = (values[f"{a}_m"] for a in "xyz")
        turn = Rotation.from_rotvec([values[f"r{a}_deg"] for a in "xyz"], degrees=True).as_matrix().T
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.block([[turn, np.zeros((3, 3))], [-turn @ cross, turn]])
