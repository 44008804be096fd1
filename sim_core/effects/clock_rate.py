"""Rate of a clock: a stream's clock runs too fast or too slow against that of the commanded poses.

    a reading stamped t shows the state at t - r t,    t: since the recording began

one rate r for force, one for all that is seen (clock skew: Mills, IEEE Trans. Communications 39, 1991).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.effects.base import EffectParameter, RecordingScales, Values
from sim_core.effects.hooks import Channel, ClockMap
from sim_core.effects.scopes import STREAMS
from sim_core.rigs import Rig, WrenchSensor


class ClockRate(ClockMap):
    """Streams whose clocks run apart."""

    name = "clock_rate"
    title = "a stream's clock runs apart"
    words = "The clock of the force sensor, or of what is seen, gains or loses against that of the robot."
    signature = "The residual of one stream is proportional to the rate of its readings, and grows in the recording."
    source = "Mills, IEEE Trans. Communications 39, 1991 (clock skew)"
    slot = "clock"
    follows = "session"
    passive = True
    scope = STREAMS
    twins = ("stream_delay", "command_lag")
    separated_by = "The same quick motion at the beginning and at the end of a long recording."
    parameters = (
        EffectParameter("wrench_rate", "-", -0.5, 0.5, (1e-3,), 0.0, False, 1e-2, "gain of the force sensor's clock"),
        EffectParameter("vision_rate", "-", -0.5, 0.5, (1e-3,), 0.0, False, 1e-2, "gain of the clock of what is seen"),
    )
    example = {"wrench_rate": 0.05, "vision_rate": -0.08}

    def variants(self, rig: Rig, scales: RecordingScales | None = None) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """One stream at a time, of those that the rig has."""
        felt = any(isinstance(s, WrenchSensor) for s in rig.sensors.values())
        seen = bool(rig.cameras) or any(not isinstance(s, WrenchSensor) for s in rig.sensors.values())
        apart = [name for name, there in (("wrench_rate", felt), ("vision_rate", seen)) if there]
        own = [p.fitted_to(scales) for p in self.parameters]
        return tuple({p.name: p.typical if p.name == name else (0.0,) for p in own} for name in apart)

    def shown_at(self, channel: Channel, values: Values) -> np.ndarray:
        rate = values["wrench_rate"] if channel.kind == "wrench" else values["vision_rate"]
        return np.asarray(channel.stamps - rate * (channel.stamps + channel.since))
