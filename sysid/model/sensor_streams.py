"""From a trace of the simulator to what the sensors of a rig would put on their topics.

A reading stamped t shows the state at t - latency, and at another instant still where an effect says that a clock is
off (:class:`sim_core.effects.hooks.ClockMap`); what the sensor makes of it follows, one effect after the other
(:class:`sim_core.effects.hooks.ReadingMap`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_core.effects import Instance, active, amended
from sim_core.effects.hooks import Channel, ClockMap, ReadingMap
from sim_core.gradients import Direction
from sim_core.rigs import Rig
from sim_core.simulate import Trace, interpolate
from sysid.settings.model import MODEL


def channel_of(rig: Rig, name: str, kind: str, stamps: np.ndarray, since: float = 0.0) -> Channel:
    """What effects know of a stream; ``rig``: with the amendments of its numbers made."""
    return Channel(name, kind, stamps, since, rig)  # type: ignore[arg-type]


def reading_maps(rig: Rig, channel: str) -> list[Instance]:
    """Effects that act on the readings of a channel, in their order."""
    return [instance for instance in active(rig, ReadingMap) if channel in instance.targets]


def shown_at(rig: Rig, channel: str, kind: str, stamps: np.ndarray, since: float = 0.0) -> np.ndarray:
    """Times [s] ``(k,)`` of the states that readings with these stamps show, by the rig and its effects. ``since``: as
    of :func:`predicted`."""
    rig = amended(rig)
    source = rig.sensors.get(channel) or rig.cameras[channel]
    times = stamps - source.latency_s
    for instance in active(rig, ClockMap):
        if channel in instance.targets:
            times = instance.effect.shown_at(channel_of(rig, channel, kind, times, since), instance.values)
    return np.asarray(times)


def total_delay(rig: Rig, channel: str, kind: str) -> float:
    """Delay [s] of the stamps of a channel against the motion at the start."""
    return -float(shown_at(rig, channel, kind, np.zeros(1))[0])


def reported(
    rig: Rig, channel: str, kind: str, stamps: np.ndarray, readings: np.ndarray, since: float = 0.0
) -> np.ndarray:
    """What a sensor makes of true readings ``(k, ...)`` with these stamps [s]."""
    rig = amended(rig)
    for instance in reading_maps(rig, channel):
        there = channel_of(rig, channel, kind, stamps, since)
        readings = instance.effect.read(there, readings, instance.values)
    return readings


def predicted(trace: Trace, rig: Rig, channel: str, stamps: np.ndarray, since: float = 0.0) -> np.ndarray:
    """Readings of a channel at stamps [s], with latency and the sensor effects of the rig: ``(k, ...)``. ``since``: how
    long [s] the sensors have been at work when the trace begins."""
    kind = trace.kinds[channel]
    true = interpolate(trace.times, trace.outputs[channel], shown_at(rig, channel, kind, stamps, since))
    return reported(rig, channel, kind, stamps, true, since)


def clock_response(
    trace: Trace, rig: Rig, other: Rig, channel: str, stamps: np.ndarray, since: float = 0.0
) -> np.ndarray:
    """What the clocks of another rig change in the readings of a channel ``(k, ...)``, to first order in the time by
    which they are off: the derivative by a delay, which nuisance parameters are too, and not what is curved in a delay
    of its typical size, for which there is no other column. NaN out of sight."""
    kind, width = trace.kinds[channel], MODEL.rig_difference_step
    at = shown_at(rig, channel, kind, stamps, since)
    late = shown_at(other, channel, kind, stamps, since) - at
    ends = [
        reported(rig, channel, kind, stamps, interpolate(trace.times, trace.outputs[channel], at + s), since)
        for s in (-width, width)
    ]
    rate = (ends[1] - ends[0]) / (2.0 * width)
    return np.asarray(rate * late.reshape(-1, *(1,) * (rate.ndim - 1)))


def predicted_derivatives(
    trace: Trace, derivatives: np.ndarray, rig: Rig, channel: str, stamps: np.ndarray, since: float = 0.0
) -> np.ndarray:
    """Derivatives ``(n_times, ..., p)`` of a channel carried to the stamps and through its sensor: ``(k, ..., p)``."""
    rig, kind = amended(rig), trace.kinds[channel]
    at = shown_at(rig, channel, kind, stamps, since)
    out, readings = interpolate(trace.times, derivatives, at), interpolate(trace.times, trace.outputs[channel], at)
    for instance in reading_maps(rig, channel):
        there = channel_of(rig, channel, kind, stamps, since)
        out = instance.effect.push(there, readings, out, instance.values)
        readings = instance.effect.read(there, readings, instance.values)
    return out


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
    rig, kind = amended(rig), trace.kinds[channel]
    known = np.where(np.isnan(predicted(trace, rig, channel, stamps, since)), 0.0, weights)
    at = shown_at(rig, channel, kind, stamps, since)
    stages = [interpolate(trace.times, trace.outputs[channel], at)]
    maps = reading_maps(rig, channel)
    there = channel_of(rig, channel, kind, stamps, since)
    for instance in maps:
        stages.append(instance.effect.read(there, stages[-1], instance.values))
    back = known
    for instance, readings in zip(reversed(maps), reversed(stages[:-1]), strict=True):
        back = np.nan_to_num(instance.effect.pull(there, readings, back, instance.values))
    share = interpolate(trace.times, np.eye(len(trace.times)), at)
    by_readings = np.tensordot(share.T, back, axes=1).reshape(trace.outputs[channel].shape)
    changes = np.nan_to_num(stream_derivatives(trace, along, channel, stamps, since))
    return np.asarray(by_readings), changes.reshape(known.size, len(along)).T @ known.ravel()
