"""Recordings as users name them: whole ones, and windows of them such as ``session.bag@12.5:20``."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from sim_core.errors import ConfigError, RecordingError

_WINDOW = re.compile(r"^(?P<path>.+)@(?P<begin>[0-9.]+):(?P<end>[0-9.]+)$")


@dataclass(frozen=True)
class Part:
    """A recording, or its readings from ``begin`` to ``end`` [s] after its start."""

    path: Path
    begin: float = 0.0
    end: float = math.inf

    @property
    def whole(self) -> bool:
        return self.begin == 0.0 and self.end == math.inf

    def overlaps(self, other: Part) -> bool:
        """Whether both have readings of the same recording and time."""
        same = self.path.resolve() == other.path.resolve()
        return same and self.begin < other.end and other.begin < self.end


def part_of(path: Path) -> Part:
    """The recording, or the window of it, that a user names. Raises ``ConfigError``."""
    found = None if path.exists() else _WINDOW.match(str(path))
    if found is None:
        return Part(path)
    try:
        begin, end = float(found["begin"]), float(found["end"])
    except ValueError:
        begin = end = 0.0
    if not begin < end:
        raise ConfigError(f"{path} names no window.", "Write for example session.bag@12.5:20, in seconds.")
    return Part(Path(found["path"]), begin, end)


def check_parts(given: Iterable[Path], held_out: Iterable[Path] = ()) -> None:
    """Recordings exist, and no reading is named twice. Raises ``RecordingError`` and ``ConfigError``."""
    seen: list[tuple[Part, str]] = []
    for path, role in [*((bag, "given") for bag in given), *((bag, "held out") for bag in held_out)]:
        part = part_of(path)
        if not part.path.exists():
            raise RecordingError(f"The recording {part.path} does not exist.", "Check the path.")
        for other, known in seen:
            if part.overlaps(other):
                both = "twice" if known == role else "both to use and to hold out"
                what = "recording" if part.whole and other.whole else "window"
                raise RecordingError(f"The {what} {path} is given {both}.", "Name every reading once.")
        seen.append((part, role))
