"""Warm-up of a wrench sensor: an offset that grows after it was switched on, and settles.

reading = truth + a (1 - exp(-t / tau)),    t: since the sensor began

(first-order response of strain gauges to self-heating: Window, Strain Gauge Technology, 2nd ed., 1992).
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Scale, Values
from sim_core.effects.hooks import Additive, Channel
from sim_core.effects.scopes import WRENCH_SENSORS

AMOUNTS = tuple(f"{kind}_{a}_{unit}" for kind, unit in (("force", "n"), ("torque", "nm")) for a in "xyz")


def _amount(name: str) -> EffectParameter:
    force = name.startswith("force")
    bound, unit = (100.0, "N") if force else (10.0, "N m")
    scale: Scale = "force_n" if force else "torque_nm"
    words = "offset in the end of the " + " along ".join(name.split("_")[:2])
    width = 5e-3 * bound
    return EffectParameter(name, unit, -bound, bound, (width,), 0.0, False, width, words, scale, (0.1,), 0.1)


class WrenchWarmUp(Additive):
    """A wrench sensor that warms up while it records."""

    name = "wrench_warm_up"
    title = "the force sensor warms up"
    words = "The offset of the force sensor grows from the start of its work and settles with a time constant."
    signature = "The residual of the wrench bends towards a constant in the course of the recording, also in air."
    source = "Window, Strain Gauge Technology, 2nd ed., 1992"
    slot = "wrench sensor"
    follows = "session"
    passive = True
    scope = WRENCH_SENSORS
    twins = ("wrench_offset", "gel_relaxation")
    separated_by = "Rests in air at the beginning, in the middle and at the end of a long recording."
    parameters = (
        *(_amount(name) for name in AMOUNTS),
        EffectParameter(
            "tau_s", "s", 0.01, 1e5, (10.0,), None, True, 1.5, "time constant of the warming", "duration_s", (0.3,)
        ),
    )
    example = {**dict.fromkeys(AMOUNTS[:3], 0.2), **dict.fromkeys(AMOUNTS[3:], 0.01), "tau_s": 0.15}

    def added(self, channel: Channel, values: Values) -> np.ndarray:
        share = -np.expm1(-(channel.stamps + channel.since) / values["tau_s"])
        return np.asarray(share[:, None] * np.array([values[name] for name in AMOUNTS]))
