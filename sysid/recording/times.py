"""Time stamps of one stream, put in order: what is repaired, what is refused."""

from __future__ import annotations

from typing import Literal

import numpy as np

from sim_core.errors import RecordingError
from sysid.recording.arrays import Bools, Floats, Ints
from sysid.recording.notes import Notes, plural

TimeSource = Literal["header", "log"]

_LONGEST_LATE_RUN = 3
"""Messages in a row that may arrive late; more of them mean that the clock itself went back."""

_GAP = 5.0
"""A gap is an interval longer than this many median intervals."""


def order_in_time(topic: str, stamps_ns: Ints, log_ns: Ints, source: TimeSource, notes: Notes) -> tuple[Ints, Ints]:
    """Choose the clock of a stream and put its messages in strictly increasing order.

    Args:
        topic: name for the notes.
        stamps_ns: header stamps in the order of recording [ns], shape (n,).
        log_ns: times of recording [ns], shape (n,).
        source: clock to use; 'header' falls back to 'log' when all stamps are zero.
        notes: takes what was repaired or assumed.

    Returns:
        Indices of the messages kept, in order of time, and their times [ns]; both of shape (k,).

    Raises:
        RecordingError: the clock jumps back and goes on from there.
    """
    if source == "header" and len(stamps_ns) and not stamps_ns.any():
        notes.warning(topic, "all header stamps are zero: log time is used, which includes transport delays")
        source = "log"
    elif source == "log":
        notes.info(topic, "log time is used in place of the header stamps, as declared")
    times = log_ns if source == "log" else stamps_ns
    kept = np.arange(len(times), dtype=np.int64)
    if source == "header":
        kept = kept[_stamped(times, log_ns)]
        if len(kept) < len(times):
            notes.warning(topic, f"{plural(len(times) - len(kept), 'message')} without a stamp dropped")
        kept = _without_spikes(topic, times, kept, notes)
        late = int(_late(times[kept]).sum())
        if late:
            notes.warning(topic, f"{plural(late, 'message')} with a backward stamp put in order")
    kept = kept[np.argsort(times[kept], kind="stable")]
    fresh = np.ones(len(kept), dtype=np.bool_)
    fresh[1:] = np.diff(times[kept]) != 0
    if not fresh.all():
        notes.warning(topic, f"{plural(int((~fresh).sum()), 'duplicate stamp')} dropped, the first kept")
    kept = kept[fresh]
    return kept, times[kept]


def note_gaps(topic: str, t: Floats, notes: Notes) -> None:
    """Say where a stream pauses. ``t``: times in order [s], shape (n,)."""
    if len(t) < 3:
        return
    intervals = np.diff(t)
    usual = float(np.median(intervals))
    gaps = np.flatnonzero(intervals > _GAP * usual)
    if len(gaps):
        longest = gaps[np.argsort(-intervals[gaps], kind="stable")][:3]
        where = ", ".join(f"{intervals[k]:.4g} s at t={t[k]:.4g} s" for k in sorted(longest))
        what = "gap of" if len(gaps) == 1 else f"{len(gaps)} gaps, the longest:"
        notes.warning(topic, f"{what} {where} (usual interval {usual:.4g} s)")


def _stamped(stamps_ns: Ints, log_ns: Ints) -> Bools:
    """Mark messages with a stamp; a clock that starts at zero keeps its first message."""
    stamped: Bools = stamps_ns > 0
    if len(stamps_ns) > 1 and stamps_ns[0] == 0 and stamped[1:].all():
        like_it = stamps_ns[1:] if len(stamps_ns) > 2 else log_ns
        stamped[0] = stamps_ns[1] <= 10.0 * float(np.median(np.diff(like_it)))
    return stamped


def _late(times: Ints) -> Bools:
    """Mark messages that are older than one before them."""
    late = np.zeros(len(times), dtype=np.bool_)
    late[1:] = times[1:] < np.maximum.accumulate(times)[:-1]
    return late


def _without_spikes(topic: str, times: Ints, kept: Ints, notes: Notes) -> Ints:
    """Drop single stamps far in the future; refuse a clock that went back for good."""
    spikes: list[float] = []
    while True:
        late = _late(times[kept])
        edges = np.flatnonzero(np.diff(np.concatenate(([False], late, [False])).astype(np.int8)))
        long_runs = [(a, b) for a, b in edges.reshape(-1, 2) if b - a > _LONGEST_LATE_RUN]
        if not long_runs:
            break
        start = int(long_runs[0][0])
        last = start - 1
        before = times[kept[last - 1]] if last > 0 else np.iinfo(np.int64).min
        if times[kept[start]] < before or len(spikes) >= 1 + len(times) // 100:
            step = 1e-9 * float(times[kept[last]] - times[kept[start]])
            raise RecordingError(
                f"{topic}: the stamps go back by {step:.4g} s at message {int(kept[start])} and go on from "
                "there (clock set back, or a recording played in a loop).",
                "Cut the recording there, or write `recording_clock: log` into the rig to use the recorder's times.",
            )
        spikes.append(1e-9 * float(times[kept[last]] - times[kept[start]]))
        kept = np.delete(kept, last)
    if spikes:
        notes.warning(
            topic, f"{plural(len(spikes), 'message')} stamped up to {max(spikes):.4g} s in the future dropped"
        )
    return kept
