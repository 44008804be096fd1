"""What a recording tells of breaks in itself: a simulation that was put back to its start, and time left out."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.rigs import Rig
from sysid.observations.checks.finding import Finding
from sysid.observations.checks.motion import at_rest
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def resets(recording: Recording) -> Iterator[Finding]:
    """Resets after something had moved: the state that follows is not the one that motion has led to."""
    if not recording.poses:
        return
    t = np.concatenate([stream.t for stream in recording.poses.values()])
    end = float(t.max())
    moving = t[~at_rest(recording, t)]
    for event in recording.events:
        if event.name != "reset" or not t.min() < event.t < end or not (moving < event.t).any():
            continue
        yield Finding(
            "reset",
            ", ".join(stream.topic for stream in recording.poses.values()),
            "stops a fit",
            f"The simulation was put back to its start at {event.t:.3f} s, after it had moved, as the events of "
            "the recording say: what follows does not follow from what was before.",
            f"Fit windows: BAG@0:{event.t:.2f} and BAG@{event.t + OBSERVATIONS.settled_after_reset_s:.2f}:{end:.2f}.",
            times=(event.t,),
            breaks=True,
        )


def time_left_out(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Stamps that go on where the simulation did not: nothing moved, relaxed or fell then."""
    skips = [event for event in recording.events if event.name == "skip" and 0.0 <= event.t <= recording.duration]
    lost = sum(event.left_out_s for event in skips)
    if lost < OBSERVATIONS.time_left_out_s:
        return
    yield Finding(
        "time_left_out",
        "events",
        "warning" if rig.solver.inertia else "note",
        f"In all {lost:.3g} s are left out of what happened while the stamps go on, at "
        f"{', '.join(f'{event.t:.3f}' for event in skips[:5])} s{' and later' if len(skips) > 5 else ''}: the "
        "simulation that was recorded did not keep up, or was paused.",
        "Motion and relaxation are wrong across these times: record again with a coarser mesh, or fit windows between "
        "them.",
        times=tuple(event.t for event in skips),
        values=(lost,),
        bound=OBSERVATIONS.time_left_out_s,
    )
