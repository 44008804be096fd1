"""Stamps in steps that are coarse compared with the interval of a stream: readings are shifted in time, and of those
that get one stamp all but the first are dropped when they are read."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.observations.checks.finding import Finding
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def coarse_stamps(recording: Recording) -> Iterator[Finding]:
    """Every stream of which the stamps are multiples of a step that is no interval of it."""
    for _, name, stream in recording.streams():
        messages = recording.provenance.message_counts.get(stream.topic, len(stream))
        step = step_of_stamps(stream.t, messages)
        if step is None:
            continue
        lost = messages - len(stream)
        dropped = f"; {lost} of {messages} messages had the stamp of another one and are dropped" if lost > 0 else ""
        yield Finding(
            "coarse_stamps",
            stream.topic,
            "warning",
            f"The stamps of {name} come in steps of {step:.4g} s, so that its readings may be {0.5 * step:.2g} s off "
            f"in time{dropped}.",
            "Stamp readings in nanoseconds, or write `recording_clock: log` into the rig to use the recorder's times.",
            values=(step,),
            bound=OBSERVATIONS.coarse_stamp_share,
            part=name,
        )


def step_of_stamps(t: np.ndarray, messages: int) -> float | None:
    """Step [s] of stamps ``(n,)`` of so many messages, if it is coarse. A steady stream has its own interval as a step,
    and gaps of several; that is coarse only where many messages had one stamp."""
    if len(t) < OBSERVATIONS.rate_samples:
        return None
    intervals = np.diff(t)
    step = float(intervals.min())
    for _ in range(len(t)):  # the greatest common divisor of the intervals, by Euclid's algorithm
        rest = intervals - step * np.rint(intervals / step)
        worst = float(np.abs(rest).max())
        if worst < OBSERVATIONS.stamp_multiple_share * step:
            break
        step = worst
        if step < OBSERVATIONS.coarse_stamp_share * float(np.median(intervals)):
            return None
    shared = messages > (1.0 + OBSERVATIONS.coarse_stamp_share) * len(t)
    # A steady stream that is rounded has two neighbouring numbers of steps as intervals, and not one of a single step.
    counts = np.rint(intervals / step)
    low = np.floor(float(np.mean(counts)))
    mixed = low > 1.0 and bool(np.isin(counts, (low, low + 1.0)).mean() > 1.0 - OBSERVATIONS.coarse_stamp_share)
    mixed = mixed and 0.0 < float(np.mean(counts == low)) < 1.0
    return step if shared or mixed else None
