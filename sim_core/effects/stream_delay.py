"""Time offset of a stream: its stamps lag or lead the clock of the commanded poses.

A reading stamped t shows the state at t - delay; one delay for force, one for all that is seen.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.effects.base import EffectParameter, Nuisance, RecordingScales, Values
from sim_core.effects.hooks import Channel, ClockMap
from sim_core.effects.scopes import STREAMS
from sim_core.rigs import Rig, WrenchSensor


class StreamDelay(ClockMap):
    """Streams that do not share a clock."""

    name = "stream_delay"
    title = "a stream is late"
    words = (
        "The streams do not share a clock: what the force sensor or the markers report at a stamp "
        "belongs to another moment of the motion."
    )
    signature = "The residual of one stream is proportional to the rate of its readings, whatever the motion."
    slot = "clock"
    follows = "session"
    passive = True
    scope = STREAMS
    twins = ("command_lag",)
    separated_by = "Compare the streams with one another: a lag of the robot delays all of them alike."
    parameters = (
        EffectParameter("wrench_s", "s", -2.0, 2.0, (0.01,), 0.0, False, 0.05, "delay of the force readings"),
        EffectParameter("vision_s", "s", -2.0, 2.0, (0.01,), 0.0, False, 0.05, "delay of markers and tracks"),
    )
    example = {"wrench_s": 0.03, "vision_s": 0.05}

    def variants(self, rig: Rig, scales: RecordingScales | None = None) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """One stream late at a time, of those that the rig has."""
        felt = any(isinstance(s, WrenchSensor) for s in rig.sensors.values())
        seen = bool(rig.cameras) or any(not isinstance(s, WrenchSensor) for s in rig.sensors.values())
        late = [name for name, there in (("wrench_s", felt), ("vision_s", seen)) if there]
        own = [p.fitted_to(scales) for p in self.parameters]
        return tuple({p.name: p.typical if p.name == name else (0.0,) for p in own} for name in late)

    def nuisances(self, rig: Rig) -> tuple[Nuisance, ...]:
        """The latency of each stream, in each recording by itself, since clocks are set anew between them."""
        found = []
        for name, source in (*rig.sensors.items(), *rig.cameras.items()):
            own = "wrench_s" if isinstance(source, WrenchSensor) else "vision_s"
            latency, sd = f"{name}.latency_s", source.latency_sd_s
            found.append(Nuisance("time", name, latency, sd, (own,), per_recording=True))
        return tuple(found)

    def shown_at(self, channel: Channel, values: Values) -> np.ndarray:
        return np.asarray(channel.stamps - (values["wrench_s"] if channel.kind == "wrench" else values["vision_s"]))
