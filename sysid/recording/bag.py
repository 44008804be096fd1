"""A recording as files on disk: which files belong to it, which topics and messages they hold."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePath, PureWindowsPath
from typing import Any

import numpy as np
import yaml
import zstandard

from sim_core.errors import RecordingError, nearest_match
from sysid.recording.arrays import Ints
from sysid.recording.files import (
    SUFFIXES,
    TABLE,
    ZSTD_MAGIC,
    index_file,
    open_payloads,
    permission_denied,
)
from sysid.recording.notes import Notes, plural
from sysid.recording.storage import FileIndex, Payloads

METADATA = "metadata.yaml"

WHAT = "a rosbag2 directory, an .mcap, .db3 or .bag file, or tables (.csv)"
"""What a recording may be."""

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
        paths: the files of the recording.
        file: index into ``paths`` per message, shape (k,).
        locator: position in that file per message, shape (k, 3).
        log_ns: time of recording [ns], shape (k,).
    """

    paths: tuple[Path, ...]
    file: Ints
    locator: Ints
    log_ns: Ints

    def __len__(self) -> int:
        return len(self.log_ns)

    def take(self, which: Any) -> MessageSet:
        """Return the messages selected by an index array or mask."""
        return MessageSet(self.paths, self.file[which], self.locator[which], self.log_ns[which])

    def payloads(self) -> Iterator[bytes]:
        """Yield the serialised messages one by one; for what cannot be read, no bytes."""
        opened: dict[int, Payloads] = {}
        try:
            for k, place in zip(self.file.tolist(), self.locator.tolist(), strict=True):
                if k not in opened:
                    opened[k] = open_payloads(self.paths[k])
                try:
                    data = opened[k].payload(*place)
                    # Messages compressed one by one start with the zstd magic, which no CDR message does.
                    yield _unpacked(data) if data[:4] == ZSTD_MAGIC else data
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
            tuple(index.path for index in self.files),
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


def open_bag(path: Path, notes: Notes) -> Bag:
    """Find and index the files of a recording.

    Args:
        path: a rosbag2 directory, a directory of splits, or one storage file.
        notes: takes what was repaired or assumed.

    Raises:
        RecordingError: there is no recording, or nothing in it can be read.
    """
    try:
        paths, metadata = _files_of(path, notes)
    except PermissionError as error:
        raise permission_denied(Path(error.filename or path)) from error
    files = tuple(index_file(file) for file in paths)
    for index in files:
        for problem in index.problems:
            notes.warning(index.path.name, problem)
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


def _files_of(path: Path, notes: Notes) -> tuple[list[Path], Mapping[str, Any]]:
    if not path.exists():
        siblings = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
        hint = nearest_match(path.name, siblings) if siblings else f"{path.parent} does not exist either."
        raise RecordingError(f"Recording {path} does not exist.", hint)
    if path.is_file():
        if path.name == METADATA:
            return _files_of(path.parent, notes)
        return [path], {}
    if not path.is_dir():
        raise RecordingError(
            f"{path} is neither a file nor a folder (a device, a pipe or a socket).",
            f"Give {WHAT}.",
        )
    here = sorted((p for p in path.iterdir() if p.name.endswith(SUFFIXES)), key=_natural)
    tables = sorted((p for p in path.iterdir() if p.suffix.lower() == TABLE), key=_natural)
    if tables and not here and not (path / METADATA).exists():
        return tables, {}
    metadata = _metadata(path / METADATA, notes)
    if metadata:
        listed = [_listed_file(path, str(name)) for name in metadata["relative_file_paths"]]
        missing = [p.name for p in listed if not p.is_file()]
        found = [p for p in listed if p.is_file()]
        if listed and not found:
            raise RecordingError(
                f"{path / METADATA} lists {', '.join(missing)}, of which none exists.",
                "Copy the storage files beside metadata.yaml.",
            )
        if missing:
            notes.warning(METADATA, f"{plural(len(missing), 'split')} of {len(listed)} missing: {', '.join(missing)}")
        unlisted = [p.name for p in here if p not in listed]
        if unlisted:
            notes.warning(METADATA, f"files beside the listed ones are not read: {', '.join(unlisted)}")
        return found, metadata
    if not here:
        inner = sorted(p.name for p in path.iterdir() if p.is_dir() and (p / METADATA).exists())
        if inner:
            raise RecordingError(
                f"{path} is a folder of {plural(len(inner), 'recording')}, not a recording.",
                "Give one of: " + ", ".join(inner) + ".",
            )
        listing = f"a {METADATA} that lists nothing" if (path / METADATA).exists() else f"no {METADATA}"
        raise RecordingError(
            f"{path} is not a recording: it holds {listing} and no .mcap, .db3, .bag or .csv file.",
            f"Give {WHAT}.",
        )
    notes.warning(METADATA, f"missing or unusable; {plural(len(here), 'storage file')} read in the order of names")
    return here, {}


def _listed_file(folder: Path, name: str) -> Path:
    """The file that a metadata.yaml lists: its base name, of a path of Windows too, and with the ending that
    compression added after the name was written."""
    base = PureWindowsPath(PurePath(name).name).name
    plain = folder / base
    packed = folder / f"{base}.zstd"
    return packed if packed.is_file() and not plain.is_file() else plain


def _metadata(path: Path, notes: Notes) -> Mapping[str, Any]:
    """Return the bag's metadata, empty when there is none that can be used."""
    if not path.exists():
        return {}
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        information = content["rosbag2_bagfile_information"]
        if not isinstance(information["relative_file_paths"], list):
            raise TypeError("relative_file_paths is no list")
        counts = information.get("topics_with_message_count")
        if not isinstance(counts, list | None):
            raise TypeError("topics_with_message_count is no list")
    except (yaml.YAMLError, ValueError, KeyError, TypeError, RecursionError) as error:
        notes.warning(METADATA, f"cannot be used: {' '.join(str(error).split())}")
        return {}
    return dict(information)


def _natural(path: Path) -> tuple[tuple[int, str], ...]:
    """Sort key that puts part_2 before part_10."""
    words: list[str] = [""]
    for char in path.name:
        if char.isdigit() == words[-1][-1:].isdigit():
            words[-1] += char
        else:
            words.append(char)
    return tuple((int(word), "") if word.isdigit() else (-1, word) for word in words)


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
