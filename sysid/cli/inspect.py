"""``thinshell inspect``: what a recording holds, and what is odd about it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid.cli.options import check_bag

if TYPE_CHECKING:
    from sim_core.rigs import Rig
    from sysid.observations.checks import Finding
    from sysid.recording import Recording

STILL_S = 0.3
"""Shortest rest that is listed; windows of a recording may begin in one."""

MOST_SPANS = 20
"""Rests that are listed."""


def inspect(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Recording: a rosbag2 folder or a single file.")],
    rig: Annotated[
        str | None,
        typer.Option("--rig", metavar="RIG", help="Read the topics that this rig names, and compare with it."),
    ] = None,
) -> None:
    """List the streams of a recording, and everything that was repaired, assumed or found odd.

    With --rig also what contradicts the rig. What stops a fit says so, and by which name --despite goes on.

    Example: thinshell inspect bags/press_post
    """
    from sim_core.rigs import load_rig
    from sim_core.rigs.trajectory import PoseTrajectory
    from sysid.noise.stillness import standing_still
    from sysid.observations.checks import examine
    from sysid.observations.recorded_axes import in_rig_axes
    from sysid.observations.rig_match import check_topics, places_of_topics
    from sysid.observations.rig_topics import topics_of
    from sysid.recording import read_recording
    from sysid.recording.bag import open_bag
    from sysid.recording.notes import Notes

    chosen = load_rig(rig) if rig is not None else None
    check_bag(bag)
    names, missing = None, []
    if chosen is not None:
        topics = open_bag(bag, Notes(), chosen.table_columns).topics
        names, absent = topics_of(chosen, topics)
        if not (names.wrench or names.markers or names.tracks or names.images):
            check_topics(chosen, bag, topics)
        places = places_of_topics(chosen)
        missing = [
            f"missing: {t}: the rig {chosen.name!r} names it in {places[t]}, the recording lacks it" for t in absent
        ]
        if missing:
            missing.append("What the recording has under another name: write that name there into the rig.")
    recording = read_recording(bag, names, need_pose=False)
    print(recording.summary())
    if chosen is not None:
        recording = in_rig_axes(chosen, recording)
    findings, seen = examine(recording, chosen)
    for found in (*findings, *(_compared(chosen, seen, findings, bag) if chosen is not None else ())):
        print(found)
    recording = seen
    for name, stream in recording.poses.items():
        trajectory = PoseTrajectory.from_samples(stream.t, stream.position, stream.quaternion)
        spans = [f"{begin:.2f} to {end:.2f}" for begin, end in standing_still(trajectory, STILL_S)]
        more = f" and {len(spans) - MOST_SPANS} more" if len(spans) > MOST_SPANS else ""
        print(f"{name} stands still, s: {', '.join(spans[:MOST_SPANS]) or 'never'}{more}")
    for line in missing:
        print(line)


def _compared(rig: Rig, recording: Recording, findings: Sequence[Finding], bag: Path) -> Sequence[Finding]:
    """What speaks for a mistake of set-up, if the recording can be lined up with the rig at all."""
    from sim_core.errors import ThinshellError
    from sysid.model.load import lined_up
    from sysid.observations.checks import Finding
    from sysid.observations.rig_match import check_topics
    from sysid.recording.bag import open_bag
    from sysid.recording.notes import Notes
    from sysid.setup_check.check import check_setup

    try:
        check_topics(rig, bag, open_bag(bag, Notes()).topics)
        return check_setup(rig, lined_up(rig, recording, findings, bag)).findings
    except ThinshellError as error:
        return [
            Finding("not_compared", str(bag), "note", f"It is not compared with the rig: {error.problem}", error.remedy)
        ]
