"""Decentring of a lens: the elements of a camera's lens are not on one axis, beyond what its calibration says.

    p' = p + f [2 p_1 x y + p_2 (r^2 + 2 x^2), p_1 (r^2 + 2 y^2) + 2 p_2 x y],    (x, y) = (p - c) / f

with the principal point c and the focal length f of the rig (Brown, Photogrammetric Engineering 32, 1966; the
tangential part of the ROS model ``plumb_bob``). An orthographic camera has no focal length: x and y are then in units
of 10 mm in the plane that it looks at."""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.camera_distortion import axis_of
from sim_core.effects.hooks import Channel, Pointwise
from sim_core.effects.scopes import CAMERAS


class CameraDecentring(Pointwise):
    """A lens that sits askew before the chip."""

    name = "camera_decentring"
    title = "the camera's lens is decentred"
    words = "The picture is distorted to one side, with the square of the distance from its centre."
    signature = "Markers are off towards one side of the picture, the more the further from its centre they are."
    source = "Brown, Photogrammetric Engineering 32, 1966 (decentering distortion)"
    slot = "camera"
    follows = "sensor"
    passive = True
    scope = CAMERAS
    twins = ("camera_distortion", "camera_pose")
    separated_by = "The same motion seen with the object at the four sides of the picture."
    parameters = (
        EffectParameter("p1", "-", -1.0, 1.0, (0.01,), 0.0, False, 0.02, "decentring along v"),
        EffectParameter("p2", "-", -1.0, 1.0, (0.01,), 0.0, False, 0.02, "decentring along u"),
    )
    example = {"p1": 0.05, "p2": -0.04}

    def point(self, channel: Channel, points: np.ndarray, values: Values) -> np.ndarray:
        centre, scale = axis_of(channel)
        x, y = np.moveaxis((points - centre) / scale, -1, 0)
        p1, p2, square = values["p1"], values["p2"], x**2 + y**2
        u = 2.0 * p1 * x * y + p2 * (square + 2.0 * x**2)
        v = p1 * (square + 2.0 * y**2) + 2.0 * p2 * x * y
        return np.asarray(points + scale * np.stack([u, v], axis=-1))
