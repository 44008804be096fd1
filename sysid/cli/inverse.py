"""``thinshell inverse``: one number of a rig sought from a recording, by several methods."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid.cli.bounds import whole_number
from sysid.progress import progress


def inverse(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder; what it has already is not made again.")],
    tasks: Annotated[list[str] | None, typer.Argument(metavar="[TASK]...", help="Default: all.")] = None,
    methods: Annotated[
        str, typer.Option("--methods", metavar="A,B", help="fit, gradient (descent), cma.")
    ] = "fit,gradient,cma",
    seeds: Annotated[int, whole_number("--seeds", "Number of seeds.", 1)] = 1,
    workers: Annotated[int, whole_number("--workers", "Threads; 0: one a core.", 0)] = 0,
) -> None:
    """Seek a friction or a bending stiffness by the fit, by gradient descent and by CMA-ES.

    Example: thinshell inverse bouncing --methods fit,cma --out inverse
    """
    from sysid.inverse import inverse_benchmark, inverse_table, inverse_task_names

    names = [word.strip() for word in methods.split(",") if word.strip()]
    with progress("inverse") as report:
        rows = inverse_benchmark(
            tasks or inverse_task_names(), names, range(seeds), out, workers=workers or None, on_progress=report
        )
    print(inverse_table(rows))
    print(f"written: {out / 'rows.json'} and {out / 'table.md'}")
