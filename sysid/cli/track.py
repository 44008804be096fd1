"""``thinshell track``: markers of a recording's pictures as tracks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.options import FolderOption, check_bag, check_new
from sysid.progress import progress


def track(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Recording with pictures.")],
    out: FolderOption,
    camera: Annotated[
        str | None,
        typer.Option("--camera", metavar="NAME", help="Which camera, where a recording has several."),
    ] = None,
    rig: Annotated[
        str | None,
        typer.Option("--rig", metavar="RIG", help="Read the topics that this rig names, not the usual ones."),
    ] = None,
) -> None:
    """Find the markers in the pictures of a recording, follow them, and write a recording with tracks.

    Example: thinshell track run1 --out run1_tracked
    """
    from sim_core.rigs import load_rig
    from sysid.observations.rig_topics import topics_of
    from sysid.recording.bag import open_bag
    from sysid.recording.notes import Notes

    chosen = load_rig(rig) if rig is not None else None
    check_bag(bag)
    check_new(out, "folder")
    topics = None if chosen is None else topics_of(chosen, open_bag(bag, Notes(), chosen.table_columns).topics)[0]
    from sysid.vision.command import track as track_markers

    with progress("track") as report:
        track_markers(
            bag,
            out,
            camera,
            topics=topics,
            progress=lambda step, done, total: report(done / max(total, 1), step),
        )
