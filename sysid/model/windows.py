"""Windows of recordings: the presses that matter out of an hour, one to fit and another to hold out.

A window is simulated by itself, apart from others, from rest where the end effectors are at its first instant. That is
true of what is held by end effectors or the world, if nothing moves and nothing touches then. History variables that
stay come from the motion before (:mod:`sysid.model.sequence`); where free bodies lie, and what relaxes, does not. A
window that begins while something moves says so. So does one whose readings then are not those of rest: as they have
changed since the start of the recording, so must they in simulations of both instants at rest, by the rig that was
fitted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sim_core.errors import ConfigError, RecordingError, ThinshellError
from sim_core.rigs import Rig, WrenchSensor
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import simulate
from sysid.model.marker_registration import placed
from sysid.model.sensor_streams import predicted
from sysid.model.sequence import LeftBefore
from sysid.noise.estimate import channel_noise
from sysid.noise.stillness import moving
from sysid.observations.observations import Change, Measured, Run
from sysid.observations.rig_match import span_of
from sysid.observations.selection import Part
from sysid.recording.notes import merged_notes
from sysid.settings.model import MODEL


def window_of(rig: Rig, run: Run, part: Part) -> Run:
    """The readings of a run in a window, its time counted from there. Raises ``RecordingError`` where there are none,
    and ``ConfigError`` where it cannot be known how the window begins."""
    for at, stop in run.breaks:
        if part.begin < at < min(part.end, run.end):
            raise stop
    counted = [n for n in (note.between(part.begin, part.end) for note in run.counted) if n.times]
    doubts = merged_notes([n for n in counted if n.severity == "warning"])
    notes = merged_notes(counted)
    when = "" if part.whole else f" from {part.begin:g} to {part.end:g} s"
    measured = []
    for m in run.measured:
        inside = (m.t >= part.begin) & (m.t < part.end)
        lacking, matters = _without_reading(rig, m, m.values[inside], when)
        notes += filter(None, [lacking])
        doubts += [lacking] if matters else []
        if np.isfinite(m.values[inside]).any():
            measured.append(replace(m, t=m.t[inside] - part.begin, values=m.values[inside]))
    if part.whole:
        return replace(run, notes=(*run.notes, *notes), doubts=(*run.doubts, *doubts))
    if not measured:
        raise RecordingError(
            f"{part.path}: nothing was measured from {part.begin:g} to {part.end:g} s.",
            f"The recording has readings until {run.end:.3f} s.",
        )
    if part.end > run.end:
        notes.append(f"The window ends at {part.end:g} s, the recording's readings at {run.end:.3f} s.")
    poses = {n: p.since(part.begin) for n, p in run.poses.items()}
    changes: dict[str, Change] = {}
    if part.begin > 0.0:
        if not build_scene(rig).all_held:
            raise ConfigError(
                f"The rig {rig.name} has bodies that lie free, and where they are when a window begins is not "
                "recorded.",
                "Begin the window at 0 s, or use the whole recording.",
            )
        for name, trajectory in run.poses.items():
            if any(end > part.begin - MODEL.window_rest_s for _, end in moving(_until(trajectory, part.begin))):
                notes.append(
                    f"{name} moves in the {MODEL.window_rest_s:g} s before the window begins, which is simulated from "
                    "rest. Begin it where the hand stands still."
                )
        changes = _changes(rig, run, part.begin)
    return replace(
        run,
        poses=poses,
        measured=tuple(measured),
        end=float(max(m.t[-1] for m in measured)),
        notes=(*run.notes, *notes),
        since=part.begin,
        until=part.end,
        changes=changes,
        doubts=(*run.doubts, *doubts),
        parted=tuple(
            (max(begin, part.begin) - part.begin, min(end, part.end) - part.begin)
            for begin, end in run.parted
            if begin < part.end and end >= part.begin
        ),
    )


def _without_reading(rig: Rig, measured: Measured, inside: np.ndarray, when: str) -> tuple[str, bool]:
    """What a channel has no reading of among those ``inside`` a window ``(n, m)``, in words, '' if nothing, and whether
    that may change a result: the whole channel, or a component that the rig says is measured, not a marker out of
    sight."""
    seen = np.isfinite(inside).any(axis=0)
    if not seen.any():
        return f"{measured.channel}: no reading{when}", True
    lost = {label for label, there in zip(measured.labels, seen, strict=True) if not there}
    if measured.kind == "wrench":
        gauge = rig.sensors[measured.channel]
        assert isinstance(gauge, WrenchSensor)
        silent = ", ".join(c.replace("_", " ") for c in gauge.measures if c.replace("_", " ") in lost)
        words = (
            f"{measured.channel}: no reading of {silent}{when}, which the rig says to be measured. Look at the sensor, "
        )
        return (words + "or leave it out of 'measures' in the rig." if silent else ""), bool(silent)
    once = np.isfinite(measured.values).any(axis=0)
    gone = np.unique([int(measured.labels[k].split()[1]) for k in np.flatnonzero(once & ~seen)])
    return (f"{measured.channel}: no reading of the markers {span_of(gone)}{when}" if len(gone) else ""), False


def _until(trajectory: PoseTrajectory, end: float) -> PoseTrajectory:
    """The poses until ``end`` [s], at least one: what comes later is no motion before."""
    count = max(1, int(np.searchsorted(trajectory.times, end, side="right")))
    return trajectory.part(slice(0, count))


def _changes(rig: Rig, run: Run, begin: float) -> dict[str, Change]:
    """How readings before ``begin`` differ from those before anything moved, for channels that have both."""
    noise = channel_noise(rig, [run])
    still = min((span[0] for p in run.poses.values() for span in moving(p)[:1]), default=np.inf)
    found = {}
    for m in run.measured:
        parts = [
            m.values[(m.t <= still) & (m.t < begin - MODEL.window_rest_s)],
            m.values[(m.t >= begin - MODEL.window_rest_s) & (m.t < begin)],
        ]
        counts = [np.isfinite(values).sum(axis=0) for values in parts]
        columns = np.flatnonzero((counts[0] > 0) & (counts[1] > 0))
        if not len(columns):
            continue
        first, before = (np.nanmean(values[:, columns], axis=0) for values in parts)
        sigma, more = noise[m.channel].sigma[columns], noise[m.channel].long_run[columns]
        alone = [np.maximum(1.0, count[columns] / more) for count in counts]
        found[m.channel] = Change(columns, before - first, sigma * np.sqrt(1.0 / alone[0] + 1.0 / alone[1]))
    return found


def not_from_rest(rig: Rig, run: Run) -> list[str]:
    """A note for each channel whose readings where a window begins are not those of rest, by a rig that was fitted."""
    if not run.changes:
        return []
    scene = build_scene(rig)
    rig = placed(scene, run.firsts)
    scene.use(rig)
    at_first = {n: p.since(-run.since) for n, p in run.poses.items()}
    ends: list[Mapping[str, np.ndarray]] = []
    before = LeftBefore()
    others = replace(run, earlier=tuple(r for r in run.earlier if r.path != run.path))
    for poses, since, there in ((at_first, 0.0, others), (run.poses, run.since, run)):
        try:
            left = before.of(scene, there, rig.solver.dt_s, 1)
            trace = simulate(scene, poses, np.zeros(1), left=left)
        except ThinshellError as error:
            return [f"Whether the window begins at rest is not known: {error.problem}"]
        ends.append({c: predicted(trace, rig, c, np.zeros(1), since).ravel() for c in run.changes})
    notes = []
    for m in run.measured:
        if m.channel not in run.changes:
            continue
        change = run.changes[m.channel]
        expected = (ends[1][m.channel] - ends[0][m.channel])[change.columns]
        off = np.nan_to_num(np.abs(change.mean - expected) / change.scatter)
        worst = int(np.argmax(off))
        if off[worst] > MODEL.window_rest_sd:
            notes.append(
                f"{m.channel}: {m.labels[change.columns[worst]]} is {off[worst]:.0f} standard deviations from rest "
                "where the window begins. Something touches there, or remembers what was before, or the sensor has "
                "drifted: begin where nothing touches."
            )
    return notes
