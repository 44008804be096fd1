"""A recording as arrays."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from sim_core.errors import RecordingError
from sysid.recording.events import Event
from sysid.recording.images import ImageStream
from sysid.recording.notes import Note, plural
from sysid.recording.streams import MarkerStream, PoseStream, Stream, StreamT, TrackStream, WrenchStream


@dataclass(frozen=True)
class FileRecord:
    """One file of a recording: name, SHA-256 as hexadecimal digits, size in bytes."""

    name: str
    sha256: str
    size: int


@dataclass(frozen=True)
class Provenance:
    """Where a recording comes from.

    Attributes:
        path: as given to the reader.
        files: its storage files in order.
        message_counts: messages per topic in the files, whether used or not.
        topic_types: message type per topic.
        duration: from the first to the last message by time of recording [s].
        storage: 'mcap' or 'sqlite3'.
        compression: '' for none.
        t0_ns: the zero of all times, the earliest stamp of any channel [ns].
    """

    path: str
    files: tuple[FileRecord, ...]
    message_counts: dict[str, int]
    topic_types: dict[str, str]
    duration: float
    storage: str
    compression: str
    t0_ns: int


@dataclass(frozen=True, kw_only=True)
class Recording:
    """What a rig did and what its sensors said, in SI units. Clocks of the streams are not aligned.

    Attributes:
        poses: input of each end effector: the measured pose where there is one, else the commanded.
        target_poses: commanded poses, where recorded.
        wrenches: by sensor.
        markers: 3-D markers by sensor.
        tracks: image-plane tracks by camera.
        images: by camera, decoded on demand.
        notes: everything that was repaired, assumed or found odd, warnings first.
        provenance: files, counts and checksums.
        events: tares, resets and time left out that it tells of, in order of time; tares that could be undone are.
        tared: by wrench sensor, times [s] of tares and resets that could not be undone.
    """

    poses: dict[str, PoseStream]
    target_poses: dict[str, PoseStream]
    wrenches: dict[str, WrenchStream]
    markers: dict[str, MarkerStream]
    tracks: dict[str, TrackStream]
    images: dict[str, ImageStream]
    notes: tuple[Note, ...]
    provenance: Provenance
    events: tuple[Event, ...] = ()
    tared: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    @property
    def t0_ns(self) -> int:
        """The zero of all times [ns]."""
        return self.provenance.t0_ns

    @property
    def warnings(self) -> tuple[Note, ...]:
        """The notes that may change a result."""
        return tuple(note for note in self.notes if note.severity == "warning")

    @property
    def duration(self) -> float:
        """From the earliest to the latest sample of any stream [s]."""
        ends = [(stream.t[0], stream.t[-1]) for _, _, stream in self.streams()]
        return float(max(end for _, end in ends) - min(start for start, _ in ends))

    def streams(self) -> Iterator[tuple[str, str, Stream]]:
        """Yield role, name and stream of every channel."""
        groups: tuple[tuple[str, Mapping[str, Stream]], ...] = (
            ("pose", self.poses),
            ("target pose", self.target_poses),
            ("wrench", self.wrenches),
            ("markers", self.markers),
            ("tracks", self.tracks),
            ("images", self.images),
        )
        for role, group in groups:
            for name, stream in group.items():
                yield role, name, stream

    def slice(self, t_start: float, t_end: float) -> Recording:
        """Return the samples with ``t_start <= t < t_end`` [s]; times keep their zero.

        Streams without a sample in the window are left out.

        Raises:
            RecordingError: the window is empty, or no sample of any stream lies in it.
        """
        if not t_start < t_end:
            raise RecordingError(f"The window from {t_start:g} s to {t_end:g} s is empty.", "Give start < end.")
        cut = replace(
            self,
            poses=_cut(self.poses, t_start, t_end),
            target_poses=_cut(self.target_poses, t_start, t_end),
            wrenches=_cut(self.wrenches, t_start, t_end),
            markers=_cut(self.markers, t_start, t_end),
            tracks=_cut(self.tracks, t_start, t_end),
            images=_cut(self.images, t_start, t_end),
        )
        if not any(True for _ in cut.streams()):
            raise RecordingError(
                f"{self.provenance.path} has no sample from {t_start:g} s to {t_end:g} s.",
                f"Its samples span {self.duration:.6g} s.",
            )
        return cut

    def summary(self) -> str:
        """Return a text table of the streams, and the notes."""
        rows = [("stream", "name", "topic", "samples", "from [s]", "to [s]", "rate [Hz]", "frame")]
        for role, name, stream in self.streams():
            span = float(stream.t[-1] - stream.t[0])
            rate = f"{(len(stream) - 1) / span:.4g}" if span > 0.0 else "-"
            times = (f"{stream.t[0]:.3f}", f"{stream.t[-1]:.3f}")
            rows.append((role, name, stream.topic, str(len(stream)), *times, rate, stream.frame_id or "-"))
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        table = ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
        source = self.provenance
        packed = f", {source.compression}" if source.compression else ""
        files = plural(len(source.files), "file")
        head = f"{source.path}: {files}, {source.storage}{packed}, {self.duration:.3f} s"
        return "\n".join([head, *table, *map(str, self.notes)])


def _cut(group: dict[str, StreamT], t_start: float, t_end: float) -> dict[str, StreamT]:
    cut = {name: stream.take((stream.t >= t_start) & (stream.t < t_end)) for name, stream in group.items()}
    return {name: stream for name, stream in cut.items() if len(stream)}
