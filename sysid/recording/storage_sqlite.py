"""Index of one rosbag2 sqlite3 file. The file is opened read-only and immutable."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.storage import ChannelEntry, FileIndex

MAGIC = b"SQLite format 3\x00"


class SqlitePayloads:
    """Message payloads of one sqlite3 file by row."""

    def __init__(self, path: Path) -> None:
        self._db = _connect(path)

    def payload(self, row: int, _b: int, _c: int, /) -> bytes:
        """Return the bytes of the message with id ``row``."""
        (data,) = self._db.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()
        return bytes(data)

    def close(self) -> None:
        """Close the file."""
        self._db.close()


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
            f"{log.name} beside it holds messages that were never merged into the database and are not read; "
            "open a copy of both once with the sqlite3 tool to merge them"
        )
    db = _connect(path)
    try:
        topics = db.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id").fetchall()
        rows = db.execute("SELECT topic_id, timestamp, id FROM messages ORDER BY id").fetchall()
    except sqlite3.DatabaseError as error:
        raise RecordingError(
            f"{shown} is not a readable rosbag2 database: {error}.",
            "If it was cut short, recover a copy with: sqlite3 COPY.db3 .recover | sqlite3 FIXED.db3",
        ) from error
    finally:
        db.close()
    order = {topic_id: k for k, (topic_id, *_) in enumerate(topics)}
    table = np.array([row for row in rows if row[0] in order], dtype=np.int64).reshape(-1, 3)
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
    )


def _connect(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
