"""Arguments and checks that several subcommands share. Everything is checked before anything is written."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from sim_core.errors import ConfigError, RecordingError, ThinshellError
from sysid.cli.bounds import whole_number
from sysid.io.atomic_folder import CHECKPOINTS, UNFINISHED
from sysid.observations.selection import part_of

RigArgument = Annotated[
    str, typer.Argument(metavar="RIG", help="Rig or overlay: a name from 'thinshell rigs' or a YAML file.")
]
BagsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="BAG...", help="Recordings: rosbag2 folders or single files; or windows of them, BAG@12.5:20, in s."
    ),
]
HeldOutOption = Annotated[
    list[Path] | None,
    typer.Option("--held-out", metavar="BAG...", help="Recordings kept for the check, one or several."),
]
ExperimentsArgument = Annotated[
    list[str],
    typer.Argument(metavar="EXPERIMENT...", help="Experiments: names from 'thinshell rigs' or YAML files."),
]
ParamsOption = Annotated[
    str, typer.Option("--params", metavar="A,B", help="Parameters to determine, as 'thinshell params' lists them.")
]
FolderOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="New folder for the results.")]
NuisanceOption = Annotated[
    str,
    typer.Option(
        "--nuisance",
        metavar="A,B",
        help="What is estimated as well: time (offset of each stream), bias (of wrenches), camera (scale and centre), "
        "pose (offset of each end effector); all, or none.",
    ),
]
WithoutOption = Annotated[
    list[str] | None,
    typer.Option("--without", metavar="NAME", help="Sensor or camera that is not used; may be repeated."),
]
DespiteOption = Annotated[
    list[str] | None,
    typer.Option(
        "--despite",
        metavar="FINDING",
        help="Go on where 'thinshell inspect --rig' says that this finding stops a fit; may be repeated.",
    ),
]
FreshBodiesOption = Annotated[
    bool,
    typer.Option(
        "--fresh-bodies",
        help="Each recording shows bodies of its own: what yields or softens in one is new in the next. Otherwise "
        "recordings show the same bodies in the order of their stamps.",
    ),
]
ClusterOption = Annotated[
    str,
    typer.Option(
        "--cluster",
        metavar="ADDRESS",
        help="Make rollouts on the workers of a dask scheduler (tcp://HOST:PORT), or in processes here (local), in "
        "place of threads.",
    ),
]
SeedOption = Annotated[int, whole_number("--seed", "Seed of everything random.", 0)]


def parse_settings(settings: Sequence[str]) -> dict[str, float]:
    """Values from ``name=value`` words."""
    values: dict[str, float] = {}
    for word in settings:
        name, sign, text = word.partition("=")
        name = name.strip()
        if not sign or not name:
            raise ConfigError(f"--set {word!r} is not of the form name=value.", "Write for example --set card.E=1e9.")
        try:
            value = float(text)
        except ValueError:
            raise ConfigError(
                f"--set {word!r}: {text!r} is not a number.", "Write for example --set card.E=1e9."
            ) from None
        if not math.isfinite(value):
            raise ConfigError(f"--set {word!r}: the value is not finite.", "Write a finite number.")
        if name in values:
            raise ConfigError(f"--set gives {name!r} twice.", "Keep one of the two.")
        values[name] = value
    return values


def parse_pairs(words: Sequence[str], option: str, sign: str) -> dict[str, tuple[float, float]]:
    """Pairs of numbers from words ``name=first<sign>second``."""
    example = f"Write for example {option} card.E={'2e9+-1e8' if sign == '+-' else '1e9..5e9'}."
    pairs: dict[str, tuple[float, float]] = {}
    for word in words:
        name, _, text = word.partition("=")
        first, between, second = text.partition(sign)
        if not (name.strip() and between):
            raise ConfigError(f"{option} {word!r} is not of the form name=number{sign}number.", example)
        try:
            pair = float(first), float(second)
        except ValueError:
            raise ConfigError(f"{option} {word!r}: {text!r} is not two numbers.", example) from None
        if name.strip() in pairs:
            raise ConfigError(f"{option} names {name.strip()!r} twice.", "Keep one of the two.")
        pairs[name.strip()] = pair
    return pairs


def parse_names(text: str, option: str, example: str = "card.E,gel.E") -> list[str]:
    """Names from a comma-separated list."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ConfigError(f"{option} {text!r} holds an empty name.", f"Write for example {option} {example}.")
    return names


def parse_nuisance(text: str) -> list[str]:
    """Kinds of nuisances from a comma-separated list."""
    from sysid.model.nuisance_parameters import checked_kinds

    return sorted(checked_kinds(parse_names(text, "--nuisance", "time,bias"))) or ["none"]


def check_bag(path: Path) -> None:
    """A whole recording exists."""
    part = part_of(path)
    if not part.whole:
        raise ConfigError(f"{path} is a window of {part.path}, and a whole recording is wanted.", f"Name {part.path}.")
    if not path.exists():
        raise RecordingError(f"The recording {path} does not exist.", "Check the path.")


def check_new(path: Path, what: str, resumable: bool = False) -> None:
    """A place to write that does not exist yet or is empty but for what a killed process left; not below a file.
    ``resumable``: also a folder with stages of results that are not finished, from which the command goes on."""
    left = {UNFINISHED}
    if resumable and (path / CHECKPOINTS).is_dir():
        left |= {CHECKPOINTS, "report.html"}
    if path.exists() and not (path.is_dir() and all(found.name in left for found in path.iterdir())):
        raise ConfigError(f"The {what} {path} already exists.", "Name a new one with --out; nothing is overwritten.")
    parent = path.absolute().parent
    while not parent.exists():
        parent = parent.parent
    if not parent.is_dir():
        raise ConfigError(f"The {what} {path} cannot be made: {parent} is a file.", "Name another place with --out.")


def library(module: str, function: str) -> Callable[..., Any]:
    """A library function, imported only now so that every command starts fast."""
    try:
        return getattr(importlib.import_module(module), function)  # type: ignore[no-any-return]
    except ModuleNotFoundError as error:
        if error.name is None or not module.startswith(error.name):
            raise
    raise ThinshellError(f"This installation has no {module}.{function}.", "Install the package again.")
