"""Serialised messages of one topic to Python objects."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.arrays import Bools, Floats, Ints
from sysid.recording.bag import MessageSet
from sysid.recording.message_types import TYPESTORE
from sysid.recording.notes import Notes, plural
from sysid.recording.times import TimeSource, order_in_time

LONGEST_NAME = 80
"""Characters of a name out of a recording that are shown."""


def decode(data: bytes, msgtype: str) -> Any:
    """Deserialise one message.

    Raises:
        ValueError: the bytes are no such message.
    """
    try:
        return TYPESTORE.deserialize_cdr(data, msgtype)
    except Exception as error:  # of the code that rosbags generates, on bytes that may be anything
        raise ValueError(f"cannot be read as {msgtype}: {error}") from error


@dataclass(frozen=True)
class Table:
    """The messages of one topic as rows, in the order of recording.

    Attributes:
        topic: its name.
        source: where they are.
        rows: what was kept of each message.
        stamps_ns: header stamps [ns], shape (n,).
        frames: header frames.
    """

    topic: str
    source: MessageSet
    rows: list[Any]
    stamps_ns: Ints
    frames: list[str]

    def take(self, which: Ints | Bools) -> Table:
        """Return the rows selected by an index array or mask."""
        index = np.arange(len(self.rows))[which]
        return Table(
            self.topic,
            self.source.take(index),
            [self.rows[k] for k in index],
            self.stamps_ns[index],
            [self.frames[k] for k in index],
        )

    def in_one_frame(self, declared: str | None, framed: bool, notes: Notes) -> tuple[Table, str]:
        """Return the rows of the declared frame, or of the only one, and its name. ``framed``: they might have one."""
        counts = Counter(self.frames)
        stray = [frame for frame, count in counts.items() if count == 1]
        if declared is None and len(counts) - len(stray) == 1 and stray:
            # One message is no second publisher: it is damaged.
            when = _after(self.source.log_ns, self.frames.index(stray[0]))
            notes.warning(
                self.topic,
                f"{plural(len(stray), 'message')} of another frame dropped: the first, {when}, has frame_id "
                f"{stray[0][:LONGEST_NAME]!r}",
            )
            kept = np.array([frame not in stray for frame in self.frames])
            return self.take(kept).in_one_frame(None, framed, notes)
        listing = ", ".join(f"{frame[:LONGEST_NAME]!r} ({plural(count, 'message')})" for frame, count in counts.items())
        if declared is not None:
            if declared not in counts:
                raise RecordingError(
                    f"{self.topic}: frame_id is {listing} where {declared!r} is declared.",
                    "Correct the declaration, or transform the recording into that frame.",
                )
            if len(counts) > 1:
                notes.warning(self.topic, f"messages of other frames than {declared!r} dropped: {listing}")
            return self.take(np.array([frame == declared for frame in self.frames])), declared
        if len(counts) > 1:
            raise RecordingError(
                f"{self.topic}: messages of more than one frame: {listing}.",
                "Record each frame on a topic of its own, and name the right one in the rig.",
            )
        frame = next(iter(counts))
        if not frame and framed:
            notes.warning(self.topic, "frame_id is empty: taken for the frame that the rig states")
        return self, frame


@dataclass(frozen=True)
class Series:
    """The messages of one topic in one frame and in order of time.

    Attributes:
        topic: its name.
        frame_id: the frame of all messages.
        source: where they are.
        rows: what was kept of each message.
        times_ns: strictly increasing [ns], shape (n,).
    """

    topic: str
    frame_id: str
    source: MessageSet
    rows: list[Any]
    times_ns: Ints

    def seconds(self, t0_ns: int) -> Floats:
        """Return the times since ``t0_ns`` [s], shape (n,)."""
        seconds: Floats = (self.times_ns - t0_ns).astype(np.float64) * 1e-9
        return seconds

    def arrival(self, t0_ns: int) -> Floats:
        """Return the times of recording since ``t0_ns`` [s], shape (n,)."""
        seconds: Floats = (self.source.log_ns - t0_ns).astype(np.float64) * 1e-9
        return seconds


def read_series(
    topic: str,
    msgtype: str,
    source: MessageSet,
    content: Callable[[Any], Any],
    frame_id: str | None,
    clock: TimeSource,
    notes: Notes,
    framed: bool = True,
) -> Series:
    """Read a topic whose values change with time; see ``read_table`` for the arguments.

    ``frame_id`` is the frame declared for it, ``clock`` the clock to use; ``framed``: messages may have frames, as rows
    of tables do not.
    """
    table, frame = read_table(topic, msgtype, source, content, notes).in_one_frame(frame_id, framed, notes)
    kept, times_ns = order_in_time(topic, table.stamps_ns, table.source.log_ns, clock, notes)
    table = table.take(kept)
    return Series(topic, frame, table.source, table.rows, times_ns)


def _after(log_ns: Ints, k: int) -> str:
    """When the k-th message of a topic was recorded, in words."""
    return f"recorded {1e-9 * float(log_ns[k] - log_ns.min()):.3f} s after the first of this topic"


def read_table(topic: str, msgtype: str, source: MessageSet, content: Callable[[Any], Any], notes: Notes) -> Table:
    """Deserialise the messages of one topic.

    Args:
        topic: its name.
        msgtype: type of all its messages.
        source: where they are.
        content: function of a message that returns what to keep of it; may raise ValueError.
        notes: takes what could not be read.

    Raises:
        RecordingError: no message can be read.
    """
    rows: list[Any] = []
    stamps: list[int] = []
    frames: list[str] = []
    kept: list[int] = []
    fault, first = "", 0
    for k, data in enumerate(source.payloads()):
        try:
            if not data:
                raise ValueError("is damaged in the file")
            message = decode(data, msgtype)
            row = content(message)
        except ValueError as error:
            first = first if fault else k
            fault = fault or str(error)
            continue
        rows.append(row)
        header = getattr(message, "header", None)
        stamps.append(0 if header is None else int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec))
        frames.append("" if header is None else str(header.frame_id))
        kept.append(k)
    lost = len(source) - len(kept)
    fault = fault or "is unreadable"
    if not kept:
        raise RecordingError(
            f"{topic}: none of {plural(len(source), 'message')} can be used: the first {fault}.",
            "Record the topic with the type and fields of the bag contract, or leave it out of the map.",
        )
    if lost:
        notes.warning(topic, f"{plural(lost, 'message')} dropped: the first, {_after(source.log_ns, first)}, {fault}")
    index = np.array(kept, dtype=np.int64)
    return Table(topic, source.take(index), rows, np.array(stamps, dtype=np.int64), frames)
