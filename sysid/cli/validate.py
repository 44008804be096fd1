"""``thinshell validate``: physics with known solutions."""

from __future__ import annotations

from typing import Annotated

import typer

from sysid.cli.options import library
from sysid.progress import progress


def validate(
    groups: Annotated[
        list[str] | None,
        typer.Argument(metavar="[GROUP]...", help="Groups of comparisons, 'drape' say; all of them if none is named."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
) -> None:
    """Compare the simulator with problems whose solutions are known; exit code 1 if one is missed."""
    with progress("validate") as report:
        passed, text = library("sysid.validation", "run_validation")(
            as_json=as_json, on_progress=report, groups=groups or ()
        )
    print(text)
    if not passed:
        raise typer.Exit(1)
