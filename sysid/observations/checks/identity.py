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
    for name, effector in rig.end_effectors.items():
        pose = recording.poses.get(name)
        if pose is None or "base_frame" in effector.model_fields_set or pose.frame_id in (effector.base_frame, ""):
            continue
        others = {s.frame_id for s in recording.poses.values()} - {pose.frame_id, ""}
        yield Finding(
            "frame",
            pose.topic,
            "warning" if others else "note",
            f"{name}: {pose.topic} is in the frame {pose.frame_id!r}, and the rig takes poses as of "
            f"{effector.base_frame!r}, its default"
            + (f"; other poses of the recording are in {', '.join(map(repr, sorted(others)))}." if others else "."),
            f"Write `base_frame: {pose.frame_id}` into end_effectors.{name} if the rig is laid out in that frame.",
            part=name,
        )
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


def pose_covariance(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """Uncertainty that the messages of poses state, against what the rig says of where the end effector really is."""
    for name, effector in rig.end_effectors.items():
        pose = recording.poses.get(name)
        if pose is None or pose.stated_sd is None:
            continue
        shift, turn = pose.stated_sd[0], float(np.degrees(pose.stated_sd[1]))
        known = max(effector.offset_sd_m), max(effector.offset_sd_deg)
        if shift <= known[0] and turn <= known[1]:
            continue
        yield Finding(
            "pose_covariance",
            pose.topic,
            "warning",
            f"{name}: the covariance in {pose.topic} states standard deviations of {shift:.3g} m and {turn:.3g} "
            f"degrees, the rig {known[0]:.3g} m and {known[1]:.3g} degrees.",
            "Write offset_sd_m and offset_sd_deg as large as the poses are uncertain into the end effector of the rig.",
            values=(shift, turn),
            bound=known[0],
            part=name,
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
