"""Frames and marker numbers of a recording against those of a rig."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sim_core.rigs import Rig
from sysid.observations.checks.finding import Finding
from sysid.observations.rig_match import marker_numbers, numbers_apart
from sysid.recording import Recording


def frames(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Frames other than those of the rig. A frame that is empty is said when the recording is read."""
    streams = [
        *(
            (n, e.base_frame, recording.poses.get(n))
            for n, e in rig.end_effectors.items()
            if "base_frame" in e.model_fields_set
        ),
        *((n, s.frame_id, recording.wrenches.get(n) or recording.markers.get(n)) for n, s in rig.sensors.items()),
        *((n, c.frame_id, recording.tracks.get(n)) for n, c in rig.cameras.items()),
    ]
    for name, known, stream in streams:
        if stream is None or known is None or stream.frame_id in (known, ""):
            continue
        yield Finding(
            "frame",
            stream.topic,
            "warning",
            f"{name}: {stream.topic} is in the frame {stream.frame_id!r}, in the rig in {known!r}.",
            "",
            part=name,
            of_another_rig=True,
        )


def numbers(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Marker numbers other than those of the rig.

    A rig may leave out a few markers on purpose: where all that it knows were seen, and at most half as many it does
    not know, nothing speaks against it.
    """
    for name, known in marker_numbers(rig).items():
        seen = recording.markers.get(name) or recording.tracks.get(name)
        if seen is None or set(seen.ids.tolist()) == set(known.tolist()):
            continue
        strange, lost = (len(np.setdiff1d(*pair)) for pair in ((seen.ids, known), (known, seen.ids)))
        another = bool(lost or 2 * strange > len(known))
        yield Finding(
            "marker_numbers",
            seen.topic,
            "warning" if another else "note",
            f"{name}: {numbers_apart(seen.ids, known)}",
            "",
            values=(float(len(seen.ids)),),
            bound=float(len(known)),
            part=name,
            of_another_rig=another,
        )
