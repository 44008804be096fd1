"""Index of one rosbag2 sqlite3 file. The file is opened read-only and immutable."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.sqlite_pages import Pages
from sysid.recording.storage import ChannelEntry, FileIndex, Payloads

MAGIC = b"SQLite format 3\x00"

_LEAST_BYTES = 16
"""Of a row with a time of recording."""

Message = tuple[int, int, int]
"""Topic, time of recording [ns] and where it is: the id of its row, or the place of its cell."""


class SqlitePayloads:
    """Message payloads of one sqlite3 file by row."""

    def __init__(self, path: Path) -> None:
        self._db = _connect(path)

    def payload(self, row: int, _b: int, _c: int, /) -> bytes:
        """Return the bytes of the message with id ``row``."""
        found = self._db.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()
        if found is None or not isinstance(found[0], bytes):
            raise ValueError(f"row {row} of the database holds no message")
        return found[0]

    def close(self) -> None:
        """Close the file."""
        self._db.close()


class PagedPayloads:
    """Message payloads of one damaged sqlite3 file by the place of their cells."""

    def __init__(self, path: Path) -> None:
        self._pages = Pages(path)

    def payload(self, at: int, _b: int, _c: int, /) -> bytes:
        """Return the bytes of the message whose cell is there."""
        try:
            data = self._pages.row(at, blobs=True).values[3]
        except (IndexError, UnicodeDecodeError) as error:
            raise ValueError(f"the row at byte {at} of the database is damaged") from error
        assert isinstance(data, bytes)
        return data

    def close(self) -> None:
        """Close the file."""
        self._pages.close()


def index_sqlite(path: Path, shown: Path) -> FileIndex:
    """List the messages of a sqlite3 storage file.

    Args:
        path: the file to read.
        shown: the path to name in messages (differs from ``path`` for an unpacked copy).

    Raises:
        RecordingError: the database cannot be read or holds no rosbag2 tables.
    """
    problems = []
    log = shown.with_name(shown.name + "-wal")
    if log.exists() and log.stat().st_size:
        problems.append(
            f"{log.name} next to it holds messages that were never merged into the database and are not read; "
            "open a copy of both once with the sqlite3 tool to merge them"
        )
    payloads: Callable[[Path], Payloads] = SqlitePayloads
    try:
        listed, rows = _asked(path)
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        payloads = PagedPayloads
        listed, rows, missing = _carved(path)
        if not listed or not rows:
            raise RecordingError(
                f"{shown} is not a readable rosbag2 database: {error}.", "Use another copy of the recording."
            ) from error
        # An id that is damaged itself tells nothing: no more are lost than the file has room for.
        room = path.stat().st_size // _LEAST_BYTES
        lost = f"; {missing} messages between others are lost" if 0 < missing < room else ""
        problems.append(f"the database is damaged ({error}): what is whole on its pages is read{lost}")
    topics = [t for t in listed if isinstance(t[0], int) and all(isinstance(word, str) for word in t[1:])]
    if len(topics) < len(listed):
        problems.append(f"{len(listed) - len(topics)} entries of its list of topics are damaged and left out")
    order = {topic_id: k for k, (topic_id, *_) in enumerate(topics)}
    whole = [row for row in rows if all(isinstance(number, int) for number in row)]
    table = np.array([row for row in whole if row[0] in order], dtype=np.int64).reshape(-1, 3)
    if len(table) != len(rows):
        problems.append(f"{len(rows) - len(table)} messages belong to no known topic and are left out")
    locator = np.zeros((len(table), 3), dtype=np.int64)
    locator[:, 0] = table[:, 2]
    return FileIndex(
        path=shown,
        storage="sqlite3",
        compression="",
        channels=tuple(ChannelEntry(name, msgtype, encoding) for _, name, msgtype, encoding in topics),
        channel=np.array([order[int(topic)] for topic in table[:, 0]], dtype=np.int64),
        log_ns=table[:, 1],
        locator=locator,
        problems=tuple(problems),
        open=partial(payloads, path),
    )


def _asked(path: Path) -> tuple[list[tuple[int, str, str, str]], list[Message]]:
    """Topics and messages of a whole database."""
    db = _connect(path)
    try:
        listed = db.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id").fetchall()
        rows = db.execute("SELECT topic_id, timestamp, id FROM messages ORDER BY id").fetchall()
    finally:
        db.close()
    if any(not isinstance(one, int) or one >= other for (*_, one), (*_, other) in pairwise(rows)):
        raise sqlite3.DatabaseError("its ids are not in order")
    return listed, rows


def _carved(path: Path) -> tuple[list[tuple[int, str, str, str]], list[Message], int]:
    """Topics and messages of a damaged database from its pages, and how many ids between theirs are missing."""
    topics: dict[int, tuple[int, str, str, str]] = {}
    messages: dict[int, Message] = {}
    pages = Pages(path)
    try:
        for row in pages.rows():
            match row.values:
                case (None, str(name), str(kind), str(encoding), *_) if name.startswith("/"):
                    topics.setdefault(row.number, (row.number, name, kind, encoding))
                case (None, int(topic), int(stamp), bytes()):
                    messages.setdefault(row.number, (topic, stamp, row.at))
    finally:
        pages.close()
    missing = max(messages) - min(messages) + 1 - len(messages) if messages else 0
    return [topics[k] for k in sorted(topics)], [messages[k] for k in sorted(messages)], missing


def _connect(path: Path) -> sqlite3.Connection:
    db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    db.text_factory = lambda raw: raw.decode("utf-8", errors="replace")
    return db
