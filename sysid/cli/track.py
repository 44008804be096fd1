"""``thinshell track``: markers of a recording's pictures as tracks."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.options import check_bags, check_new, library
from sysid.cli.progress import progress


def track(
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Recording with pictures.")],
    out: Annotated[Path, typer.Option("--out", metavar="BAG", help="New rosbag2 folder to write.")],
) -> None:
    """Find the markers in the pictures of a recording, follow them, and write a recording with tracks."""
    check_bags([bag])
    check_new(out, "recording")
    with progress("track") as report:
        print(library("sysid.vision.command", "track")(bag, out, on_progress=report))
