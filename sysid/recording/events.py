"""What a recording says of itself on its topic of events: tares, resets, time that stamps leave out, and where a replay
parted from its prediction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.arrays import Floats
from sysid.recording.bag import Bag
from sysid.recording.message_types import EVENTS
from sysid.recording.messages import read_table
from sysid.recording.notes import Notes
from sysid.recording.streams import WrenchStream
from sysid.recording.times import TimeSource

TOPIC = "events"
"""Name of the topic, in any namespace."""

KINDS = ("tare", "reset", "skip", "parted")


@dataclass(frozen=True)
class Event:
    """Something that happened to the readings.

    Attributes:
        name: ``tare``: readings with later stamps are less ``zeros``; ``reset``: the state went back to its start, and
            tares are taken back; ``skip``: stamps leave out time in which nothing went on; ``parted``: readings of a
            replay were not as predicted, from then on.
        t: when, in the time of the recording [s]; it may be before its first reading.
        zeros: of a tare, by topic, the wrench [N, N m] ``(6,)`` that is taken off from then on.
        left_out_s: of a skip, how much [s]; 0 where it is not said.
        lasts_s: how long readings were not as predicted [s].
        exact_poses: of a reset, poses are those at their stamps, without noise, as of a simulator: one that is the same
            as before is of a hand that stands still.
    """

    name: str
    t: float
    zeros: Mapping[str, Floats]
    left_out_s: float = 0.0
    lasts_s: float = 0.0
    exact_poses: bool = False


def event_topics(bag: Bag) -> list[str]:
    """Topics of events of a bag that can be read."""
    return [
        name
        for name, topic in bag.topics.items()
        if name.rsplit("/", 1)[-1] == TOPIC and topic.msgtypes == (EVENTS,) and topic.encodings == ("cdr",)
    ]


def read_events(bag: Bag, t0_ns: int, clock: TimeSource, notes: Notes) -> tuple[Event, ...]:
    """All events of a bag in order of time; what cannot be read is left out aloud."""
    found: list[Event] = []
    for topic in event_topics(bag):
        if not bag.topics[topic].count:
            continue
        try:
            table = read_table(topic, EVENTS, bag.messages(topic), _content, notes)
        except RecordingError as error:
            notes.warning(topic, f"not used: {error.problem}")
            continue
        stamps = table.source.log_ns if clock == "log" else table.stamps_ns
        for stamp, rows in zip(stamps.tolist(), table.rows, strict=True):
            found += [replace(event, t=1e-9 * float(stamp - t0_ns)) for event in rows]
    return tuple(sorted(found, key=lambda event: event.t))


def _content(message: Any) -> list[Event]:
    """Events of one message, their times not yet set."""
    events = []
    for status in message.status:
        name = str(status.name).rpartition(" ")[2]
        if name not in KINDS:
            continue
        values = {str(pair.key): str(pair.value) for pair in status.values}
        zeros = {}
        for key, text in values.items() if name == "tare" else ():
            zero = np.array([float(number) for number in text.split()])
            if zero.shape != (6,) or not np.isfinite(zero).all():
                raise ValueError(f"has a tare of {key} that is not six numbers: {text!r}")
            zeros[key] = zero
        left_out_s = float(values.get("left_out_s", 0.0)) if name == "skip" else 0.0
        lasts_s = float(values.get("lasts_s", 0.0)) if name == "parted" else 0.0
        exact_poses = name == "reset" and values.get("poses") == "exact"
        events.append(Event(name, 0.0, zeros, left_out_s, lasts_s, exact_poses))
    return events


def with_one_zero(
    stream: WrenchStream, events: Sequence[Event], notes: Notes
) -> tuple[WrenchStream, tuple[float, ...]]:
    """A wrench whose readings all have the zero of its first one, and the times [s] of the tares that could not be
    undone.

    A tare says what it takes off; a reset takes it back. What had been taken off before the recording is only known
    if an event before its first reading says so.
    """
    zero: Floats | None = None
    known: list[tuple[float, Floats]] = []
    for event in events:
        if event.name == "reset":
            known.append((event.t, np.zeros(6)))
        elif event.name == "tare" and stream.topic in event.zeros:
            known.append((event.t, event.zeros[stream.topic]))
    for t, value in known:
        if t < stream.t[0]:
            zero = value
    later = [(t, value) for t, value in known if stream.t[0] <= t < stream.t[-1]]
    if zero is None:
        return stream, tuple(t for t, _ in later)
    offset = np.zeros((len(stream), 6))
    for t, value in later:
        offset[stream.t > t] = value - zero
    if not offset.any():
        return stream, ()
    times = [t for t, _ in later]
    notes.count("info", stream.topic, "tare or reset", "undone: all readings have the zero of the first one", times)
    return replace(stream, force=stream.force + offset[:, :3], torque=stream.torque + offset[:, 3:]), ()
