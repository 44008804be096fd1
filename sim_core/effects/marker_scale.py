"""Scale of a marker sensor: lengths are read too large or too small by a constant share along each axis.

reading_i = (1 + s_i) truth_i

of positions in the sensor's frame: the conversion from pixels to metres that such sensors are calibrated with (Yuan,
Dong & Adelson, Sensors 17, 2017, sec. 3), refraction in the gel included.
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Channel, Linear
from sim_core.effects.scopes import MARKER_SENSORS

NAMES = ("scale_x", "scale_y", "scale_z")


class MarkerScale(Linear):
    """A marker sensor whose scale is off."""

    name = "marker_scale"
    title = "the marker sensor's scale is off"
    words = "Positions of markers are read too large or too small by a constant share along each axis of the sensor."
    signature = "All motion of markers is too large or too small by the same share, at rest the pattern is so, too."
    source = "Yuan, Dong & Adelson, Sensors 17, 2017, sec. 3 (calibration of GelSight)"
    slot = "markers"
    follows = "sensor"
    passive = True
    scope = MARKER_SENSORS
    twins = ("gel_relaxation", "wrench_gain")
    separated_by = "The pattern of markers at rest, whose size is known."
    parameters = tuple(
        EffectParameter(n, "-", -0.5, 1.0, (0.02,), 0.0, False, 0.03, f"share by which {n[-1]} is read too large")
        for n in NAMES
    )
    example = {"scale_x": 0.03, "scale_y": 0.02, "scale_z": -0.05}

    def matrix(self, channel: Channel, values: Values) -> np.ndarray:
        return np.diag([1.0 + values[n] for n in NAMES])
