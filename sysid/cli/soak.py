"""``thinshell soak``: long random runs, to find steps that fail."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from typing import Annotated

import typer

from sysid.cli.bounds import whole_number
from sysid.cli.options import SeedOption
from sysid.progress import progress


def soak(
    rigs: Annotated[
        list[str] | None, typer.Argument(metavar="[RIG]...", help="Rigs to run; default: all that come with it.")
    ] = None,
    steps: Annotated[int, whole_number("--steps", "Steps in total, spread over the rigs.", 1)] = 10_000,
    seed: SeedOption = 0,
    as_json: Annotated[bool, typer.Option("--json", help="Print every run as JSON.")] = False,
) -> None:
    """Move all end effectors of all rigs at random, then hold them still, and count what goes wrong.

    Counts steps that fail, steps that had to be halved, values that are not finite, and energy that rises where nothing
    drives the system. Exit code 1 if anything failed. Example: thinshell soak lifting --steps 400 --seed 3
    """
    from sim_core.rigs.load import names_in
    from sysid.bench import stress_test as library

    chosen = rigs or names_in("rigs")
    with progress("soak") as report:
        runs = list(library.soak(chosen, steps, seed, lambda share, run: report(share, f"{run.rig}, seed {run.seed}")))
    print(json.dumps([asdict(r) for r in runs], indent=2) if as_json else "\n".join(library.run_lines(runs)))
    failed = library.failure_lines(runs)
    if failed:
        print("\n".join(failed), file=sys.stderr)
        raise typer.Exit(1)
