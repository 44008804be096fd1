"""Time offset of a stream: its stamps lag or lead the clock of the commanded poses."""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.effects.effect import Effect, EffectParameter
from sim_core.rigs import Rig, WrenchSensor


class StreamDelay(Effect):
    """A reading stamped t shows the state at t - delay; one delay for force, one for all that is seen."""

    name = "stream_delay"
    title = "a stream is late"
    slot = "clock"
    words = (
        "The streams do not share a clock: what the force sensor or the markers report at a stamp "
        "belongs to another moment of the motion."
    )
    parameters = (
        EffectParameter("wrench_s", "s", -2.0, 2.0, (0.01,), 0.0, False, 0.05, "delay of the force readings"),
        EffectParameter("vision_s", "s", -2.0, 2.0, (0.01,), 0.0, False, 0.05, "delay of markers and tracks"),
    )

    def applies(self, rig: Rig) -> bool:
        return bool(rig.sensors or rig.cameras)

    def variants(self, rig: Rig) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """One stream late at a time, of those that the rig has."""
        felt = any(isinstance(s, WrenchSensor) for s in rig.sensors.values())
        seen = bool(rig.cameras) or any(not isinstance(s, WrenchSensor) for s in rig.sensors.values())
        late = [name for name, there in (("wrench_s", felt), ("vision_s", seen)) if there]
        return tuple({p.name: p.typical if p.name == name else (0.0,) for p in self.parameters} for name in late)

    def delay(self, rig: Rig, channel: str, kind: str, given: Mapping[str, float]) -> float:
        return given["wrench_s"] if kind == "wrench" else given["vision_s"]
