"""A recording as files on disk: which files belong to it, which topics and messages they hold."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

from sim_core.errors import RecordingError
from sysid.recording.arrays import Ints
from sysid.recording.files import index_file, permission_denied
from sysid.recording.find import METADATA, files_of
from sysid.recording.formats import TABLE, content_of
from sysid.recording.notes import Notes
from sysid.recording.storage import FileIndex, Payloads

_ZSTD = b"\x28\xb5\x2f\xfd"

LARGEST_MESSAGE = 1 << 30
"""Bytes that a message may unpack to."""

LONGEST_REMARK = 300
"""Characters of a remark of the metadata that are shown."""


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a recording: its types (more than one is a fault), encodings and message count."""

    name: str
    msgtypes: tuple[str, ...]
    encodings: tuple[str, ...]
    count: int


@dataclass(frozen=True)
class MessageSet:
    """Where the messages of one topic are, in the order of recording.

    Attributes:
        open: opens each file of the recording.
        file: index into ``open`` per message, shape (k,).
        locator: position in that file per message, shape (k, 3).
        log_ns: time of recording [ns], shape (k,).
    """

    open: tuple[Callable[[], Payloads], ...]
    file: Ints
    locator: Ints
    log_ns: Ints

    def __len__(self) -> int:
        return len(self.log_ns)

    def take(self, which: Any) -> MessageSet:
        """Return the messages selected by an index array or mask."""
        return MessageSet(self.open, self.file[which], self.locator[which], self.log_ns[which])

    def payloads(self) -> Iterator[bytes]:
        """Yield the serialised messages one by one; for what cannot be read, no bytes."""
        opened: dict[int, Payloads] = {}
        try:
            for k, place in zip(self.file.tolist(), self.locator.tolist(), strict=True):
                if k not in opened:
                    opened[k] = self.open[k]()
                try:
                    data = opened[k].payload(*place)
                    # Messages compressed one by one start with the zstd magic, which no CDR message does.
                    yield _unpacked(data) if data[:4] == _ZSTD else data
                except (sqlite3.DatabaseError, zstandard.ZstdError, struct.error, ValueError, OverflowError):
                    yield b""  # what is damaged is no message of any type
        finally:
            for payloads in opened.values():
                payloads.close()


@dataclass(frozen=True)
class Bag:
    """An indexed recording.

    Attributes:
        path: as given by the user.
        files: one index per storage file, in the order of recording.
        topics: by name.
        compression: '' for none.
    """

    path: Path
    files: tuple[FileIndex, ...]
    topics: dict[str, TopicInfo]
    compression: str

    @property
    def of_tables(self) -> bool:
        """Whether it is made of tables, which have no frames and no camera_info."""
        return all(index.storage == TABLE for index in self.files)

    def messages(self, topic: str) -> MessageSet:
        """Return the messages of one topic, ordered by their time of recording."""
        file, locator, log_ns = [], [], []
        for k, index in enumerate(self.files):
            channels = [c for c, entry in enumerate(index.channels) if entry.topic == topic]
            mine = np.isin(index.channel, channels)
            file.append(np.full(int(mine.sum()), k, dtype=np.int64))
            locator.append(index.locator[mine])
            log_ns.append(index.log_ns[mine])
        found = MessageSet(
            tuple(index.open for index in self.files),
            np.concatenate(file),
            np.concatenate(locator),
            np.concatenate(log_ns),
        )
        return found.take(np.argsort(found.log_ns, kind="stable"))


def _unpacked(data: bytes) -> bytes:
    """One message that was compressed by itself."""
    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        message = reader.read(LARGEST_MESSAGE + 1)
    if len(message) > LARGEST_MESSAGE:
        raise ValueError(f"a message unpacks to more than {LARGEST_MESSAGE} bytes")
    return message


def open_bag(path: Path, notes: Notes, columns: Mapping[str, str] | None = None) -> Bag:
    """Find and index the files of a recording.

    Args:
        path: a rosbag2 directory, a directory of splits, or one storage file.
        notes: takes what was repaired or assumed.
        columns: by names of columns of tables, what they are.

    Raises:
        RecordingError: there is no recording, or nothing in it can be read.
    """
    try:
        paths, metadata = files_of(path, notes)
    except PermissionError as error:
        raise permission_denied(Path(error.filename or path)) from error
    files = _indexed(paths, columns or {}, notes)
    for index in files:
        for problem in index.problems:
            notes.warning(index.path.name, problem)
        for remark in index.remarks:
            notes.info(index.path.name, remark)
    topics = _topics(files)
    total = sum(len(index.log_ns) for index in files)
    if not total:
        damage = "; ".join(problem for index in files for problem in index.problems)
        raise RecordingError(
            f"{path} holds no messages that can be read" + (f": {damage}." if damage else "."),
            "Record again and check that the topics are being published, or use another copy."
            if not damage
            else "Use another copy of the recording.",
        )
    _compare_counts(topics, metadata, notes)
    _note_remarks(metadata, notes)
    kinds = {index.compression for index in files if index.compression}
    if str(metadata.get("compression_mode", "")).lower() == "message":
        kinds.add("zstd message")
    return Bag(path, files, topics, "+".join(sorted(kinds)))


def _indexed(paths: Sequence[Path], columns: Mapping[str, str], notes: Notes) -> tuple[FileIndex, ...]:
    """The files that can be read. Raises ``RecordingError`` where none can, or where a table has faults, with those of
    all."""
    found: list[FileIndex] = []
    faults: dict[Path, RecordingError] = {}
    for path in paths:
        try:
            found.append(index_file(path, columns))
        except RecordingError as error:
            faults[path] = error
    tables = [path for path in faults if content_of(path).kind == TABLE]
    if tables:
        raise RecordingError(
            " ".join(faults[path].problem for path in tables), max((faults[path].remedy for path in tables), key=len)
        )
    if not found:
        raise next(iter(faults.values()))
    for path, fault in faults.items():
        notes.warning(path.name, f"left out: {fault.problem}")
    return tuple(found)


def _topics(files: tuple[FileIndex, ...]) -> dict[str, TopicInfo]:
    types: dict[str, set[str]] = {}
    encodings: dict[str, set[str]] = {}
    counts: dict[str, int] = {}
    for index in files:
        per_channel = np.bincount(index.channel, minlength=len(index.channels))
        for entry, count in zip(index.channels, per_channel.tolist(), strict=True):
            types.setdefault(entry.topic, set()).add(_full_type(entry.msgtype))
            encodings.setdefault(entry.topic, set()).add(entry.encoding)
            counts[entry.topic] = counts.get(entry.topic, 0) + count
    return {
        name: TopicInfo(name, tuple(sorted(types[name])), tuple(sorted(encodings[name])), counts[name])
        for name in sorted(counts)
    }


def _full_type(name: str) -> str:
    """Return 'pkg/msg/Type' for the older 'pkg/Type'."""
    return name.replace("/", "/msg/") if name.count("/") == 1 else name


def _compare_counts(topics: dict[str, TopicInfo], metadata: Mapping[str, Any], notes: Notes) -> None:
    """Say where the files hold another number of messages than metadata.yaml counts."""
    for item in metadata.get("topics_with_message_count") or []:
        try:
            name, promised = str(item["topic_metadata"]["name"]), int(item["message_count"])
        except (KeyError, TypeError, ValueError, OverflowError):
            continue
        found = topics[name].count if name in topics else 0
        if found != promised:
            notes.warning(name, f"{found} messages found where metadata.yaml counts {promised}")


def _note_remarks(metadata: Mapping[str, Any], notes: Notes) -> None:
    """Pass on what the metadata says of the recording in its own words."""
    remarks = metadata.get("custom_data")
    for name, text in remarks.items() if isinstance(remarks, Mapping) else ():
        words = " ".join(str(text).split())
        short = words if len(words) <= LONGEST_REMARK else f"{words[:LONGEST_REMARK]} ... ({len(str(text))} characters)"
        notes.info(METADATA, f"{name}: {short}")
