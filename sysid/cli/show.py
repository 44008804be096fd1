"""``thinshell show``: look at a rig, or at what it does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid.cli.bounds import whole_number
from sysid.cli.options import RigArgument, parse_settings
from sysid.progress import progress, warn

if TYPE_CHECKING:
    from sim_core.rigs import Rig
    from sysid.show.subject import Subject


def show(
    rig: RigArgument,
    what: Annotated[
        str | None,
        typer.Argument(
            metavar="[EXPERIMENT|BAG|TRACE]",
            help="What it does: an experiment (a name or a YAML file), a recording (or a window, BAG@12.5:20), or a "
            "trace (.npz); nothing: the rig as it stands.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Folder for the files; default: show_RIG or show_RIG_WHAT, here."),
    ] = None,
    by: Annotated[
        str | None,
        typer.Option(
            "--by",
            metavar="QUANTITY",
            help="Colour by displacement, strain, curvature, pressure, slip or body; default: what says most. The page "
            "has all of them.",
        ),
    ] = None,
    animation: Annotated[
        str, typer.Option("--animation", metavar="KIND", help="gif, mp4 (VP9) or none; of what moves.")
    ] = "gif",
    live: Annotated[
        bool,
        typer.Option(
            "--live",
            help="Write no files, but serve a view that turns and plays, for a browser, until Ctrl-C. Needs the extra "
            "'live'.",
        ),
    ] = False,
    port: Annotated[
        int | None, whole_number("--port", "Of --live; 0: any that is free. Default: 8080.", 0, 65535)
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            "--host",
            metavar="NAME",
            help="Of --live; default: localhost, which other machines cannot reach. 0.0.0.0: all networks.",
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter; may be repeated."),
    ] = None,
) -> None:
    """Draw a rig, or what it does: a picture, a page that turns and plays, an animation. What looks wrong is said.

    Example: thinshell show gel_sensor press_twist
    Example: thinshell show gel_sensor press_twist --live
    """
    from sim_core.errors import ConfigError, nearest_match
    from sim_core.rigs import load_rig, with_parameters
    from sysid.show.outputs import ANIMATION, PAGE, PICTURE, check_folder
    from sysid.show.outputs import show as draw

    kinds = ("gif", "mp4", "none")
    if animation not in kinds:
        raise ConfigError(f"--animation is {animation!r}.", nearest_match(animation, kinds))
    chosen = with_parameters(load_rig(rig), parse_settings(settings or []))
    name = "_".join(["show", chosen.name, *([Path(what.rpartition("@")[0] or what).stem] if what else [])])
    if live:
        if out is not None:
            raise ConfigError("--live writes no files.", "Leave --out away.")
        _serve(chosen, what, by, host, port)
        return
    if host is not None or port is not None:
        raise ConfigError("--host and --port are those of a live view.", "Add --live, or leave them away.")
    folder = out or Path(name)
    check_folder(folder)
    with progress("show") as report:
        subject = draw(chosen, what, folder, by=by, animation=animation, on_progress=report)  # type: ignore[arg-type]
    _tell(subject)
    for file in (PICTURE, PAGE, f"{ANIMATION}.{animation}"):
        if (folder / file).exists():
            print(folder / file)


def _serve(rig: Rig, what: str | None, by: str | None, host: str | None, port: int | None) -> None:
    from sysid.show.colouring import check_quantity, colourings
    from sysid.show.live import HOST, PORT, check, serve
    from sysid.show.subject import subject_of

    check_quantity(by)
    where = (HOST if host is None else host, PORT if port is None else port)
    check(*where)
    with progress("show") as report:
        subject = subject_of(rig, what, report)
    _tell(subject)
    serve(subject, colourings(subject), by, *where)


def _tell(subject: Subject) -> None:
    for finding in subject.findings:
        warn(finding.text)
    if not subject.findings:
        print("Nothing looks wrong.")
