"""How end effectors get to the first pose of a motion and back from the last one, within the limits of the hands.

The approach is a straight minimum-jerk move from where the rig says that a hand waits. The way back is the way that was
come, without its rests, and without what was done between two rests at the same place: what was free to go is free to
come back, unless something was moved into it. A minimum-jerk move
over a way d in the time T has the peaks 15/8 d/T, 10/sqrt(3) d/T^2 and 60 d/T^3 (Flash & Hogan 1985).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import EndEffector, Rig
from sim_core.rigs.limits import Limits
from sim_core.rigs.trajectory import MINIMUM_JERK_PEAK, PoseTrajectory, minimum_jerk

RATE_HZ = 100.0
"""Samples of an approach per second."""

RESERVE = 0.05
"""Share of the limits that is left for the curve between samples."""

PAUSE = 3
"""Samples that are left of a rest, so that the curve through them comes to rest."""

NEAR_M, NEAR_RAD = 1e-6, 1e-6
"""Poses nearer than this, in each number, are the same one."""

Rows = dict[str, tuple[np.ndarray, np.ndarray]]
"""Positions [m] ``(k, 3)`` and quaternions ``(k, 4)`` by end effector."""

Place = tuple[np.ndarray, np.ndarray]
"""Position [m] ``(3,)`` and quaternion ``(4,)``."""


def move_time(way_m: float, turn_rad: float, limits: Limits) -> float:
    """Shortest time [s] of a minimum-jerk move over a way and a turn."""
    found = 0.0
    for way, bounds in (
        (way_m, (limits.max_speed_m_s, limits.max_acceleration_m_s2, limits.max_jerk_m_s3)),
        (
            turn_rad,
            (
                limits.max_angular_speed_rad_s,
                limits.max_angular_acceleration_rad_s2,
                limits.max_angular_jerk_rad_s3,
            ),
        ),
    ):
        for power, (peak, bound) in enumerate(
            zip((MINIMUM_JERK_PEAK, 10.0 / np.sqrt(3.0), 60.0), bounds, strict=True), 1
        ):
            if bound is not None:
                found = max(found, float((peak * way / ((1.0 - RESERVE) * bound)) ** (1.0 / power)))
    return found


def straight(starts: Mapping[str, Place], ends: Mapping[str, Place], limits: Mapping[str, Limits]) -> Any:
    """A passage from poses to others, all end effectors at once, as the data of a file; None where they are the
    same."""
    turns = {n: Rotation.from_quat(ends[n][1]) * Rotation.from_quat(starts[n][1]).inv() for n in ends}
    ways = {n: (float(np.linalg.norm(ends[n][0] - starts[n][0])), float(turns[n].magnitude())) for n in ends}
    if all(way <= NEAR_M and turn <= NEAR_RAD for way, turn in ways.values()):
        return None
    time = max(move_time(*ways[n], limits[n]) for n in ends)
    count = max(int(np.ceil(time * RATE_HZ)), 5)
    times = np.arange(count + 1) / RATE_HZ
    share = minimum_jerk(times / times[-1])
    rows = {
        name: (
            starts[name][0] + share[:, None] * (ends[name][0] - starts[name][0]),
            (
                Rotation.from_rotvec(share[:, None] * turns[name].as_rotvec()) * Rotation.from_quat(starts[name][1])
            ).as_quat(),
        )
        for name in ends
    }
    return _passage(times, rows)


def waiting_pose(effector: EndEffector) -> Place:
    """Where an end effector waits before and after a motion."""
    start, ready = effector.start, effector.ready
    return start.position() + ready.position(), (ready.rotation() * start.rotation()).as_quat()


def approach(rig: Rig, poses: Mapping[str, PoseTrajectory], limits: Mapping[str, Limits]) -> Any:
    """From where the hands of a rig wait to the first poses, as the data of a file; None where they wait there."""
    waiting = {name: waiting_pose(rig.end_effectors[name]) for name in poses}
    first = {name: (path.positions[0], path.quaternions[0]) for name, path in poses.items()}
    return straight(waiting, first, limits)


def retract(poses: Mapping[str, PoseTrajectory], times: np.ndarray, came: Any) -> Any:
    """Back from the last poses the way that was come, ``came`` the approach; None where they wait at the last poses."""
    parts = [_way_back(times, {name: path.sample(times) for name, path in poses.items()})]
    if came is not None:
        at, effectors = came["times_s"], came["end_effectors"]
        rows = {n: (p["positions_m"][::-1], p["quaternions_xyzw"][::-1]) for n, p in effectors.items()}
        parts.append((at[-1] - at[::-1], rows))
    times, rows = _joined(parts)
    return _passage(times, rows) if len(times) > 1 else None


def _way_back(times: np.ndarray, rows: Rows) -> tuple[np.ndarray, Rows]:
    """The shortest way back along samples that were passed, times from 0; one sample where it is at the start
    already."""
    values = np.hstack([np.hstack(pair) for pair in rows.values()])
    moves: np.ndarray = np.any(np.abs(np.diff(values, axis=0)) > 1e-12, axis=1)
    rests = np.flatnonzero(~np.append(moves, False) & ~np.append(False, moves) | (np.arange(len(times)) == 0))
    order, spans, at = [len(times) - 1], [0.0], len(times) - 1
    pause = float(np.median(np.diff(times)))
    while at > 0:
        resting = at == len(times) - 1 or not moves[at - 1]
        if resting:
            near = (np.abs(values[rests] - values[at]) < NEAR_M).all(axis=1)
            at = int(min(at, *rests[near])) if near.any() else at
            while at > 0 and not moves[at - 1]:
                at -= 1
            order += [at] * PAUSE
            spans += [pause] * PAUSE
        if at > 0:
            order.append(at - 1)
            spans.append(float(times[at] - times[at - 1]))
            at -= 1
    if len(set(order)) == 1 or not np.ptp(values[order], axis=0).max() > NEAR_M:
        order, spans = order[:1], spans[:1]
    else:
        order += [0] * PAUSE
        spans += [pause] * PAUSE
    return np.cumsum(spans), {name: (p[order], q[order]) for name, (p, q) in rows.items()}


def _joined(parts: Sequence[tuple[np.ndarray, Rows]]) -> tuple[np.ndarray, Rows]:
    """Ways one after the other; each begins where the one before ends."""
    times, rows = parts[0]
    for more_times, more in parts[1:]:
        times = np.concatenate([times, times[-1] + more_times[1:]])
        rows = {n: (np.vstack([p, more[n][0][1:]]), np.vstack([q, more[n][1][1:]])) for n, (p, q) in rows.items()}
    return times, rows


def _passage(times: np.ndarray, rows: Rows) -> dict[str, Any]:
    effectors = {name: {"positions_m": p, "quaternions_xyzw": q} for name, (p, q) in rows.items()}
    return {"times_s": times, "end_effectors": effectors}
