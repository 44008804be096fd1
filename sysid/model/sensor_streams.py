"""From a trace of the simulator to what the sensors of a rig would put on their topics."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_core.effects import active_effects
from sim_core.gradients import Direction
from sim_core.rigs import Rig
from sim_core.simulate import Trace, interpolate


def predicted(trace: Trace, rig: Rig, channel: str, stamps: np.ndarray, since: float = 0.0) -> np.ndarray:
    """Readings of a channel at stamps [s], with latency and the sensor effects of the rig: ``(k, ...)``. ``since``: how
    long [s] the sensors have been at work when the trace begins."""
    kind = trace.kinds[channel]
    out = interpolate(trace.times, trace.outputs[channel], stamps - total_delay(rig, channel, kind))
    for effect, given in active_effects(rig):
        out = out + effect.added_to_output(rig, channel, kind, stamps + since, given)
    return out


def predicted_derivatives(
    trace: Trace, derivatives: np.ndarray, rig: Rig, channel: str, stamps: np.ndarray
) -> np.ndarray:
    """Derivatives ``(n_times, ..., p)`` of a channel carried to the stamps: ``(k, ..., p)``. Effects of sensors can
    only add to readings, so that nothing but the delay is in between."""
    return interpolate(trace.times, derivatives, stamps - total_delay(rig, channel, trace.kinds[channel]))


def stream_derivatives(
    trace: Trace,
    along: Sequence[Direction],
    channel: str,
    stamps: np.ndarray,
    since: float = 0.0,
    here: np.ndarray | None = None,
) -> np.ndarray:
    """What parameters change in a channel after the rollout, ``(k, ..., p)``: delays, and effects of sensors. ``here``
    ``(k, ...)``: the readings themselves, by which a point that is out of sight on one side is differentiated on the
    other."""
    changes = []
    for d in along:
        high, low = (predicted(trace, rig, channel, stamps, since) for rig in (d.high, d.low))
        width = np.full(high.shape, d.width)
        if here is not None:
            width[np.isnan(high) ^ np.isnan(low)] *= 0.5
            high, low = (np.where(np.isnan(side), here, side) for side in (high, low))
        changes.append((high - low) / width)
    return np.stack(changes, axis=-1) if changes else np.zeros((len(stamps), *trace.outputs[channel].shape[1:], 0))


def predicted_back(
    trace: Trace,
    rig: Rig,
    channel: str,
    stamps: np.ndarray,
    weights: np.ndarray,
    along: Sequence[Direction] = (),
    since: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives ``weights`` of a loss by what is :func:`predicted` ``(k, ...)``, taken back to the readings of the
    trace, in their shape, and to parameters after the rollout ``(p,)``: what the adjoint leaves to be added for delays
    and effects of sensors. Points out of sight, NaN, count as zero."""
    known = np.where(np.isnan(predicted(trace, rig, channel, stamps, since)), 0.0, weights)
    share = interpolate(trace.times, np.eye(len(trace.times)), stamps - total_delay(rig, channel, trace.kinds[channel]))
    by_readings = np.tensordot(share.T, known, axes=1).reshape(trace.outputs[channel].shape)
    changes = np.nan_to_num(stream_derivatives(trace, along, channel, stamps, since))
    return np.asarray(by_readings), changes.reshape(known.size, len(along)).T @ known.ravel()


def total_delay(rig: Rig, channel: str, kind: str) -> float:
    """Delay [s] of the stamps of a channel against the motion, by the rig and its effects."""
    source = rig.sensors.get(channel) or rig.cameras[channel]
    return float(source.latency_s + sum(e.delay(rig, channel, kind, given) for e, given in active_effects(rig)))
