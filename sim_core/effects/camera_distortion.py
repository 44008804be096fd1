"""Radial distortion of a camera beyond what its calibration says.

    p' = c + (1 + k_1 r^2 + k_2 r^4) (p - c),    r = |p - c| / f

with the principal point c and the focal length f of the rig (Brown, Photogrammetric Engineering 37, 1971, eq. 5, of the
picture that the calibration predicts). An orthographic camera has no focal length: r is then in units of 10 mm in the
plane that it looks at.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Channel, Pointwise
from sim_core.effects.scopes import CAMERAS
from sim_core.rigs import OrthographicCamera

UNIT_M = 0.01
"""Unit of r for orthographic cameras [m]."""


class CameraDistortion(Pointwise):
    """A lens whose picture bulges, or is pinched, towards its border."""

    name = "camera_distortion"
    title = "the camera's lens distorts"
    words = (
        "The picture is stretched or pinched in proportion to the square of the distance from its centre, by more than "
        "the camera's calibration says."
    )
    signature = "Markers are off along the radius from the centre of the picture, the more the further out they are."
    source = "Brown, Photogrammetric Engineering 37, 1971, eq. 5"
    slot = "camera"
    follows = "sensor"
    passive = True
    scope = CAMERAS
    separated_by = "The same motion seen with the object elsewhere in the picture."
    parameters = (
        EffectParameter("k1", "-", -1.0, 1.0, (0.02, -0.02), 0.0, False, 0.05, "share of the radius at r = 1"),
        EffectParameter("k2", "-", -1.0, 1.0, (0.0,), 0.0, False, 0.05, "share of the radius at r = 1, fourth power"),
    )
    example = {"k1": 0.1, "k2": -0.05}

    def point(self, channel: Channel, points: np.ndarray, values: Values) -> np.ndarray:
        centre, scale = axis_of(channel)
        away = points - centre
        square = (away**2).sum(axis=-1, keepdims=True) / scale**2
        return np.asarray(points + away * (values["k1"] * square + values["k2"] * square**2))


def axis_of(channel: Channel) -> tuple[np.ndarray, float]:
    """Principal point [px] ``(2,)`` and unit of the radius [px]."""
    camera: Any = channel.rig.cameras[channel.name]
    centre = np.array([camera.cx_px, camera.cy_px])
    if isinstance(camera, OrthographicCamera):
        return centre, UNIT_M / camera.scale_m_per_px
    return centre, float(np.sqrt(camera.fx_px * camera.fy_px))
