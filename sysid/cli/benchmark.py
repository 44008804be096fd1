"""``thinshell benchmark``: tasks by methods."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.bounds import whole_number
from sysid.cli.progress import progress


def benchmark(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder; what it has already is not made again.")],
    tasks: Annotated[
        list[str] | None, typer.Argument(metavar="[TASK]...", help="Default: all, in the variant that is for use.")
    ] = None,
    methods: Annotated[
        str, typer.Option("--methods", metavar="A,B", help="As 'thinshell optimise' has them.")
    ] = "hybrid,cma",
    seeds: Annotated[int, whole_number("--seeds", "Number of seeds.", 1)] = 3,
    budget: Annotated[int, whole_number("--budget", "Rollouts of each run.", 1)] = 200,
    workers: Annotated[int, whole_number("--workers", "Threads; 0: one a core.", 0)] = 0,
    to_the_end: Annotated[
        bool, typer.Option("--to-the-end", help="Spend the whole budget, also after the first success.")
    ] = False,
) -> None:
    """Make the table of tasks by methods, with several seeds.

    Example: thinshell benchmark lifting following --methods hybrid --seeds 3 --budget 100 --out bench
    """
    from sim_core.optimise import Settings
    from sim_core.optimise import method as method_named
    from sim_core.optimise.benchmark import benchmark as make
    from sim_core.optimise.benchmark import table
    from sim_core.tasks import task_names

    names = [word.strip() for word in methods.split(",") if word.strip()]
    for name in names:
        method_named(name)
    settings = Settings(rollouts=budget, workers=workers or os.cpu_count() or 1, stop_at_success=not to_the_end)
    with progress("benchmark") as report:
        rows = make(tasks or task_names(), names, range(seeds), settings, out, report)
    print(table(rows))
    print(f"written: {out / 'table.json'} and {out / 'table.md'}")
