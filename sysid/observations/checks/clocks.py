"""Clocks that jump or drift: header stamps against the recorder's clock, stream by stream."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid.observations.checks.finding import Finding
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def clocks(recording: Recording) -> Iterator[Finding]:
    """Steps, drifts and offsets of the delay from stamp to recorder. Transport delays only ever add to it, so the least
    delay of a while tells the clock."""
    usual: list[tuple[float, str]] = []
    for _, _, stream in recording.streams():
        if stream.arrival is None or len(stream) < OBSERVATIONS.clock_messages:
            continue
        delay = stream.arrival - stream.t
        parts = np.array_split(np.arange(len(delay)), OBSERVATIONS.clock_parts)
        least = np.array([delay[p].min() for p in parts])
        middle = np.array([stream.t[p].mean() for p in parts])
        usual.append((float(np.median(least)), stream.topic))
        step = _step(least)
        if step is not None:
            k, height = step
            at = float(stream.t[parts[k][0]])
            yield Finding(
                "clock_step",
                stream.topic,
                "warning",
                f"The header stamps step by {-height:+.4g} s against the recorder's clock near {at:.2f} s and stay "
                f"there (more than {OBSERVATIONS.clock_step_s:g} s).",
                "Cut the recording there, or write `recording_clock: log` into the rig to use the recorder's times.",
                times=(at,),
                values=(height,),
                bound=OBSERVATIONS.clock_step_s,
            )
            continue
        slope, base = np.polyfit(middle, least, 1)
        drift = float(slope * (stream.t[-1] - stream.t[0]))
        left = least - (slope * middle + base)
        if abs(drift) > OBSERVATIONS.clock_drift_s and float(np.abs(left).max()) < 0.2 * abs(drift):
            yield Finding(
                "clock_drift",
                stream.topic,
                "warning",
                f"The header stamps drift by {-1e3 * drift:+.3g} ms against the recorder's clock over the recording, "
                f"{-1e6 * slope:+.0f} parts in a million (more than {1e3 * OBSERVATIONS.clock_drift_s:g} ms).",
                "Set the clocks by NTP or PTP, or write `recording_clock: log` into the rig.",
                values=(drift, float(slope)),
                bound=OBSERVATIONS.clock_drift_s,
            )
    if len(usual) > 1:
        (low, early), (high, late) = min(usual), max(usual)
        if high - low > OBSERVATIONS.clock_offset_s:
            yield Finding(
                "clock_offset",
                late,
                "warning",
                f"Its header stamps are {high - low:.4g} s behind those of {early}, by the recorder's clock that both "
                f"have in common (more than {OBSERVATIONS.clock_offset_s:g} s).",
                "Set the clocks of the two computers, or write `recording_clock: log` into the rig.",
                values=(high - low,),
                bound=OBSERVATIONS.clock_offset_s,
            )


def _step(least: np.ndarray) -> tuple[int, float] | None:
    """Where the least delay of parts steps, and by how much: once, and constant on both sides."""
    rises = np.diff(least)
    k = int(np.argmax(np.abs(rises)))
    before, after = least[: k + 1], least[k + 1 :]
    # The part in which it steps may hold the delays of both sides.
    height = float(np.median(after) - np.median(before))
    calm = max(float(np.median(np.abs(side - np.median(side)))) for side in (before, after))
    return (k + 1, height) if abs(height) > OBSERVATIONS.clock_step_s and calm < 0.1 * abs(height) else None
