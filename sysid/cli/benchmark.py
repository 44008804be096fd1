"""``thinshell benchmark``: tasks by methods."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.bounds import number, whole_number
from sysid.cli.options import ClusterOption, parse_names
from sysid.progress import progress


def benchmark(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder; what it has already is not made again.")],
    tasks: Annotated[
        list[str] | None, typer.Argument(metavar="[TASK]...", help="Default: all, in the variant of --variant.")
    ] = None,
    methods: Annotated[
        str, typer.Option("--methods", metavar="A,B", help="As 'thinshell optimise' has them.")
    ] = "hybrid,cma,adam",
    variant: Annotated[
        str, typer.Option("--variant", metavar="NAME", help="Of the tasks where none is named: real or paper.")
    ] = "real",
    seeds: Annotated[int, whole_number("--seeds", "Number of seeds.", 1)] = 3,
    budget: Annotated[int, whole_number("--budget", "Rollouts of each run.", 1)] = 200,
    minutes: Annotated[
        float | None, number("--minutes", "Wall time after which no run begins.", 0.0, metavar="MINUTES")
    ] = None,
    workers: Annotated[int, whole_number("--workers", "Rollouts at once; 0: one a core.", 0)] = 0,
    cluster: ClusterOption = "",
    to_the_end: Annotated[
        bool, typer.Option("--to-the-end", help="Spend the whole budget, also after the first success.")
    ] = False,
) -> None:
    """Make the table of tasks by methods over seeds, with random starts, and a page with curves and animations. The
    same command goes on with what is there.

    Example: thinshell benchmark --variant paper --seeds 3 --budget 400 --out bench
    """
    from sim_core.optimise import Settings
    from sim_core.optimise import method as method_named
    from sim_core.tasks import load_task, task_names
    from sysid.bench.tasks import benchmark as make
    from sysid.bench.tasks import table
    from sysid.report.benchmark_page import write_benchmark_page

    names = parse_names(methods, "--methods", "hybrid,cma")
    for name in names:
        method_named(name)
    chosen = [task if ":" in task or variant == "real" else f"{task}:{variant}" for task in tasks or task_names()]
    for task in chosen:
        load_task(task)
    settings = Settings(
        rollouts=budget, workers=workers or os.cpu_count() or 1, stop_at_success=not to_the_end, cluster=cluster
    )
    with progress("benchmark") as report:
        seconds = float("inf") if minutes is None else 60.0 * minutes
        rows = make(chosen, names, range(seeds), settings, out, report, seconds)
    with progress("animations") as report:
        page = write_benchmark_page(out, chosen, names, rows, report)
    print(table(rows))
    print(f"written: {page}, {out / 'table.json'} and {out / 'table.md'}")
