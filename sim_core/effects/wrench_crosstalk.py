"""Cross-talk of a wrench sensor: a load along one component is read in another one as well.

reading = (1 + C) truth,    C_ii = 0

with the coupling C between the six components (a calibration matrix with errors off its diagonal: Bicchi, Robotics and
Autonomous Systems 10, 1992). Errors on the diagonal are those of the gain.
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Channel, Linear
from sim_core.effects.scopes import WRENCH_SENSORS

COMPONENTS = ("fx", "fy", "fz", "tx", "ty", "tz")
ARM_M = 0.1
"""Length by which forces and torques of common sensors compare: their full scales are about 10 N to 1 N m."""


def _coupling(to: str, by: str) -> EffectParameter:
    """How much of the component ``by`` is read in the component ``to``."""
    unit, size = {"ff": ("-", 1.0), "tt": ("-", 1.0), "ft": ("1/m", 1.0 / ARM_M), "tf": ("m", ARM_M)}[to[0] + by[0]]
    words = f"share of {by} that is read as {to}"
    return EffectParameter(f"{to}_by_{by}", unit, -size, size, (0.02 * size,), 0.0, False, 0.02 * size, words)


class WrenchCrosstalk(Linear):
    """A wrench sensor whose components are not independent of each other."""

    name = "wrench_crosstalk"
    title = "the force sensor's components cross-talk"
    words = "A share of the load along each component of the wrench is read in the other components as well."
    signature = "The residual of one component of the wrench is proportional to the reading of another one."
    source = "Bicchi, Robotics and Autonomous Systems 10, 1992 (errors of the calibration matrix)"
    slot = "wrench sensor"
    follows = "sensor"
    passive = True
    scope = WRENCH_SENSORS
    twins = ("wrench_gain", "wrench_frame")
    separated_by = "Known weights that hang from the sensor in six directions."
    parameters = tuple(_coupling(to, by) for to in COMPONENTS for by in COMPONENTS if to != by)
    example = {p.name: 0.05 * p.upper for p in parameters}

    def matrix(self, channel: Channel, values: Values) -> np.ndarray:
        return np.array([[values.get(f"{to}_by_{by}", 1.0) for by in COMPONENTS] for to in COMPONENTS])
