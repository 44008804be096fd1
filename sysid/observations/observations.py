"""A recording seen through a rig: what moved, and what was measured on which channel."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from sim_core.errors import RecordingError
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.observations.selection import Part, given_again
from sysid.recording.notes import Note

UNITS = {"wrench": ("N", "N m"), "markers": ("m",), "tracks": ("px",)}


@dataclass(frozen=True)
class Measured:
    """One channel as measured.

    ``t`` [s] ``(n,)`` since the start of the run; ``values`` ``(n, m)``: six wrench components, or
    coordinates marker by marker (3-D or pixels); NaN where missing. ``labels``: name of each column.
    """

    channel: str
    kind: str
    t: np.ndarray
    values: np.ndarray
    labels: tuple[str, ...]

    @property
    def unit(self) -> str:
        """Unit of the values (a wrench: of its forces)."""
        return UNITS[self.kind][0]


@dataclass(frozen=True)
class Change:
    """How the readings of a channel have changed between the start of a recording and that of a window of it, measured
    units: means of ``columns`` ``(k,)``, and their standard deviation ``scatter``."""

    columns: np.ndarray
    mean: np.ndarray
    scatter: np.ndarray


@dataclass(frozen=True)
class FirstFrame:
    """What tells where markers are on their sheet: ``pixels`` ``(n, 2)`` of all points of a camera in the first frame
    that shows any, as measured, NaN where missing; its stamp ``t`` [s] since the start of the recording, a window
    or not, and the ``poses`` of the end effectors about then, in the same time."""

    t: float
    pixels: np.ndarray
    poses: Mapping[str, PoseTrajectory]


@dataclass(frozen=True)
class Run:
    """One recording, ready to be compared.

    ``end`` [s]: time of its last measurement. ``firsts``: the first frame of each camera to which the rig leaves the
    places of markers (``placed: first_frame``, :mod:`sysid.model.marker_registration`). ``since`` [s]: for a window of
    a recording, the time at which it begins; times of the run, poses before included, count from there; ``until``: its
    end, if it has one; ``changes``: until then, by channel. ``unlike``: in what it differs from recordings of the rig,
    in words. ``doubts``: those of the ``notes`` on how it was read that may change a result; ``lacking``: those on
    topics of the rig that it does not have. ``counted``: notes that count samples, which
    :func:`sysid.model.windows.window_of` tells for the window, or for the whole; ``breaks``: instants at which it
    begins anew, each with the error of a window across it. ``steps`` [s] ``(k,)``: instants of the solver's steps from
    0 to ``end`` where they are not ``solver.dt_s`` apart (:mod:`sysid.discretisation.time_steps`). ``span_ns``: stamps
    [ns] of the start and the end of the whole recording; ``earlier``: motion of the recordings of the same bodies that
    came before (:mod:`sysid.model.sequence`); ``parted``: where the watch of a replay found readings that were not as
    predicted, from and until [s]."""

    name: str
    path: str
    sha256: tuple[str, ...]
    poses: dict[str, PoseTrajectory]
    measured: tuple[Measured, ...]
    end: float
    notes: tuple[str, ...] = field(default=())
    firsts: Mapping[str, FirstFrame] = field(default_factory=dict)
    since: float = 0.0
    until: float | None = None
    changes: Mapping[str, Change] = field(default_factory=dict)
    unlike: str = ""
    doubts: tuple[str, ...] = ()
    lacking: tuple[str, ...] = ()
    counted: tuple[Note, ...] = ()
    breaks: tuple[tuple[float, RecordingError], ...] = ()
    steps: np.ndarray | None = None
    span_ns: tuple[int, int] | None = None
    earlier: tuple[Run, ...] = ()
    parted: tuple[tuple[float, float], ...] = ()

    def has(self, channel: str) -> bool:
        """Whether it has readings of a channel."""
        return any(m.channel == channel for m in self.measured)


def of_recording(name: str, text: str) -> str:
    """A remark on a recording, which is named once."""
    return text if text.startswith(f"{name}: ") else f"{name}: {text}"


def check_apart(runs: Sequence[Run], held_out: Sequence[Run] = ()) -> None:
    """No reading is in two of them, whatever the paths: files are recognised by their content. Raises
    ``RecordingError``.

    Windows are compared where both recordings consist of the same files; a file of a recording that was split counts
    its time from elsewhere.
    """
    seen: list[tuple[Run, str]] = []
    for run, role in [*((r, "given") for r in runs), *((r, "held out") for r in held_out)]:
        for other, known in seen:
            if not set(run.sha256) & set(other.sha256):
                continue
            part, before = _part(run), _part(other)
            if sorted(run.sha256) != sorted(other.sha256):
                part, before = Part(part.path), Part(before.path)
            if part.overlaps(before):
                raise given_again(part, role, before, known)
        seen.append((run, role))


def _part(run: Run) -> Part:
    """The recording, or the window of it, that a run is."""
    return Part(Path(run.path), run.since, np.inf if run.until is None else run.until)


def distinct_names(paths: Sequence[Path]) -> list[str]:
    """The shortest end of each path, in whole parts, in which no other path ends.

    Paths of the same place have no such end: their names are the whole path.
    """
    parts = [Path(os.path.abspath(p)).parts for p in paths]
    names = []
    for k, own in enumerate(parts):
        others = parts[:k] + parts[k + 1 :]
        enough = (n for n in range(1, len(own)) if all(own[-n:] != other[-n:] for other in others))
        names.append(str(Path(*own[-next(enough, len(own)) :])))
    return names
