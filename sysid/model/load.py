"""Reads recordings and lines them up with a rig."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from sim_core.errors import RecordingError
from sim_core.rigs import OrthographicCamera, Rig, WrenchSensor
from sim_core.rigs.observers import WRENCH_COMPONENTS
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sysid.model.marker_registration import first_frames, placed
from sysid.model.sequence import earlier_motion
from sysid.model.windows import window_of
from sysid.observations.checks import Finding, examine
from sysid.observations.observations import Measured, Run, distinct_names, of_recording
from sysid.observations.recorded_axes import in_rig_axes
from sysid.observations.rig_match import check_topics, marker_numbers, numbers_apart
from sysid.observations.rig_topics import topics_of
from sysid.observations.selection import part_of
from sysid.recording import Recording, read_recording
from sysid.recording.bag import open_bag
from sysid.recording.notes import Note, Notes, Severity, merged_notes


def load_runs(
    rig: Rig,
    bags: Sequence[Path],
    held_out: Sequence[Path] = (),
    on_warning: Callable[[str], None] | None = None,
    despite: Collection[str] = (),
    fresh_bodies: bool = False,
) -> tuple[list[Run], list[Run]]:
    """Read the bags, or windows of bags, to use and those held out (:func:`load_run`), under names that tell all of
    them apart. ``on_warning``: hears what speaks against each recording, once it is read, and each window of it;
    ``despite``: findings that do not stop (:func:`read_run`); ``fresh_bodies``: they do not show the same bodies in
    turn (:mod:`sysid.model.sequence`)."""
    paths = [*bags, *held_out]
    parts = [part_of(path) for path in paths]
    whole = {path: read_run(rig, path, despite) for path in dict.fromkeys(part.path for part in parts)}
    if on_warning is not None:
        for name, run in zip(distinct_names(list(whole)), whole.values(), strict=True):
            for text in (*filter(None, [run.unlike]), *run.doubts, *run.lacking):
                on_warning(of_recording(name, text))
    named = zip(parts, distinct_names(paths), strict=True)
    runs = []
    for part, name in named:
        run = replace(window_of(rig, whole[part.path], part), name=name)
        if on_warning is not None:
            for text in run.doubts[len(whole[part.path].doubts) :]:
                on_warning(of_recording(name, text))
        if run.end <= 0.0:
            raise RecordingError(
                f"{run.name} has readings of its first instant only, so there is nothing to simulate.",
                "Give a longer recording, or a longer window of it.",
            )
        runs.append(run if fresh_bodies else replace(run, earlier=earlier_motion(whole.values(), run)))
        whole[part.path] = replace(whole[part.path], notes=(), doubts=())  # reported once
    return runs[: len(bags)], runs[len(bags) :]


def load_run(rig: Rig, path: Path, despite: Collection[str] = ()) -> Run:
    """Read a bag, or a window of one, and line it up with a rig: with all that there is to report on how it was read.
    Raises ``RecordingError`` when nothing can be compared, or what it says cannot be (:func:`read_run`)."""
    part = part_of(Path(path))
    return window_of(rig, read_run(rig, part.path, despite), part)


def read_run(rig: Rig, path: Path, despite: Collection[str] = ()) -> Run:
    """Read a bag and line it up with a rig; what is about some times only is left to be reported of the window that is
    used. Readings that :func:`sysid.observations.checks.examine` finds faulty are left out.

    Raises ``RecordingError`` when nothing can be compared, and where a finding makes a fit meaningless, unless
    ``despite`` has its name."""
    topics = open_bag(Path(path), Notes(), rig.table_columns).topics
    check_topics(rig, path, topics)
    recording = read_recording(path, topics_of(rig, topics)[0], need_pose=bool(rig.end_effectors))
    findings, recording = examine(in_rig_axes(rig, recording), rig)
    breaks: list[tuple[float, RecordingError]] = []
    for found in findings:
        if found.severity == "stops a fit" and found.name not in despite:
            stop = RecordingError(
                " ".join(filter(None, [f"{path}: {found.channel}: {found.problem}", unlike_rig(findings)])),
                f"{found.remedy} To go on all the same: --despite {found.name}.",
            )
            if not found.breaks:
                raise stop
            breaks += [(t, stop) for t in found.times]
    return replace(lined_up(rig, recording, findings, path), breaks=tuple(breaks))


def unlike_rig(findings: Sequence[Finding]) -> str:
    """In what a recording differs from those of the rig, in words."""
    unlike = " ".join(found.problem for found in findings if found.of_another_rig)
    return unlike + " Give the rig that it was recorded with, if that is another one." if unlike else ""


def lined_up(rig: Rig, recording: Recording, findings: Sequence[Finding], path: Path) -> Run:
    """Line a recording up with its rig: in the rig's axes, without the readings that ``findings`` say are faulty.
    Raises ``RecordingError`` when nothing can be compared."""
    names, missing = topics_of(rig, recording.provenance.message_counts)
    unlike = unlike_rig(findings)
    poses: dict[str, PoseTrajectory] = {}
    said_of_poses: list[str] = []
    for name in rig.end_effectors:
        effector = rig.end_effectors[name]
        commanded = recording.target_poses.get(name) if names.ee[name].target_pose else None
        stream = recording.poses[name] if effector.driven_by == "measured" else commanded
        if stream is None:
            raise RecordingError(
                f"{path}: end_effectors.{name} is driven by commanded poses, and the recording has none on "
                f"{effector.topics.target_pose}.",
                "Record them, or set driven_by: measured in the rig.",
            )
        trajectory = PoseTrajectory.from_samples(
            stream.t,
            stream.position,
            stream.quaternion,
            max_gap_s=effector.topics.max_gap_s,
            source=f"{path}: {stream.topic}",
        )
        by_command = stream is recording.target_poses.get(name)
        poses[name] = trajectory if by_command else trajectory.smoothed()
        said_of_poses.extend(_clock_notes(stream.topic, trajectory, poses[name]))
        said_of_poses.extend(_corner_notes(stream.topic, poses[name]))
    recorded = tuple(_measured(rig, recording))
    measured, blanked = while_posed(rig, poses, recorded)
    if not measured:
        raise RecordingError(
            f"{path}: nothing was measured while the poses of the end effectors were recorded.",
            "Record poses and sensors together, with one clock.",
        )
    firsts, missed = first_frames(rig, poses, measured)
    if firsts:
        placed(build_scene(rig), firsts)  # every marker is seen on its sheet
    notes = [*recording.notes, *(as_note(found) for found in findings if not found.of_another_rig)]
    said = [note for note in notes if not note.times]
    lacking = tuple(f"{topic}: named by the rig, not in this recording" for topic in missing)
    return Run(
        name=Path(path).name,
        path=str(path),
        sha256=tuple(f.sha256 for f in recording.provenance.files),
        poses=poses,
        measured=measured,
        end=float(max(m.t[-1] for m in measured)),
        notes=(
            *merged_notes(said),
            *lacking,
            *said_of_poses,
            *([unlike] if unlike else []),
            *blanked,
            *missed,
        ),
        firsts=firsts,
        unlike=unlike,
        doubts=tuple(merged_notes([note for note in said if note.severity == "warning"])),
        lacking=lacking,
        counted=tuple(note for note in notes if note.times),
        span_ns=(recording.t0_ns, recording.t0_ns + round(1e9 * recording.duration)),
        parted=tuple((e.t, e.t + e.lasts_s) for e in recording.events if e.name == "parted"),
    )


def as_note(found: Finding) -> Note:
    """A finding as a remark on the recording."""
    severity: Severity = "info" if found.severity == "note" else "warning"
    return Note(severity, found.channel, found.text, times=found.times)


def _clock_notes(topic: str, stamped: PoseTrajectory, taken: PoseTrajectory) -> list[str]:
    """A note if poses are taken at the ticks of a clock and not at their stamps."""
    if taken.times is stamped.times:
        return []
    jitter_ms, rate_hz = 1e3 * np.std(stamped.times - taken.times), 1.0 / np.median(np.diff(taken.times))
    return [
        f"{topic}: the stamps jitter by {jitter_ms:.2g} ms about the ticks of a clock of {rate_hz:.4g} Hz, where the "
        "poses are on a smoother motion; they are taken at the ticks."
    ]


def _corner_notes(topic: str, trajectory: PoseTrajectory) -> list[str]:
    """A note if poses are no smooth motion at their sampling interval somewhere."""
    if len(trajectory.times) < 2:
        return []
    times = trajectory.curve.inner_corners
    if not len(times):
        return []
    return [
        f"{topic}: {len(times)} of {len(trajectory.times)} poses, the first at {times[0]:.3f} s, are steps, gaps or "
        "sudden changes of velocity at the sampling interval; the motion between poses is not smoothed across them."
    ]


def while_posed(
    rig: Rig, poses: Mapping[str, PoseTrajectory], measured: Sequence[Measured]
) -> tuple[tuple[Measured, ...], tuple[str, ...]]:
    """The channels with samples that no pose belongs to as NaN, and a note for each such stretch.

    A stretch is before the first pose of an end effector or more than its ``max_gap_s`` after the last; a
    single pose is that of something that stands still. Channels without any other sample are left out.
    """
    kept, notes = [], []
    for m in measured:
        had = np.isfinite(m.values).any(axis=1)
        covered = np.ones(len(m.t), dtype=bool)
        for name, trajectory in poses.items():
            if len(trajectory.times) < 2:
                continue
            begin, end = float(trajectory.times[0]), float(trajectory.times[-1])
            gap = rig.end_effectors[name].topics.max_gap_s
            for outside, words, remedy in (
                (m.t < begin, f"before the first pose of {name} at {begin:.3f} s", "Start recording poses first."),
                (
                    m.t > end + gap,
                    f"more than {gap:g} s after the last pose of {name} at {end:.3f} s",
                    "Record poses to the end, or raise topics.max_gap_s where it stands still.",
                ),
            ):
                covered &= ~outside
                lost = m.t[outside & had]
                if len(lost):
                    notes.append(
                        f"{m.channel}: {len(lost)} samples from {lost[0]:.3f} to {lost[-1]:.3f} s are not compared, "
                        f"{words}. {remedy}"
                    )
        if (covered & had).any():
            kept.append(replace(m, values=np.where(covered[:, None], m.values, np.nan)))
    return tuple(kept), tuple(notes)


def _measured(rig: Rig, recording: Recording) -> Sequence[Measured]:
    out = []
    for name, wrench in recording.wrenches.items():
        gauge = rig.sensors[name]
        assert isinstance(gauge, WrenchSensor)
        measured = np.array([c in gauge.measures for c in WRENCH_COMPONENTS])
        values = np.where(measured, np.hstack([wrench.force, wrench.torque]), np.nan)
        labels = tuple(c.replace("_", " ") for c in WRENCH_COMPONENTS)
        out.append(Measured(name, "wrench", wrench.t, values, labels))
    numbers = marker_numbers(rig)
    for name, markers in recording.markers.items():
        ids = numbers[name]
        values = _by_id(markers.position, markers.ids, ids, name, recording)
        out.append(Measured(name, "markers", markers.t, values, _labels(ids, "xyz")))
    for name, tracks in recording.tracks.items():
        camera, ids = rig.cameras[name], numbers[name]
        values = _by_id(tracks.uv, tracks.ids, ids, name, recording)
        if isinstance(camera, OrthographicCamera) and camera.origin_id is not None:
            values = _from_origin(values, camera)
        out.append(Measured(name, "tracks", tracks.t, values, _labels(ids, "uv")))
    return out


def _from_origin(values: np.ndarray, camera: OrthographicCamera) -> np.ndarray:
    """Tracks [px] ``(n, 2 m)`` counted from the last marker, which is then not compared (NaN)."""
    uv = values.reshape(len(values), -1, 2)
    out = uv - uv[:, -1:] + [camera.cx_px, camera.cy_px]
    out[:, -1] = np.nan
    return np.asarray(out.reshape(values.shape))


def _labels(ids: np.ndarray, axes: str) -> tuple[str, ...]:
    return tuple(f"marker {i} {a}" for i in ids for a in axes)


def _by_id(values: np.ndarray, recorded: np.ndarray, wanted: np.ndarray, name: str, recording: Recording) -> np.ndarray:
    """Columns in the order of the rig's markers; NaN for those that the bag does not have."""
    places = {int(i): k for k, i in enumerate(recorded)}
    found = [places.get(int(i)) for i in wanted]
    if all(f is None for f in found):
        raise RecordingError(
            f"{recording.provenance.path}: of the markers of {name} the rig knows none: "
            f"{numbers_apart(recorded, wanted)}",
            "Give the rig that it was recorded with, or the marker numbers with 'ids' in this one.",
        )
    out = np.full((len(values), len(wanted), values.shape[2]), np.nan)
    for k, f in enumerate(found):
        if f is not None:
            out[:, k] = values[:, f]
    return out.reshape(len(values), -1)
