"""Index of one rosbag2 sqlite3 file. The file is opened read-only and immutable."""

from __future__ import annotations

import sqlite3
from functools import partial
from pathlib import Path

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.storage import ChannelEntry, FileIndex

MAGIC = b"SQLite format 3\x00"

MOST_FAULTS = 256
"""Damaged pages that are passed over in one file."""
_LARGEST_ID = 2**63 - 1

LARGEST_SKIP = 1 << 22
"""Ids behind a damaged page that are passed over before it is taken for the end."""


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
        listed = db.execute("SELECT id, name, type, serialization_format FROM topics ORDER BY id").fetchall()
        rows, lost = _rows(db)
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        raise RecordingError(
            f"{shown} is not a readable rosbag2 database: {error}.",
            "If it was cut short, recover a copy with: sqlite3 COPY.db3 .recover | sqlite3 FIXED.db3",
        ) from error
    finally:
        db.close()
    if lost:
        problems.append(
            f"the database is damaged ({lost}): messages on its damaged pages are lost, those behind are read"
        )
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
        open=partial(SqlitePayloads, path),
    )


def _rows(db: sqlite3.Connection) -> tuple[list[tuple[int, int, int]], str]:
    """Topic, time of recording and id of the messages that can be read, and what is wrong with the others.

    A damaged page ends a query. The next one begins behind the last id, farther and farther, until one can be read."""
    rows: list[tuple[int, int, int]] = []
    fault, after, skip = "", -1, 0
    for _ in range(MOST_FAULTS):
        try:
            for row in db.execute("SELECT topic_id, timestamp, id FROM messages WHERE id > ? ORDER BY id", (after,)):
                if not isinstance(row[2], int) or row[2] <= after:
                    raise sqlite3.DatabaseError("its ids are not in order")
                rows.append(row)
                after, skip = row[2], 0
            break
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            fault, skip = str(error), max(1, 2 * skip)
            after = min(after + skip, _LARGEST_ID)
            if skip > LARGEST_SKIP:
                break
    if fault and not rows:
        raise sqlite3.DatabaseError(fault)
    return rows, fault


def _connect(path: Path) -> sqlite3.Connection:
    db = sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)
    db.text_factory = lambda raw: raw.decode("utf-8", errors="replace")
    return db
