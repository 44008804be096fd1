"""Tables of laboratories without ROS: CSV files with named columns and units, written as a recording.

The first columns that are named so are the time and the readings, each with its unit in brackets::

    time [s], x [mm], force_z [N], wrench.torque_x [N mm], marker_tracks.7.u [px], marker_tracks.7.v [px]

A name is a component, or ``topic.component``; markers have their number between the two. Components: ``x y z``
(position), ``qx qy qz qw`` or ``roll pitch yaw`` (turn) of ``current_pose``; ``force_x`` to ``torque_z`` of ``wrench``;
``u v`` of ``marker_tracks`` and ``x y z`` of ``markers``, by number. Empty cells are readings that are missing. Several
files of one folder share one clock. Columns may be parted by commas, semicolons (then with decimal commas or points) or
tabs; lines that begin with # are remarks.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import RecordingError, nearest_match
from sysid.recording.arrays import Floats
from sysid.recording.writer import RecordingWriter

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "angle": {"rad": 1.0, "deg": np.pi / 180.0},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "kgf": 9.80665, "lbf": 4.4482216152605},
    "torque": {"N m": 1.0, "N mm": 1e-3, "mN m": 1e-3, "N cm": 1e-2, "kgf cm": 9.80665e-2},
    "pixel": {"px": 1.0},
    "number": {"": 1.0, "1": 1.0},
}
"""Factors to SI units and px."""

POSE = {"x": "length", "y": "length", "z": "length", "qx": "number", "qy": "number", "qz": "number", "qw": "number",
        "roll": "angle", "pitch": "angle", "yaw": "angle"}  # fmt: skip
WRENCH = {f"{kind}_{axis}": kind for kind in ("force", "torque") for axis in "xyz"}
TRACK = {"u": "pixel", "v": "pixel"}
MARKER = {axis: "length" for axis in "xyz"}

_POSES = ("current_pose", "target_pose")
_COLUMN = re.compile(r"^(?P<name>[^\[\]()]*?)\s*(?:[\[(](?P<unit>[^\[\]()]*)[\])])?$")
_START_S, _LATEST_S = 1e6, 2e9
"""Stamp [s] of time 0, so that times before it have one, and the latest time."""
_LARGEST = 1 << 29
"""Bytes of a table that are read."""


@dataclass(frozen=True)
class _Column:
    """Where a column belongs: topic, number of the marker (None of others), component."""

    topic: str
    marker: int | None
    component: str
    factor: float


def write_table(path: Path, out: Path) -> tuple[str, ...]:
    """Write a CSV file as a recording ``out``, which must not exist. Returns what was assumed, in words.

    Raises:
        RecordingError: a file is no such table; the message names file, column and line.
    """
    t, columns = _read(path)
    if t.min() < -_START_S or t.max() > _LATEST_S:
        raise RecordingError(
            f"{path}: the times go from {t.min():g} to {t.max():g} s.", "Count them from the start of the recording."
        )
    assumed: list[str] = []
    with RecordingWriter(out) as bag:
        stamps = [round(1e9 * (_START_S + float(value))) for value in t]
        for topic in dict.fromkeys(column.topic for column in columns):
            mine = {c: values for c, values in columns.items() if c.topic == topic}
            kind = topic.rpartition("/")[2]
            if kind in _POSES:
                assumed += _poses(bag, topic, stamps, {c.component: v for c, v in mine.items()})
            elif kind == "wrench":
                _wrenches(bag, topic, stamps, {c.component: v for c, v in mine.items()})
            else:
                _markers(bag, topic, kind, stamps, mine)
    return tuple(assumed)


def _read(path: Path) -> tuple[Floats, dict[_Column, Floats]]:
    """Times [s] ``(n,)`` and columns ``(n,)``, SI units, of one file."""
    if path.stat().st_size > _LARGEST:
        raise RecordingError(f"{path} has {path.stat().st_size} bytes.", f"Split it: at most {_LARGEST} are read.")
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("latin-1")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if len(lines) < 2:
        raise RecordingError(
            f"{path} has no header line and readings.", "Write a line of names, as in time [s], x [mm]."
        )
    separator = next((mark for mark in ("\t", ";", ",") if mark in lines[0]), ",")
    try:
        rows = list(csv.reader(lines, delimiter=separator))
    except csv.Error as error:
        raise RecordingError(f"{path} is no CSV table: {error}.", "Save it as CSV again.") from error
    header = [name.strip() for name in rows[0]]
    time_at, factor = _time(path, header)
    places = [_column(path, name) if k != time_at else None for k, name in enumerate(header)]
    doubled = next((c for k, c in enumerate(places) if c is not None and _alike(c, places[:k])), None)
    if doubled is not None:
        raise RecordingError(f"{path} has {doubled.topic}.{doubled.component} twice.", "Keep one of the two columns.")
    values = np.full((len(rows) - 1, len(header)), np.nan)
    for k, row in enumerate(rows[1:]):
        if len(row) > len(header):
            raise RecordingError(
                f"{path}: line {k + 2} has {len(row)} cells, the header {len(header)}.", "Give each column a name."
            )
        for c, cell in enumerate(row):
            values[k, c] = _number(path, header[c], k + 2, cell, separator)
    if np.isnan(values[:, time_at]).any():
        line = int(np.argmax(np.isnan(values[:, time_at]))) + 2
        raise RecordingError(f"{path}: line {line} has no time.", "Give each reading its time.")
    t = factor * values[:, time_at]
    return t, {c: c.factor * values[:, k] for k, c in enumerate(places) if c is not None}


def _time(path: Path, header: Sequence[str]) -> tuple[int, float]:
    for k, name in enumerate(header):
        matched = _COLUMN.match(name)
        if matched and matched["name"].strip().lower() in ("t", "time"):
            return k, _factor(path, name, "time", matched["unit"])
    raise RecordingError(
        f"{path} has no column of times among {', '.join(header[:8])}.", "Name it with its unit, as in time [s]."
    )


def _column(path: Path, name: str) -> _Column:
    matched = _COLUMN.match(name)
    words = (matched["name"].strip() if matched else name).split(".")
    component = words[-1].strip()
    topic = ".".join(words[:-1]).strip().replace(".", "/")
    marker = None
    head, _, last = topic.rpartition("/")
    if re.fullmatch(r"[0-9]{1,9}", last):
        topic, marker = head, int(last)
    if not topic:
        topic = "current_pose" if component in POSE else "wrench"
    kind = topic.rpartition("/")[2]
    numbered = {"marker_tracks": TRACK, "markers": MARKER}
    kinds = POSE if kind in _POSES else WRENCH if kind == "wrench" else numbered.get(kind, {})
    if component not in kinds or (kind in numbered) != (marker is not None):
        known = [*POSE, *WRENCH, "marker_tracks.7.u", "markers.7.x"]
        raise RecordingError(f"{path}: the column {name!r} is not known.", nearest_match(component, known))
    return _Column(
        topic, marker, component, _factor(path, name, kinds[component], matched["unit"] if matched else None)
    )


def _factor(path: Path, name: str, quantity: str, unit: str | None) -> float:
    known = UNITS[quantity]
    found = (unit or "").strip().replace("·", " ").replace("*", " ").replace("µ", "u")
    if found not in known:
        raise RecordingError(
            f"{path}: the column {name!r} has " + (f"the unit {found!r}." if found else "no unit."),
            f"Write one of these in brackets behind its name: {', '.join(filter(None, known))}.",
        )
    return known[found]


def _alike(column: _Column, others: Sequence[_Column | None]) -> bool:
    place = (column.topic, column.marker, column.component)
    return any(o is not None and (o.topic, o.marker, o.component) == place for o in others)


def _number(path: Path, column: str, line: int, cell: str, separator: str) -> float:
    text = cell.strip()
    if not text or text.lower() in ("nan", "na", "-", "null"):
        return np.nan
    try:
        value = float(text.replace(",", ".") if separator != "," else text)
    except ValueError:
        raise RecordingError(
            f"{path}: line {line} has {text[:40]!r} for {column!r}.", "Write a number, or leave the cell empty."
        ) from None
    if np.isinf(value):
        raise RecordingError(f"{path}: line {line} has {text!r} for {column!r}.", "Leave the cell empty.")
    return value


def _poses(bag: RecordingWriter, topic: str, stamps: Sequence[int], columns: Mapping[str, Floats]) -> list[str]:
    none = np.zeros(len(stamps))
    position = np.column_stack([columns.get(axis, none) for axis in "xyz"])
    if any(name in columns for name in ("roll", "pitch", "yaw")):
        angles = np.column_stack([columns.get(name, none) for name in ("roll", "pitch", "yaw")])
        seen = np.isfinite(angles).all(axis=1)
        turn = np.full((len(stamps), 4), np.nan)
        turn[seen] = Rotation.from_euler("xyz", angles[seen]).as_quat()
    else:
        turn = np.column_stack([columns.get(name, none) for name in ("qx", "qy", "qz")])
        turn = np.column_stack([turn, columns.get("qw", none + 1.0)])
        turn = turn / np.where(length := np.linalg.norm(turn, axis=1, keepdims=True), length, np.nan)
    for k in np.flatnonzero(np.isfinite(position).all(axis=1) & np.isfinite(turn).all(axis=1)).tolist():
        bag.pose(topic, stamps[k], position[k], turn[k], "")
    absent = [axis for axis in "xyz" if axis not in columns]
    return [f"{topic}: {', '.join(absent)} not in the table, taken as 0"] if absent else []


def _wrenches(bag: RecordingWriter, topic: str, stamps: Sequence[int], columns: Mapping[str, Floats]) -> None:
    missing = np.full(len(stamps), np.nan)
    values = np.column_stack([columns.get(name, missing) for name in WRENCH])
    for k in np.flatnonzero(np.isfinite(values).any(axis=1)).tolist():
        bag.wrench(topic, stamps[k], values[k, :3], values[k, 3:], "")


def _markers(
    bag: RecordingWriter, topic: str, kind: str, stamps: Sequence[int], columns: Mapping[_Column, Floats]
) -> None:
    axes = list(TRACK if kind == "marker_tracks" else MARKER)
    ids = sorted({column.marker for column in columns if column.marker is not None})
    places = np.full((len(stamps), len(ids), len(axes)), np.nan)
    for column, values in columns.items():
        assert column.marker is not None
        places[:, ids.index(column.marker), axes.index(column.component)] = values
    for k in np.flatnonzero(np.isfinite(places).all(axis=2).any(axis=1)).tolist():
        if kind == "marker_tracks":
            bag.tracks(topic, stamps[k], places[k], ids, np.ones(len(ids)), "")
        else:
            rest = np.nan_to_num(places[0])
            bag.markers(topic, stamps[k], places[k], rest, ids, "")
