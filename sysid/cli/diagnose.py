"""``thinshell diagnose``: say which physics a rig leaves out, and write a report."""

from __future__ import annotations

import typer

from sysid.cli.fit import NO_SUCCESS
from sysid.cli.options import (
    BagsArgument,
    DespiteOption,
    FolderOption,
    FreshBodiesOption,
    HeldOutOption,
    RigArgument,
    check_new,
    library,
)
from sysid.observations.selection import check_parts
from sysid.progress import interrupts_reported, progress, warn

KEPT = "Interrupted: what was found until now is kept, and the same command goes on from there."


def diagnose(
    rig: RigArgument,
    bags: BagsArgument,
    out: FolderOption,
    held_out: HeldOutOption = None,
    despite: DespiteOption = None,
    fresh_bodies: FreshBodiesOption = False,
) -> None:
    """Find out whether the rig explains the recordings, and name the physics that is missing.

    Ctrl-C keeps what was found: the report in the folder says it, and the same command goes on from there.

    Exit code 4: what the model leaves that was found is more than ten times the noise.

    Example: thinshell diagnose card_press run1 run2 --held-out run3 --out diagnosis
    """
    from sim_core.rigs import load_rig

    chosen = load_rig(rig)
    check_parts(bags, held_out or [])
    check_new(out, "folder", resumable=True)
    find = library("sysid.workflow", "diagnose_bags")
    with interrupts_reported(KEPT), progress("diagnose") as report:
        found = find(
            chosen,
            bags,
            held_out=held_out or [],
            out=out,
            on_progress=report,
            on_warning=warn,
            despite=despite or [],
            fresh_bodies=fresh_bodies,
            resumable=True,
        )
    print(f"{found.table()}\nReport: {out / 'report.html'}")
    if found.no_success:
        raise typer.Exit(NO_SUCCESS)
