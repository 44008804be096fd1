"""Trajectories as files: JSON in UTF-8, one object with the keys of :class:`~sim_core.trajectories.model.Trajectory`.

docs/trajectories.md describes the format for those who read it without this package.
"""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from sim_core.errors import ConfigError
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories.model import VERSION, Trajectory

MAX_BYTES = 1_000_000_000

_REMAKE = "Make one with 'thinshell trajectory RIG EXPERIMENT --out FILE'."


def write_trajectory(path: Path | str, trajectory: Trajectory) -> None:
    """Write a trajectory to a new file, whole or not at all.

    Raises:
        ConfigError: the file exists, or cannot be written.
    """
    path = Path(path)
    if os.path.lexists(path):
        raise ConfigError(f"{path} already exists.", "Name a new file; nothing is overwritten.")
    text = _text(trajectory.model_dump(mode="json", exclude_none=True), "")
    part = path.with_name(f".{path.name}.unfinished")
    try:
        part.write_text(text + "\n", "utf-8")
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise ConfigError(f"{path} cannot be written: {error.strerror}.", "Check the folder.") from None


def read_trajectory(path: Path | str) -> Trajectory:
    """Read and check a trajectory file.

    Raises:
        ConfigError: there is no such file, it is no trajectory, it is of a later version, or something in it does not
            fit; the message names the place in the file.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise ConfigError(f"{path} is a folder, and a trajectory is one JSON file.", "Name the file inside it.")
        if path.exists() and not path.is_file():
            raise ConfigError(f"{path} is neither a file nor a folder.", "Name a trajectory file.")
        if (size := path.stat().st_size) > MAX_BYTES:
            raise ConfigError(f"{path} has {size} bytes, more than {MAX_BYTES}.", "Leave the predicted markers out.")
        text = path.read_text("utf-8")
    except FileNotFoundError:
        raise ConfigError(f"{path} does not exist.", "Check the path of the trajectory.") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path} is not a text file in UTF-8, and a trajectory is JSON.", _REMAKE) from None
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}.", "Check the path and its permissions.") from None
    return parse_trajectory(text, str(path))


def parse_trajectory(text: str, source: str) -> Trajectory:
    """A trajectory from the text of a file; ``source`` names it in errors. Raises ``ConfigError``."""

    def refuse(word: str) -> NoReturn:
        raise ConfigError(f"{source} holds {word}, which is not a finite number.", "Write numbers only.")

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        data = dict(pairs)
        if len(data) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise ConfigError(f"{source} gives the key {twice!r} twice.", "Keep one of the two.")
        return data

    try:
        data = json.loads(text, parse_constant=refuse, object_pairs_hook=once)
    except json.JSONDecodeError as error:
        raise ConfigError(
            f"{source} is not JSON: {error.msg} in line {error.lineno}, column {error.colno}.",
            f"A file that was cut short ends so. {_REMAKE}",
        ) from None
    except (RecursionError, ValueError) as error:
        raise ConfigError(f"{source} is not a trajectory: {' '.join(str(error).split())}.", _REMAKE) from None
    if not isinstance(data, dict) or data.get("format") != "thinshell_trajectory":
        raise ConfigError(f'{source} is no trajectory: it has no "format": "thinshell_trajectory".', _REMAKE)
    version = data.get("version")
    if isinstance(version, int) and version > VERSION:
        raise ConfigError(
            f"{source} has version {version} of the format, and this release reads versions up to {VERSION}.",
            "Install a newer release, or write the file with an older one.",
        )
    for key in ("version", "units", "quaternion_order"):
        if key not in data:
            raise ConfigError(f"{source}: {key} is missing.", "The reader must not guess it; docs/trajectories.md.")
    return validate(Trajectory, data, source)


def write_csv(path: Path | str, trajectory: Trajectory, end_effector: str) -> None:
    """Write the poses of one end effector as a table: time_s, x_m, y_m, z_m, qx, qy, qz, qw, gripper_closing_m if any.

    Raises:
        ConfigError: there is no such end effector, the file exists, or it cannot be written.
    """
    path = Path(path)
    if end_effector not in trajectory.end_effectors:
        known = ", ".join(trajectory.end_effectors)
        raise ConfigError(f"The trajectory moves no end effector {end_effector!r}.", f"It moves {known}.")
    effector = trajectory.end_effectors[end_effector]
    columns = [trajectory.times_s[:, None], effector.positions_m, effector.quaternions_xyzw]
    names = ["time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"]
    if effector.gripper_closing_m is not None:
        columns.append(effector.gripper_closing_m[:, None])
        names.append("gripper_closing_m")
    try:
        with path.open("x", encoding="utf-8", newline="") as file:
            table = csv.writer(file)
            table.writerow(names)
            table.writerows(np.hstack(columns).tolist())
    except FileExistsError:
        raise ConfigError(f"{path} already exists.", "Name a new file; nothing is overwritten.") from None
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}.", "Check the folder.") from None


def _text(value: Any, indent: str) -> str:
    """JSON with one key, or one row of an array, a line."""
    deeper = indent + "  "
    if isinstance(value, dict) and value:
        lines = [f"{json.dumps(key)}: {_text(item, deeper)}" for key, item in value.items()]
    elif isinstance(value, list) and value and isinstance(value[0], list):
        lines = [json.dumps(row, allow_nan=False) for row in value]
    else:
        return json.dumps(value, allow_nan=False, ensure_ascii=False)
    open_, close = "{}" if isinstance(value, dict) else "[]"
    return f"{open_}\n{deeper}" + f",\n{deeper}".join(lines) + f"\n{indent}{close}"
