"""Tables of laboratories without ROS: CSV files with named columns and units, written as a recording.

The names of the columns are the time and the readings, each with its unit (:mod:`sysid.recording.csv_header`)::

    time [s], x [mm], force_z [N], wrench.torque_x [N mm], marker_tracks.7.u [px], marker_tracks.7.v [px]

A name is a component, or ``topic.component``; markers have their number between the two. Components: ``x y z``
(position), ``qx qy qz qw`` or ``roll pitch yaw`` (turn) of ``current_pose``; ``force_x`` to ``torque_z`` of
``wrench``; ``u v`` of ``marker_tracks`` and ``x y z`` of ``markers``, by number. Names of another program are mapped to
these in the rig (``table_columns``). Empty cells are readings that are missing. Several files of one folder share one
clock. Columns may be parted by commas, semicolons (then with decimal commas or points) or tabs, and lines may end with
one; text may be UTF-8, UTF-16 or Latin 1; lines that begin with #, and those before the line of names, are remarks;
units may be a line of their own below the names.
"""

from __future__ import annotations

import csv
import datetime
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import RecordingError
from sysid.recording.arrays import Floats
from sysid.recording.csv_header import MARKER, TRACK, WRENCH, Column, Unknown, column_of, is_time
from sysid.recording.formats import encoding_of
from sysid.recording.notes import plural
from sysid.recording.writer import RecordingWriter

_START_S, _LATEST_S = 1e6, 2e9
"""Stamp [s] of time 0, so that times before it have one, and the latest time."""
_LARGEST = 1 << 29
"""Bytes of a table that are read."""
_MISSING = {"", "nan", "na", "n/a", "#n/a", "-", "--", "null", "none"}
"""Cells without a reading."""
_LISTED = 6
"""Faults of a table that are listed."""
_PREAMBLE = 100
"""Lines in which the line of names is looked for."""


def write_table(
    path: Path, out: Path, shown: Path, mapped: Mapping[str, str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Write a CSV file as a recording ``out``, which must not exist. Returns what was assumed and what else is to be
    said of it, in words.

    Args:
        path: the file.
        out: the recording.
        shown: the path to name in messages.
        mapped: by names of columns of the file, what they are, as ``wrench.force_z`` or ``wrench.force_z [mN]``.

    Raises:
        RecordingError: a file is no such table; the message names all that is wrong, with columns and lines.
    """
    table = _Table(path, shown, mapped)
    t, columns = table.read()
    assumed: list[str] = []
    if t.min() < -_START_S or t.max() > _LATEST_S:
        raise RecordingError(
            f"{shown}: the times go from {t.min():g} to {t.max():g} s.",
            "Count them from the start of the recording, and check their unit.",
        )
    with RecordingWriter(out) as bag:
        stamps = [round(1e9 * (_START_S + float(value))) for value in t]
        for topic in dict.fromkeys(column.topic for column in columns):
            mine = {c: values for c, values in columns.items() if c.topic == topic}
            kind = next(iter(mine)).kind
            if kind == "pose":
                assumed += _poses(bag, topic, stamps, {c.component: v for c, v in mine.items()})
            elif kind == "wrench":
                _wrenches(bag, topic, stamps, {c.component: v for c, v in mine.items()})
            else:
                _markers(bag, topic, kind, stamps, mine)
    return tuple(assumed), tuple(table.remarks)


class _Table:
    """One file while it is read. ``faults``: what is wrong, ``remarks``: what is harmless, in words."""

    def __init__(self, path: Path, shown: Path, mapped: Mapping[str, str]) -> None:
        self.path, self.shown, self.mapped = path, shown, mapped
        self.faults: list[str] = []
        self.unnamed = False
        """Whether a column has no name that is known."""
        self.remarks: list[str] = []

    def read(self) -> tuple[Floats, dict[Column, Floats]]:
        """Times [s] ``(n,)`` and columns ``(n,)``, SI units."""
        lines = self._lines()
        separator, names, rows = self._parted(lines)
        columns = self._columns(names)
        rows = self._even(rows, names, separator)
        time_at = next((k for k, column in columns.items() if column.kind == "time"), None)
        if time_at is None:
            shown = ", ".join(names[:8])
            self.unnamed = True
            self.faults.append(f"it has no column of times among {shown}. Name it with its unit, as in time [s]")
        values = {k: self._numbers(names[k], column, k, rows) for k, column in columns.items()}
        if time_at is not None:
            without = np.isnan(values[time_at])
            if without.any() and not self.faults:
                first = rows[int(np.argmax(without))][0]
                self.faults.append(f"line {first} has no time" + _more(int(without.sum())))
        self._refuse()
        assert time_at is not None
        t = columns[time_at].factor * values[time_at]
        return t, {column: column.factor * values[k] for k, column in columns.items() if k != time_at}

    def _refuse(self) -> None:
        if not self.faults:
            return
        shown = "; ".join(f.rstrip(".") for f in self.faults[:_LISTED])
        rest = f"; and {len(self.faults) - _LISTED} more" if len(self.faults) > _LISTED else ""
        raise RecordingError(
            f"{self.shown}: {shown}{rest}.",
            "Correct the table, or say in the rig what its columns are: table_columns: {NAME: wrench.force_z}."
            if self.unnamed
            else "Correct the table.",
        )

    def _lines(self) -> list[tuple[int, str]]:
        """The lines that are no remarks, with their numbers in the file."""
        size = self.path.stat().st_size
        if size > _LARGEST:
            raise RecordingError(f"{self.shown} has {size} bytes.", f"Split it: at most {_LARGEST} are read.")
        raw = self.path.read_bytes()
        encoding = encoding_of(raw)
        try:
            text = raw.decode(encoding)
        except UnicodeDecodeError:
            text = raw.decode(encoding, errors="replace") if encoding.startswith("utf-16") else raw.decode("latin-1")
        numbered = enumerate(text.lstrip("\ufeff").splitlines(), start=1)
        lines = [(k, line) for k, line in numbered if line.strip() and not line.lstrip().startswith("#")]
        if len(lines) < 2:
            raise RecordingError(
                f"{self.shown} has no header line and readings.", "Write a line of names, as in time [s], x [mm]."
            )
        return lines

    def _parted(self, lines: list[tuple[int, str]]) -> tuple[str, list[str], list[tuple[int, list[str]]]]:
        """Separator, names of the columns, and the rows with their lines."""
        separator, begin = _separator(lines[0][1]), 0
        for k, (_, line) in enumerate(lines[:_PREAMBLE]):
            mark = _separator(line)
            if any(is_time(cell, self.mapped) for cell in _cells(line, mark)):
                separator, begin = mark, k
                break
        try:
            parsed = [(number, next(csv.reader([line], delimiter=separator))) for number, line in lines[begin:]]
        except csv.Error as error:
            raise RecordingError(f"{self.shown} is no CSV table: {error}.", "Save it as CSV again.") from error
        names = [name.strip() for name in parsed[0][1]]
        rows = parsed[1:]
        if rows and not any(name.endswith(("]", ")")) for name in names) and (units := _units(rows[0][1])):
            names = [
                f"{n} [{u}]" if u and n else n for n, u in zip(names, [*units, *names[len(units) :]], strict=False)
            ]
            rows = rows[1:]
        return separator, names, rows

    def _columns(self, names: Sequence[str]) -> dict[int, Column]:
        """What each column is, but for those that nobody reads."""
        columns: dict[int, Column] = {}
        unread = []
        for k, name in enumerate(names):
            if not name:
                continue
            try:
                column = column_of(name, self.mapped)
            except Unknown as error:
                self.unnamed = True
                self.faults.append(str(error))
                continue
            if column is None:
                unread.append(name)
            elif any(column.place == other.place for other in columns.values()):
                self.faults.append(f"it has {column if column.kind != 'time' else 'the time'} twice: {name!r}")
            else:
                columns[k] = column
        if unread:
            more = f" and {len(unread) - _LISTED} more" if len(unread) > _LISTED else ""
            self.remarks.append(f"columns not read: {', '.join(unread[:_LISTED])}{more}")
        return columns

    def _even(
        self, rows: Sequence[tuple[int, list[str]]], names: list[str], separator: str
    ) -> list[tuple[int, list[str]]]:
        """Rows with as many cells as there are names: a separator at the end of a line ends it, and begins no cell."""
        width = max((k + 1 for k, name in enumerate(names) if name), default=0)
        even, long = [], []
        for number, row in rows:
            filled = max((k + 1 for k, cell in enumerate(row) if cell.strip()), default=0)
            if filled > width:
                long.append((number, row))
            even.append((number, [*row[:width], *[""] * (width - len(row))]))
        if long:
            number, row = long[0]
            words = f"line {number} has {len(row)} cells, the header {width}: {separator.join(row)[:60]!r}"
            if separator == "," and all(len(row) > width for _, row in long) and 2 * len(long) > len(rows):
                words += (
                    ": commas part the columns and the decimals. Save it with semicolons or tabs between columns, or "
                    "with decimal points"
                )
            else:
                words += ". Give each column a name"
            self.faults.append(words + _more(len(long)))
        return even

    def _numbers(self, name: str, column: Column, k: int, rows: Sequence[tuple[int, list[str]]]) -> Floats:
        """The cells of a column as numbers, NaN where there is none."""
        values = np.full(len(rows), np.nan)
        cells = [row[k].strip() if k < len(row) else "" for _, row in rows]
        points = any("." in cell for cell in cells)
        wrong = []
        for at, cell in enumerate(cells):
            if cell.lower() in _MISSING:
                continue
            try:
                values[at] = _number(cell, points, column.kind == "time")
            except ValueError:
                wrong.append(at)
        if wrong and not any(f.startswith("line") and "cells, the header" in f for f in self.faults):
            self.faults.append(
                f"line {rows[wrong[0]][0]} has {cells[wrong[0]][:40]!r} for {name!r}" + _more(len(wrong))
                + ". Write a number, or leave the cell empty"
            )  # fmt: skip
        return values


def _more(count: int) -> str:
    return f" ({plural(count, 'such line')})" if count > 1 else ""


def _separator(line: str) -> str:
    return next((mark for mark in ("\t", ";", ",") if mark in line), ",")


def _cells(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator))
    except csv.Error:
        return []


def _units(row: Iterable[str]) -> list[str]:
    """The units of a line of units, empty for a line of anything else."""
    cells = [cell.strip() for cell in row]
    if not any(cells) or any(any(mark.isdigit() for mark in cell) for cell in cells):
        return []
    if any(cell.lower() in _MISSING - {""} for cell in cells):
        return []
    return [cell.strip("[]()") for cell in cells]


def _number(cell: str, points: bool, is_date: bool) -> float:
    """A number with a decimal point or a decimal comma, or a date as seconds since 1970."""
    if "," in cell and (points or cell.count(",") > 1):
        raise ValueError(cell)  # of which of the two parts thousands nobody knows
    try:
        value = float(cell.replace(",", "."))
    except ValueError:
        if not is_date:
            raise
        at = datetime.datetime.fromisoformat(cell.replace("Z", "+00:00"))
        value = (at if at.tzinfo else at.replace(tzinfo=datetime.timezone.utc)).timestamp()
    if not np.isfinite(value):
        raise ValueError(cell)
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
    bag: RecordingWriter, topic: str, kind: str, stamps: Sequence[int], columns: Mapping[Column, Floats]
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
