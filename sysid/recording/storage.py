"""What every storage offers: an index of its messages, and their bytes by position."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from sysid.recording.arrays import Ints


class Payloads(Protocol):
    """Bytes of single messages by position."""

    def payload(self, a: int, b: int, c: int, /) -> bytes:
        """Return one message's bytes; the arguments are a row of ``FileIndex.locator``."""

    def close(self) -> None:
        """Release the file."""


@dataclass(frozen=True)
class ChannelEntry:
    """One topic as one file lists it."""

    topic: str
    msgtype: str
    encoding: str


@dataclass(frozen=True)
class FileIndex:
    """Where the messages of one file are.

    Attributes:
        path: the file as the user named it.
        storage: 'mcap' or 'sqlite3'.
        compression: '' for none, else for example 'zstd' (chunks) or 'zstd file'.
        channels: the topics; a topic may appear more than once.
        channel: index into ``channels`` per message, shape (k,).
        log_ns: time of recording per message [ns], shape (k,).
        locator: position of the payload per message, shape (k, 3); its meaning is the storage's own.
        problems: damage found and what was done about it, one sentence part each.
        remarks: what else is to be said of it, harmless.
        open: opens it for reading single messages.
    """

    path: Path
    storage: str
    compression: str
    channels: tuple[ChannelEntry, ...]
    channel: Ints
    log_ns: Ints
    locator: Ints
    problems: tuple[str, ...]
    open: Callable[[], Payloads]
    remarks: tuple[str, ...] = ()
