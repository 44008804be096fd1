"""``thinshell inspect``: what a recording holds, and what is odd about it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.options import check_bag


def inspect(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Recording: a rosbag2 folder or a single file.")],
    rig: Annotated[
        str | None,
        typer.Option("--rig", metavar="RIG", help="Read the topics that this rig names, not the usual ones."),
    ] = None,
) -> None:
    """List the streams of a recording, and everything that was repaired, assumed or found odd.

    Example: thinshell inspect bags/press
    """
    from sim_core.rigs import load_rig
    from sysid.recording import read_recording
    from sysid.recording.bag import open_bag
    from sysid.recording.notes import Notes
    from sysid.rig_topics import topics_of

    chosen = load_rig(rig) if rig is not None else None
    check_bag(bag)
    if chosen is None:
        print(read_recording(bag, need_pose=False).summary())
        return
    names, missing = topics_of(chosen, open_bag(bag, Notes()).topics)
    print(read_recording(bag, names, need_pose=False).summary())
    for topic in missing:
        print(f"missing: {topic}: the rig {chosen.name!r} names it, the recording lacks it")
