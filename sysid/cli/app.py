"""Entry point of ``thinshell``: collects the subcommands and turns errors into one paragraph.

Exit codes: 0 done; 1 a defect of the program, or a soak that found one; 2 input or data that cannot be used; 3 a fit
that did not converge; 4 a fit or a diagnosis of which the model misses the recordings by more than ten times their
noise; 130 interrupted.
"""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from typing import TextIO

import typer

from sim_core.errors import ThinshellError
from sysid.cli import (
    bench,
    benchmark,
    check_gradients,
    converge,
    coverage,
    diagnose,
    doctor,
    effects,
    experiments,
    fit,
    inspect,
    inverse,
    ledger,
    lerobot,
    optimise,
    plan,
    policy,
    presses,
    prove,
    rerun,
    rigs,
    robust,
    settings,
    show,
    simulate,
    soak,
    tasks,
    track,
    trajectory,
    validate,
)
from sysid.progress import interrupts_remembered, warn

OWN_PACKAGES = {"sim_core", "sysid", "thinshell_ros"}
REPORT = "Please report it on the project's issue tracker with the command and the output of --debug."

app = typer.Typer(
    name="thinshell",
    help="Simulate thin shells and soft gels, identify them from ROS 2 bags, and name missing physics.",
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def _print_version(wanted: bool) -> None:
    if not wanted:
        return
    try:
        print(version("thinshell_ros"))
    except PackageNotFoundError:
        print("not installed (running from the source tree)")
    raise typer.Exit()


@app.callback()
def _options(
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
    show_version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    del debug, show_version  # --debug is read by main(), so that it may stand anywhere


app.command("show")(show.show)
app.command("rerun")(rerun.rerun)
app.command("simulate")(simulate.simulate)
app.command("plan")(plan.plan)
app.command("fit")(fit.fit)
app.command("converge")(converge.converge)
app.command("coverage")(coverage.coverage)
app.command("diagnose")(diagnose.diagnose)
app.add_typer(prove.app, name="prove")
app.add_typer(trajectory.app, name="trajectory")
app.command("inspect")(inspect.inspect)
app.add_typer(lerobot.app, name="lerobot")
app.command("track")(track.track)
app.command("presses")(presses.presses)
app.command("rigs")(rigs.rigs)
app.command("params")(rigs.params)
app.command("effects")(effects.effects)
app.command("ledger")(ledger.ledger)
app.command("settings")(settings.settings)
app.command("experiments")(experiments.experiments)
app.command("tasks")(tasks.tasks)
app.command("optimise")(optimise.optimise)
app.command("benchmark")(benchmark.benchmark)
app.command("robust")(robust.robust)
app.add_typer(policy.app, name="policy")
app.command("inverse")(inverse.inverse)
app.command("check-gradients")(check_gradients.check_gradients)
app.command("validate")(validate.validate)
app.command("bench")(bench.bench)
app.command("soak")(soak.soak)
app.command("doctor")(doctor.doctor_command)


INTERRUPTED = 130


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    given = sys.argv[1:] if arguments is None else arguments
    cut = given.index("--") if "--" in given else len(given)
    debug = "--debug" in given[:cut]
    plain = each_named([word for index, word in enumerate(given) if word != "--debug" or index > cut])
    try:
        with interrupts_remembered(), _warnings_in_words():
            code = typer.main.get_command(app).main(plain or ["--help"], "thinshell", standalone_mode=False)
        sys.stdout.flush()
        if code == INTERRUPTED:
            # Typer turns Ctrl-C into this code.
            raise KeyboardInterrupt
        return code if isinstance(code, int) else 0
    except (BrokenPipeError, SystemExit):
        # The reader has gone, as with `| head` (typer turns a broken pipe into SystemExit). Keep the
        # interpreter from complaining about it when it flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return 141
    except KeyboardInterrupt:
        print("thinshell: interrupted.", file=sys.stderr)
        return INTERRUPTED
    except Exception as error:
        if debug:
            traceback.print_exc()
        text, code = _explain(error)
        print(f"thinshell: {_one_line(text)}", file=sys.stderr)
        return code


@contextmanager
def _warnings_in_words() -> Iterator[None]:
    """Warnings that are meant for users are said as a sentence, without the line of the program that gave them."""
    with warnings.catch_warnings():
        given = warnings.showwarning

        def show(
            message: Warning | str,
            category: type[Warning],
            filename: str,
            lineno: int,
            file: TextIO | None = None,
            line: str | None = None,
        ) -> None:
            if issubclass(category, UserWarning):
                warn(str(message))
            else:
                given(message, category, filename, lineno, file, line)

        warnings.showwarning = show
        yield


LISTS = ("--held-out",)
"""Options that take all the words behind them, up to the next option."""


def each_named(words: list[str]) -> list[str]:
    """The words of a command line with the option before each of its values: '--held-out a b' are two."""
    found: list[str] = []
    option = ""
    for index, word in enumerate(words):
        if word == "--":
            return found + words[index:]
        if word.startswith("-"):
            option = word if word in LISTS else ""
            found.append(word)
        else:
            found += [option, word] if option and found[-1] != option else [word]
    return found


def _explain(error: Exception) -> tuple[str, int]:
    """What to tell the user, and the exit code."""
    if isinstance(error, ThinshellError):
        return str(error), 2
    if hasattr(error, "format_message"):  # typer's usage errors: their base class has no public name
        where = getattr(getattr(error, "ctx", None), "command_path", "thinshell")
        return f"{str(error.format_message()).rstrip('.')}. Run '{where} --help' for the options.", 2
    if isinstance(error, ModuleNotFoundError):
        top = (error.name or "").partition(".")[0]
        if top and top not in OWN_PACKAGES:
            return f"The package {top!r} is not installed. Run 'thinshell doctor' to see what is missing.", 2
    if isinstance(error, OSError) and error.errno is not None:
        what = f"{error.filename}: " if error.filename else ""
        return f"{what}{error.strerror}. Look at the place, its rights and the room there is.", 2
    return f"This is a defect of the program: {type(error).__name__}: {error}. {REPORT}", 1


def _one_line(text: object) -> str:
    return " ".join(str(text).split())
