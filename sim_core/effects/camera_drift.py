"""Drift of a camera: its picture creeps and grows while it records.

    p' = c + (1 + z t) (p - c) + v t,    t: since the camera began

with the principal point c, the rate v of its shift and the rate z of its zoom: the optics move as the camera warms up
(Handel, Asian Conference on Computer Vision 2007).
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Channel, Pointwise
from sim_core.effects.scopes import CAMERAS

RATES = ("u_px_per_s", "v_px_per_s")


class CameraDrift(Pointwise):
    """A camera whose optics move while it warms up."""

    name = "camera_drift"
    title = "the camera's picture drifts"
    words = "The picture creeps in one direction, or grows, in proportion to time, whatever is in it."
    signature = "All tracks are off by nearly the same number of pixels, and by more and more in the course of time."
    source = "Handel, Asian Conference on Computer Vision 2007 (warm-up of cameras)"
    slot = "camera"
    follows = "session"
    passive = True
    scope = CAMERAS
    twins = ("camera_pose", "viscoelastic_sheet")
    separated_by = "A mark that stands still in the picture."
    parameters = (
        *(
            EffectParameter(name, "px/s", -1e3, 1e3, (1.0,), 0.0, False, 1.0, f"speed of the picture along {name[0]}")
            for name in RATES
        ),
        EffectParameter("zoom_per_s", "1/s", -1.0, 1.0, (1e-3,), 0.0, False, 1e-3, "rate of growth of the picture"),
    )
    example = {"u_px_per_s": 2.0, "v_px_per_s": -3.0, "zoom_per_s": 0.02}

    def point(self, channel: Channel, points: np.ndarray, values: Values) -> np.ndarray:
        camera = channel.rig.cameras[channel.name]
        centre = np.array([camera.cx_px, camera.cy_px])
        since = (channel.stamps + channel.since)[:, None, None]
        speed = np.array([values[name] for name in RATES])
        return np.asarray(points + since * (values["zoom_per_s"] * (points - centre) + speed))
