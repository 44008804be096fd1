"""Recordings as users name them: whole ones, and windows of them such as ``session.bag@12.5:20``."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sim_core.errors import ConfigError, RecordingError


@dataclass(frozen=True)
class Part:
    """A recording, or its readings from ``begin`` until before ``end`` [s] after its start."""

    path: Path
    begin: float = 0.0
    end: float = math.inf

    @property
    def whole(self) -> bool:
        return self.begin == 0.0 and self.end == math.inf

    def overlaps(self, other: Part) -> bool:
        """Whether the two windows have times in common."""
        return self.begin < other.end and other.begin < self.end


def part_of(path: Path) -> Part:
    """The recording, or the window of it, that a user names. Raises ``ConfigError``."""
    name, _, window = str(path).rpartition("@")
    if path.exists() or not name or not Path(name).exists():
        return Part(path)
    begin, colon, end = window.partition(":")
    try:
        part = Part(Path(name), float(begin), float(end))
    except ValueError:
        part = Part(Path(name), math.inf)
    if not colon or not 0.0 <= part.begin < part.end < math.inf:
        raise ConfigError(f"{path} names no window of {name}.", f"Write for example {name}@12.5:20, in seconds.")
    return part


def recording_of(name: str) -> str:
    """Name of the recording that a window is of; of a whole one its own."""
    return re.sub(r"@[0-9.e+-]+:[0-9.e+-]+$", "", name)


def check_parts(given: Iterable[Path], held_out: Iterable[Path] = ()) -> None:
    """Recordings exist, and no reading is named twice. Raises ``RecordingError`` and ``ConfigError``."""
    seen: list[tuple[Part, str]] = []
    for path, role in [*((bag, "given") for bag in given), *((bag, "held out") for bag in held_out)]:
        part = part_of(path)
        if not part.path.exists():
            raise RecordingError(
                f"The recording {part.path} does not exist.",
                "Check the path; of a window, BAG@12.5:20, what stands before the last '@'.",
            )
        for other, known in seen:
            if part.path.resolve() == other.path.resolve() and part.overlaps(other):
                raise given_again(part, role, other, known)
        seen.append((part, role))


def given_again(part: Part, role: str, other: Part, known: str) -> RecordingError:
    """What is said where ``part`` is given as ``role`` and has readings of ``other``, which is as ``known``."""
    both = "twice" if known == role else "both to use and to hold out"
    copy = "" if part.path.resolve() == other.path.resolve() else f", which has readings of {other.path},"
    if part.whole and other.whole:
        return RecordingError(f"The recording {part.path}{copy} is given {both}.", "Name every recording once.")
    begin, end = max(part.begin, other.begin), min(part.end, other.end)
    return RecordingError(
        f"Of {part.path}{copy} the readings from {begin:g} to {end:g} s are given {both}.",
        "Let one window end where the other begins.",
    )
