"""What was repaired, assumed or found odd while reading, said aloud."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Severity = Literal["info", "warning"]


@dataclass(frozen=True)
class Note:
    """One remark on a recording.

    Attributes:
        severity: 'info' for what is harmless, 'warning' for what may change a result.
        channel: the topic or file it is about.
        text: the remark.
    """

    severity: Severity
    channel: str
    text: str

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

    def collected(self) -> tuple[Note, ...]:
        """Return the remarks, warnings first."""
        return tuple(sorted(self._notes, key=lambda note: note.severity != "warning"))


def told_once(notes: Iterable[Note]) -> list[str]:
    """Each remark with all the channels that it is about."""
    channels: dict[str, list[str]] = {}
    for note in notes:
        channels.setdefault(note.text, []).append(note.channel)
    return [f"{', '.join(about)}: {text}" for text, about in channels.items()]


def plural(count: int, thing: str) -> str:
    """Return for example '1 message' or '3 messages'."""
    return f"{count} {thing}" if count == 1 else f"{count} {thing}s"
