"""Windows of recordings: the presses that matter out of an hour, one to fit and another to hold out.

A window is simulated by itself, beside others, from rest where the end effectors are at its first instant. That is true
of what is held by end effectors or the world, if nothing moves and nothing touches then; what free bodies, plastic
folds and relaxing gels remember of the time before is not in the data. A window that begins while something moves, or
whose readings then are not those of rest, says so: as they have changed since the start of the recording, so must they
in the simulation of both instants at rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError, RecordingError
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import Scene, build_scene
from sim_core.simulate import simulate
from sysid.fit.noise import channel_noise
from sysid.fit.runs import Run
from sysid.parts import Part
from sysid.streams import predicted

STILL_S = 0.2
"""Time before a window in which nothing should move."""

FAR_OFF = 6.0
"""Difference from rest, over its standard deviation, that is told."""

STILL_M, STILL_DEG = 1e-4, 0.1
"""Motion of an end effector in that time below which it stands still."""


def window_of(rig: Rig, run: Run, part: Part) -> Run:
    """The readings of a run in a window, its time counted from there. Raises ``RecordingError`` where there are none,
    and ``ConfigError`` where it cannot be known how the window begins."""
    if part.whole:
        return run
    measured = []
    for m in run.measured:
        inside = (m.t >= part.begin) & (m.t <= part.end)
        if np.isfinite(m.values[inside]).any():
            measured.append(replace(m, t=m.t[inside] - part.begin, values=m.values[inside]))
    if not measured:
        raise RecordingError(
            f"{part.path}: nothing was measured from {part.begin:g} to {part.end:g} s.",
            f"The recording has readings until {run.end:.3f} s.",
        )
    poses = {n: PoseTrajectory(p.times - part.begin, p.positions, p.quaternions) for n, p in run.poses.items()}
    notes = (*run.notes, *_how_it_begins(rig, run, poses, part.begin)) if part.begin > 0.0 else run.notes
    end = float(max(m.t[-1] for m in measured))
    return replace(run, poses=poses, measured=tuple(measured), end=end, notes=notes)


def _how_it_begins(rig: Rig, run: Run, poses: Mapping[str, PoseTrajectory], begin: float) -> Sequence[str]:
    """What speaks against rest at ``begin`` of the run, where the ``poses`` count from."""
    rig = run.seen_by(rig)
    scene = build_scene(rig)
    if not scene.all_held:
        raise ConfigError(
            f"The rig {rig.name} has bodies that lie free, and where they are when a window begins is not recorded.",
            "Begin the window at 0 s, or use the whole recording.",
        )
    notes = []
    for name, trajectory in poses.items():
        (before, now), (there, here) = trajectory.sample(np.array([-STILL_S, 0.0]))
        way = float(np.linalg.norm(now - before))
        turn = float(np.degrees((Rotation.from_quat(there).inv() * Rotation.from_quat(here)).magnitude()))
        if way > STILL_M or turn > STILL_DEG:
            notes.append(
                f"The window begins while {name} moves ({1e3 * way:.2g} mm and {turn:.2g} deg in the {STILL_S:g} s "
                "before), but is simulated from rest. Begin it where the hand stands still."
            )
    return [*notes, *_not_at_rest(rig, scene, run, poses, begin)]


def _still_until(trajectory: PoseTrajectory) -> float:
    """Time [s] until which an end effector has stood still since the start of a recording."""
    first = Rotation.from_quat(trajectory.quaternions[0])
    turned = np.degrees((first.inv() * Rotation.from_quat(trajectory.quaternions)).magnitude())
    moved = np.linalg.norm(trajectory.positions - trajectory.positions[0], axis=1)
    stood = np.logical_and.accumulate((moved < STILL_M) & (turned < STILL_DEG))
    return float(trajectory.times[stood][-1])


def _not_at_rest(rig: Rig, scene: Scene, run: Run, poses: Mapping[str, PoseTrajectory], begin: float) -> Sequence[str]:
    """A note for each channel whose readings before ``begin`` are not those of rest."""
    noise, still = channel_noise(rig, [run]), min(_still_until(p) for p in run.poses.values())
    rest = [simulate(scene, p, np.zeros(1)) for p in (run.poses, poses)]
    notes = []
    for m in run.measured:
        stretches = [m.values[m.t <= still], m.values[(m.t >= begin - STILL_S) & (m.t <= begin)]]
        counts = [np.isfinite(stretch).sum(axis=0) for stretch in stretches]
        seen = np.flatnonzero((counts[0] > 0) & (counts[1] > 0))
        if not len(seen):
            continue
        first, before = (np.nanmean(stretch[:, seen], axis=0) for stretch in stretches)
        start, there = (predicted(trace, rig, m.channel, np.zeros(1)).ravel()[seen] for trace in rest)
        sigma = np.broadcast_to(noise[m.channel].sigma, m.values.shape[1:])[seen]
        scatter = sigma * np.sqrt(1.0 / counts[0][seen] + 1.0 / counts[1][seen])
        off = np.nan_to_num(np.abs((before - first) - (there - start)) / scatter)
        worst = int(np.argmax(off))
        if off[worst] > FAR_OFF:
            notes.append(
                f"{m.channel}: {m.labels[seen[worst]]} is {off[worst]:.0f} standard deviations from rest where the "
                f"window begins, at {begin:g} s. Something touches there, or remembers what was before: begin where "
                "nothing touches."
            )
    return notes
