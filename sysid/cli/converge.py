"""``thinshell converge``: cells, time step and contact constants by which errors are small against the noise."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.bounds import number
from sysid.cli.options import RigArgument, check_new, library, parse_settings
from sysid.progress import progress, warn


def converge(
    rig: RigArgument,
    motion: Annotated[
        str,
        typer.Argument(metavar="EXPERIMENT|BAG", help="Experiment (a name or a YAML file), or a recording."),
    ],
    out: Annotated[Path, typer.Option("--out", metavar="RIG", help="New rig file to write.")],
    most_seconds: Annotated[
        float, number("--most-seconds", "Longest wall time of one simulation that is begun", 1.0, metavar="SECONDS")
    ] = 600.0,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Value of a parameter; may be repeated."),
    ] = None,
) -> None:
    """Refine a rig until halving its cells, its time step or the range of its contacts changes no channel by more than
    a third of its noise, and write it. Exit code 1 where that would take too long, with what it would cost.

    Example: thinshell converge strip_coarse pull_taut --out strip_fine.yaml
    """
    from sim_core.rigs import load_rig, with_parameters

    chosen = with_parameters(load_rig(rig), parse_settings(settings or []))
    check_new(out, "rig file")
    with progress("converge") as report:
        found = library("sysid.workflow.converge", "converge_rig")(
            chosen, motion, out, most_s=most_seconds, on_progress=report, on_warning=warn
        )
    print(found.table())
    print(f"Rig: {out}")
    if not found.converged:
        raise typer.Exit(1)
