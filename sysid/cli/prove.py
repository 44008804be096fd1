"""``thinshell prove``: the benchmark with concealed effects, in three separate steps."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from sim_core.errors import ConfigError
from sysid.cli.bounds import whole_number
from sysid.cli.options import FolderOption, SeedOption, check_new, library, parse_names
from sysid.progress import progress

RIGS = ("bench", "strip", "gel")
NOISES = ("nasty", "white")

app = typer.Typer(help="Benchmark: conceal physics, diagnose, then score.", rich_markup_mode=None)

CasesFolder = Annotated[Path, typer.Argument(metavar="DIR", help="Folder made by 'thinshell prove make'.")]


FastOption = Annotated[bool, typer.Option("--fast", help="Fewer and shorter recordings, for development.")]


@app.command("make")
def make(
    out: FolderOption,
    cases: Annotated[int, whole_number("--cases", "Number of cases.", 1, 10_000)] = 20,
    seed: SeedOption = 0,
    rigs: Annotated[
        str,
        typer.Option(
            "--rigs",
            metavar="A,B",
            help="Rigs that take turns: bench, simulated on a finer mesh; strip and "
            "gel, recorded by simulators that share no method with this one.",
        ),
    ] = "bench,strip,gel",
    fast: FastOption = False,
) -> None:
    """Simulate recordings with concealed effects; the truth is sealed next to them."""
    chosen = parse_names(rigs, "--rigs", "strip,gel")
    for word in chosen:
        _check_word(word, "--rigs", RIGS)
    check_new(out, "folder")
    with progress("prove make") as report:
        print(
            library("sysid.proof", "make_cases")(
                out, cases=cases, seed=seed, rigs=tuple(dict.fromkeys(chosen)), fast=fast, on_progress=report
            )
        )


@app.command("record")
def record(
    out: FolderOption,
    stand: Annotated[str, typer.Option("--stand", metavar="NAME", help="What is recorded: strip or gel.")] = "strip",
    cases: Annotated[int, whole_number("--cases", "Number of cases.", 1, 10_000)] = 1,
    seed: SeedOption = 0,
    conceal: Annotated[
        list[str] | None,
        typer.Option("--conceal", metavar="NAME", help="What each case conceals; may be repeated. Default: nothing."),
    ] = None,
    fast: FastOption = False,
    noise: Annotated[str, typer.Option("--noise", metavar="KIND", help="Noise: nasty or white.")] = "nasty",
) -> None:
    """Record cases by a simulator that shares no method with this one.

    Not sealed: each case folder holds its rig, its recordings and truth.json.

    Example: thinshell prove record --stand gel --cases 3 --conceal gel_relaxation --out cases
    """
    from sysid.proof import concealable

    _check_word(stand, "--stand", RIGS[1:])
    _check_word(noise, "--noise", NOISES)
    for name in conceal or []:
        _check_word(name, "--conceal", concealable(stand))
    check_new(out, "folder")
    with progress("prove record") as report:
        print(
            library("sysid.proof", "record_cases")(
                out, stand, cases=cases, seed=seed, effects=conceal or (), fast=fast, noise=noise, on_progress=report
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


@app.command("keep")
def keep(folder: CasesFolder, out: FolderOption) -> None:
    """Copy seal, truth, verdicts and score of a scored shard, without recordings and reports."""
    _check_cases(folder)
    check_new(out, "folder")
    print(library("sysid.proof", "keep_shard")(folder, out))


@app.command("ledgers")
def ledgers(folder: CasesFolder) -> None:
    """Write what a diagnosis sees of every case, its ledger, without refits. Finished ones are kept."""
    _check_cases(folder)
    with progress("prove ledgers") as report:
        print(library("sysid.proof", "make_ledgers")(folder, on_progress=report))


@app.command("curve")
def curve(
    folder: CasesFolder,
    out: FolderOption,
    cases: Annotated[int, whole_number("--cases", "Number of cases that are drawn.", 1, 1_000_000)] = 300,
    seed: SeedOption = 0,
    folds: Annotated[
        int, whole_number("--folds", "Parts, each judged by numbers learnt from the others; 1: as shipped.", 1, 1000)
    ] = 1,
) -> None:
    """Power and errors of the posterior by strength, over ledgers of empty cases.

    Effects are concealed in these ledgers to first order, without a rollout, in shapes that are not looked at.

    Example: thinshell prove curve empty --cases 1000 --out curve
    """
    _check_cases(folder)
    check_new(out, "folder")
    with progress("prove curve") as report:
        print(
            library("sysid.proof", "make_curve")(folder, out, cases=cases, seed=seed, folds=folds, on_progress=report)
        )


@app.command("form-error")
def form_error(folder: CasesFolder) -> None:
    """What the simulator is off in ledgers of empty cases, by named approximation.

    Example: thinshell prove form-error empty
    """
    _check_cases(folder)
    print(library("sysid.proof", "form_error_table")(folder))


@app.command("learn")
def learn(
    folder: CasesFolder,
    cases: Annotated[int, whole_number("--cases", "Number of cases that are drawn.", 1, 1_000_000)] = 200,
    seed: SeedOption = 0,
) -> None:
    """Learn the numbers of the posterior from ledgers of empty cases.

    The form error by the marginal likelihood of these cases, prior weights by the logarithmic score of drawn ones.

    Example: thinshell prove learn empty
    """
    _check_cases(folder)
    print(library("sysid.proof", "make_learnt")(folder, cases=cases, seed=seed))


def _check_cases(folder: Path) -> None:
    if not folder.is_dir():
        raise ConfigError(f"The folder {folder} does not exist.", "Make one with 'thinshell prove make --out DIR'.")


def _check_word(word: str, option: str, known: Sequence[str]) -> None:
    if word not in known:
        raise ConfigError(f"{option} is {word!r}.", f"Use one of: {', '.join(known)}.")
