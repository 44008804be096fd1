"""What was repaired, assumed or found odd while reading, said aloud."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

Severity = Literal["info", "warning"]


@dataclass(frozen=True)
class Note:
    """One remark on a recording.

    Attributes:
        severity: 'info' for what is harmless, 'warning' for what may change a result.
        channel: the topic or file it is about.
        words: the remark, without the number that it begins with if it counts something.
        thing: what it counts, '' for nothing.
        times: what it is about, in seconds since the start of the recording; empty for all of it.
    """

    severity: Severity
    channel: str
    words: str
    thing: str = ""
    times: tuple[float, ...] = ()

    @property
    def text(self) -> str:
        """The remark."""
        return f"{plural(len(self.times), self.thing)} {self.words}" if self.thing else self.words

    def between(self, begin: float, end: float) -> Note:
        """The remark on what was recorded from ``begin`` until before ``end`` [s], of one that is about some times."""
        return replace(self, times=tuple(t for t in self.times if begin <= t < end))

    def __str__(self) -> str:
        return f"{self.severity}: {self.channel}: {self.text}"


class Notes:
    """Collects remarks while a recording is read."""

    def __init__(self) -> None:
        self._notes: list[Note] = []

    def info(self, channel: str, text: str) -> None:
        """Add a harmless remark."""
        self._notes.append(Note("info", channel, text))

    def warning(self, channel: str, text: str) -> None:
        """Add a remark on something that may change a result."""
        self._notes.append(Note("warning", channel, text))

    def count(self, severity: Severity, channel: str, thing: str, words: str, times: Iterable[float]) -> None:
        """Add a remark on what there is at these times, in seconds since the start of the recording."""
        self._notes.append(Note(severity, channel, words, thing, tuple(float(t) for t in times)))

    def collected(self) -> tuple[Note, ...]:
        """Return the remarks, warnings first."""
        return tuple(sorted(self._notes, key=lambda note: note.severity != "warning"))


def merged_notes(notes: Iterable[Note]) -> list[str]:
    """Each remark with all the channels that it is about."""
    channels: dict[str, list[str]] = {}
    for note in notes:
        channels.setdefault(note.text, []).append(note.channel)
    return [f"{', '.join(about)}: {text}" for text, about in channels.items()]


def plural(count: int, thing: str) -> str:
    """Return for example '1 message' or '3 messages'."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
