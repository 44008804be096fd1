"""From a trace of the simulator to what the sensors of a rig would put on their topics."""

from __future__ import annotations

import numpy as np

from sim_core.effects import active_effects
from sim_core.rigs import Rig
from sim_core.simulate import Trace, interpolate


def predicted(trace: Trace, rig: Rig, channel: str, stamps: np.ndarray, since: float = 0.0) -> np.ndarray:
    """Readings of a channel at stamps [s], with latency and the sensor effects of the rig: ``(k, ...)``. ``since``: how
    long [s] the sensors have been at work when the trace begins."""
    kind = trace.kinds[channel]
    out = interpolate(trace.times, trace.outputs[channel], stamps - total_delay(rig, channel, kind))
    for effect, given in active_effects(rig):
        out = effect.amend_output(rig, channel, kind, stamps + since, out, given)
    return out


def predicted_derivatives(
    trace: Trace, derivatives: np.ndarray, rig: Rig, channel: str, stamps: np.ndarray
) -> np.ndarray:
    """Derivatives ``(n_times, ..., p)`` of a channel carried to the stamps: ``(k, ..., p)``."""
    return interpolate(trace.times, derivatives, stamps - total_delay(rig, channel, trace.kinds[channel]))


def total_delay(rig: Rig, channel: str, kind: str) -> float:
    """Delay [s] of the stamps of a channel against the motion, by the rig and its effects."""
    source = rig.sensors.get(channel) or rig.cameras[channel]
    return float(source.latency_s + sum(e.delay(rig, channel, kind, given) for e, given in active_effects(rig)))
