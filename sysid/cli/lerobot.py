"""``thinshell lerobot``: episodes of LeRobot datasets as tables, and recordings as a dataset."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sim_core.errors import ConfigError
from sysid.cli.bounds import whole_number
from sysid.cli.options import BagsArgument, FolderOption, RigArgument, check_bag, check_new

app = typer.Typer(help="Read LeRobot datasets (import), and write recordings as one (export).", rich_markup_mode=None)


@app.command("import")
def import_(
    dataset: Annotated[Path, typer.Argument(metavar="DATASET", help="Folder with the dataset's meta and data.")],
    out: FolderOption,
    episodes: Annotated[
        str, typer.Option("--episodes", metavar="NUMBERS", help="Episodes, as 0,3,4; all if left out.")
    ] = "",
) -> None:
    """Write episodes of a LeRobot dataset (v2 or v3) as tables, each a recording that every command takes.

    What the columns are is said in the rig (table_columns), but for those that 'thinshell lerobot export' wrote.

    Example: thinshell lerobot import my_dataset --out episodes
    """
    from sysid.recording.lerobot import write_tables

    check_new(out, "folder")
    try:
        numbers = [int(word) for word in episodes.split(",") if word.strip()]
    except ValueError:
        raise ConfigError(f"--episodes {episodes!r} are no numbers.", "Give them as 0,3,4.") from None
    print(write_tables(dataset, out, numbers))


@app.command("export")
def export(
    rig: RigArgument,
    bags: BagsArgument,
    out: FolderOption,
    fps: Annotated[int, whole_number("--fps", "Frames a second, the same for all channels.", 1)] = 30,
    task: Annotated[str, typer.Option("--task", metavar="TEXT", help="What the robot does, in a sentence.")] = "",
) -> None:
    """Write recordings of a rig as the episodes of a new LeRobot dataset (v3.0), without pictures.

    Poses are observation.state, commanded ones action, and each sensor and camera an observation of its name.

    Example: thinshell lerobot export card_press bags/press_post --out dataset
    """
    from sim_core.rigs import load_rig
    from sysid.observations.recorded_axes import in_rig_axes
    from sysid.observations.rig_topics import topics_of
    from sysid.recording import read_recording
    from sysid.recording.bag import open_bag
    from sysid.recording.lerobot import write_dataset
    from sysid.recording.notes import Notes

    chosen = load_rig(rig)
    check_new(out, "folder")
    recordings = []
    for bag in bags:
        check_bag(bag)
        topics = open_bag(bag, Notes(), chosen.table_columns).topics
        recordings.append(in_rig_axes(chosen, read_recording(bag, topics_of(chosen, topics)[0], need_pose=False)))
    print(write_dataset(recordings, out, fps, task or chosen.description, chosen.name))
