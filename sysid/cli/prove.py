"""``thinshell prove``: the benchmark with concealed effects, in three separate steps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sim_core.errors import ConfigError
from sysid.cli.bounds import whole_number
from sysid.cli.options import FolderOption, SeedOption, check_new, library
from sysid.cli.progress import progress

STANDS = ("strip",)
NOISES = ("nasty", "white")

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


@app.command("record")
def record(
    out: FolderOption,
    stand: Annotated[str, typer.Option("--stand", metavar="NAME", help="What is recorded: strip.")] = "strip",
    cases: Annotated[int, whole_number("--cases", "Number of cases.", 1, 10_000)] = 1,
    seed: SeedOption = 0,
    fast: Annotated[bool, typer.Option("--fast", help="Fewer and shorter recordings, for development.")] = False,
    noise: Annotated[str, typer.Option("--noise", metavar="KIND", help="Noise: nasty or white.")] = "nasty",
) -> None:
    """Record cases that conceal nothing, by a simulator that shares no method with this one.

    Not sealed: each case folder holds its rig, its recordings and truth.json.
    """
    for word, option, known in ((stand, "--stand", STANDS), (noise, "--noise", NOISES)):
        if word not in known:
            raise ConfigError(f"{option} is {word!r}.", f"Use {' or '.join(known)}.")
    check_new(out, "folder")
    with progress("prove record") as report:
        print(
            library("sysid.proof", "record_cases")(
                out, stand, cases=cases, seed=seed, fast=fast, noise=noise, on_progress=report
            )
        )


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
