"""``thinshell rerun``: a recording with its simulation, for the viewer of rerun."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.options import RigArgument, parse_settings
from sysid.progress import progress, warn


def rerun(
    rig: RigArgument,
    what: Annotated[
        str,
        typer.Argument(
            metavar="BAG|EXPERIMENT|TRACE",
            help="A recording (or a window, BAG@12.5:20), an experiment, or a trace (.npz).",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="New file; the name ends with .rrd.")],
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter; may be repeated."),
    ] = None,
) -> None:
    """Write what was measured and what the rig's simulation does meanwhile as one recording of rerun. Needs the extra
    'rerun'.

    Example: thinshell rerun card_press bags/press_post --out press.rrd
    """
    from sim_core.rigs import load_rig, with_parameters
    from sysid.show.rerun_export import check_rrd, write_rrd
    from sysid.show.subject import subject_of

    check_rrd(out)
    chosen = with_parameters(load_rig(rig), parse_settings(settings or []))
    with progress("rerun") as report:
        subject = subject_of(chosen, what, report)
        write_rrd(subject, out)
    for finding in subject.findings:
        warn(finding.text)
    print(f"{out}: open it with 'rerun {out}'")
