"""``thinshell presses``: labelled presses, each an image at rest, as recordings that a fit can follow."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.bounds import number, whole_number
from sysid.cli.options import FolderOption, RigArgument, check_bag, check_new


def presses(
    rig: RigArgument,
    bag: Annotated[Path, typer.Argument(metavar="BAG", help="Recording that 'thinshell track' wrote.")],
    out: FolderOption,
    most_tilt_deg: Annotated[
        float, number("--most-tilt-deg", "Take presses tilted by less than this.", 0.0, metavar="DEG")
    ] = 3.0,
    train: Annotated[int, whole_number("--train", "Number of presses to fit.", 1)] = 8,
    test: Annotated[int, whole_number("--test", "Number of presses to hold out.", 1)] = 8,
) -> None:
    """Write labelled presses of a domed pad on a plate as two recordings, 'train' and 'held_out'.

    The pose of each image is six labels: slide, depth, tilts and twist. Paths and stamps are made up; which way the
    slide went is found in the images. Every fifth press is held out. Printed with what predictions without mechanics
    miss, for comparison.

    Example: thinshell presses tactip_cr pins/tracked --out presses
    """
    from sim_core.rigs import load_rig

    chosen = load_rig(rig)
    check_bag(bag)
    check_new(out, "folder")
    from sysid.vision.presses import prepare

    print(prepare(chosen, bag, out, most_tilt_deg, train, test))
