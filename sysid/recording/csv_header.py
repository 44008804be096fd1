"""What a column of a table holds, by its name: topic, component and unit, in the words of several programs.

``force_z [N]``, ``Force Z (N)``, ``Fz / N``; ``wrench.force_z [N]`` and ``marker_tracks.7.u [px]``, with the topic and
the number of a marker before the component; ``/wrench/wrench/force/z`` and ``__time`` as PlotJuggler writes them, in
SI units as messages of ROS have them; and any name that a rig maps to one of these.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.errors import nearest_match

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

_OTHER_UNITS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "millimeters": "mm", "meters": "m",
    "\N{DEGREE SIGN}": "deg", "degree": "deg", "degrees": "deg", "radians": "rad", "newton": "N", "newtons": "N",
    "pixel": "px", "pixels": "px", "Nm": "N m", "Nmm": "N mm", "mNm": "mN m", "Ncm": "N cm", "-": "1",
}  # fmt: skip
"""Other words for units."""

POSE = {"x": "length", "y": "length", "z": "length", "qx": "number", "qy": "number", "qz": "number", "qw": "number",
        "roll": "angle", "pitch": "angle", "yaw": "angle"}  # fmt: skip
WRENCH = {f"{kind}_{axis}": kind for kind in ("force", "torque") for axis in "xyz"}
TRACK = {"u": "pixel", "v": "pixel"}
MARKER = {axis: "length" for axis in "xyz"}
KINDS: dict[str, dict[str, str]] = {"pose": POSE, "wrench": WRENCH, "marker_tracks": TRACK, "markers": MARKER}
"""Components of each kind of topic, and what they measure."""

_TIMES = {"t", "time", "__time", "timestamp", "stamp", "elapsed_time", "elapsed", "test_time"}
_WORDS = {
    "": ("pos_", "position_"),
    "force_": ("f", "f_", "force"),
    "torque_": ("m", "m_", "torque", "moment_"),
    "q": ("q_", "quat_", "quaternion_", "orientation_"),
}
_ALIASES = {f"{word}{axis}": f"{own}{axis}" for own, words in _WORDS.items() for word in words for axis in "xyzw"}
_FIELDS = {
    "position": "{}",
    "translation": "{}",
    "orientation": "q{}",
    "rotation": "q{}",
    "force": "force_{}",
    "torque": "torque_{}",
}
"""Fields of messages of ROS with their components x, y, z and w."""
_MESSAGES = {"pose", "transform", "wrench"}
"""Fields that hold these."""
_BRACKETS = re.compile(r"^(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]$")
_EXAMPLES = [*POSE, *WRENCH, "marker_tracks.7.u", "markers.7.x"]


@dataclass(frozen=True)
class Column:
    """What a column holds: kind of topic ('time' of the times), topic, number of the marker (None of others),
    component, and its factor to SI units."""

    kind: str
    topic: str
    marker: int | None
    component: str
    factor: float

    @property
    def place(self) -> tuple[str, int | None, str]:
        """What no other column may hold."""
        return self.topic, self.marker, self.component

    def __str__(self) -> str:
        return ".".join(map(str, filter(lambda word: word is not None, self.place)))


class Unknown(ValueError):
    """A column that is nothing that is read, or has no unit that is known; its words say so."""


def column_of(cell: str, mapped: Mapping[str, str]) -> Column | None:
    """What the column of this name is; None for one that nobody reads: a field of a message of ROS that has no use, or
    a column that a rig with ``mapped`` names does not map.

    Raises:
        Unknown: it is not known, or its unit is not.
    """
    name, unit = _parted(cell)
    target = mapped.get(cell.strip(), mapped.get(name))
    if target is not None:
        meant, unit_meant = _parted(target)
        return _named(meant, unit_meant if unit_meant is not None else unit, cell)
    if "/" in name:
        return _of_ros(name, unit, cell)
    return _named(name, unit, cell) if not mapped or _known(name) else None


def is_time(cell: str, mapped: Mapping[str, str]) -> bool:
    """Whether a cell of a header names the times."""
    name, _ = _parted(cell)
    return _word(_parted(mapped.get(cell.strip(), mapped.get(name, name)))[0]) in _TIMES


def _parted(cell: str) -> tuple[str, str | None]:
    """Name and unit, None without one."""
    cell = cell.strip()
    if matched := _BRACKETS.match(cell):
        return matched["name"].strip(), matched["unit"].strip()
    name, slash, last = cell.rpartition("/")
    if slash and name.strip() and not name.strip().startswith("/") and _unit(last) in _ALL_UNITS:
        return name.strip(), last.strip()
    return cell, None


def _unit(text: str) -> str:
    found = " ".join(
        text.replace("\N{MIDDLE DOT}", " ")
        .replace("*", " ")
        .replace("\N{MICRO SIGN}", "u")
        .replace("\N{GREEK SMALL LETTER MU}", "u")
        .split()
    )
    return _OTHER_UNITS.get(found, _OTHER_UNITS.get(found.lower(), found))


_ALL_UNITS = {unit for units in UNITS.values() for unit in units} - {"", "1"}


def _word(name: str) -> str:
    return re.sub(r"[\s-]+", "_", name.strip()).lower()


def _known(name: str) -> bool:
    try:
        _named(name, None, name, judge_unit=False)
    except Unknown:
        return False
    return True


def _named(name: str, unit: str | None, cell: str, judge_unit: bool = True) -> Column:
    """A component, or ``topic.component``, or ``topic.number.component``."""
    if _word(name) in _TIMES:
        unit = "s" if name == "__time" and not unit else unit
        return Column("time", "", None, "", _factor(cell, "time", unit) if judge_unit else 1.0)
    *before, last = name.split(".")
    component = _word(last)
    component = _ALIASES.get(component, component)
    topic, marker = "/".join(word.strip() for word in before), None
    head, _, number = topic.rpartition("/")
    if re.fullmatch(r"[0-9]{1,9}", number):
        topic, marker = head, int(number)
    if not topic:
        topic = "current_pose" if component in POSE else "wrench"
    last_word = topic.rpartition("/")[2]
    kind = "pose" if last_word in ("current_pose", "target_pose") else last_word
    if component not in KINDS.get(kind, {}) or (kind in ("marker_tracks", "markers")) != (marker is not None):
        axes = [c for c in _EXAMPLES if c.startswith(f"{component}_")]
        remedy = f"Is it {', '.join(axes[:-1])} or {axes[-1]}?" if axes else nearest_match(component, _EXAMPLES)
        raise Unknown(f"the column {cell!r} is not known. {remedy}")
    return Column(kind, topic, marker, component, _factor(cell, KINDS[kind][component], unit) if judge_unit else 1.0)


def _of_ros(name: str, unit: str | None, cell: str) -> Column | None:
    """A field of a message of ROS, as ``/topic/wrench/force/x``; None for others."""
    words = name.strip("/").split("/")
    if len(words) < 3 or words[-2] not in _FIELDS or words[-1] not in tuple("xyzw"):
        return None
    component = _FIELDS[words[-2]].format(words[-1])
    kind = "wrench" if words[-2] in ("force", "torque") else "pose"
    topic = words[:-2]
    while len(topic) > 1 and topic[-1] in _MESSAGES:
        topic = topic[:-1]
    if component not in KINDS[kind]:
        return None
    quantity = KINDS[kind][component]
    return Column(kind, "/".join(topic), None, component, 1.0 if unit is None else _factor(cell, quantity, unit))


def _factor(cell: str, quantity: str, unit: str | None) -> float:
    known = UNITS[quantity]
    found = _unit(unit or "")
    if found not in known:
        raise Unknown(
            f"the column {cell!r} has {f'the unit {unit!r}' if unit else 'no unit'}. Write one of these in brackets "
            f"behind its name: {', '.join(filter(None, known))}."
        )
    return known[found]
