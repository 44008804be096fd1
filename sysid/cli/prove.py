"""``thinshell prove``: the benchmark with concealed effects, in three separate steps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sim_core.errors import ConfigError
from sysid.cli.bounds import whole_number
from sysid.cli.options import FolderOption, SeedOption, check_new, library
from sysid.cli.progress import progress

app = typer.Typer(help="Benchmark: conceal physics, diagnose, then score.", rich_markup_mode=None)

CasesFolder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder made by 'thinshell prove make'.")]


@app.command("make")
def make(
    out: FolderOption,
    cases: Annotated[int, whole_number("--cases", "Number of cases.", 1, 10_000)] = 12,
    seed: SeedOption = 0,
) -> None:
    """Simulate recordings with concealed effects; the truth is sealed beside them."""
    check_new(out, "folder")
    with progress("prove make") as report:
        print(library("sysid.proof", "make_cases")(out, cases=cases, seed=seed, on_progress=report))


@app.command("run")
def run(folder: CasesFolder) -> None:
    """Diagnose every case without looking at the truth."""
    _check_cases(folder)
    with progress("prove run") as report:
        print(library("sysid.proof", "run_cases")(folder, on_progress=report))


@app.command("score")
def score(folder: CasesFolder) -> None:
    """Unseal the truth and compare."""
    _check_cases(folder)
    print(library("sysid.proof", "score_cases")(folder))


def _check_cases(folder: Path) -> None:
    if not folder.is_dir():
        raise ConfigError(f"The folder {folder} does not exist.", "Make one with 'thinshell prove make --out DIR'.")
