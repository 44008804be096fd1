"""Ways as tables that a control loop reads in no time. No ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.rigs.trajectory import PoseTrajectory, minimum_jerk
from sim_core.trajectories import Trajectory
from thinshell_ros.replay.tracking import Placed

TABLE_S = 0.002
"""Interval [s] of the table; between its rows poses are interpolated linearly."""

MAX_ROWS = 4_000_000

BACK_SHARE = 0.5
"""Share of its speed with which a way is gone back from its middle, so that a start from rest stays within limits."""

HELD_S = 1.0
"""An end effector that is held is at most so far behind its commands [s]."""

RAMP_S = 0.5
"""Time [s] in which such a way back gets from rest to its speed, and from where it holds to the way."""


class Table:
    """Poses of end effectors, and gripper closings [m], between two times [s]; held before and after."""

    def __init__(self, poses: Mapping[str, PoseTrajectory], closings: Mapping[str, np.ndarray] | None = None) -> None:
        times = next(iter(poses.values())).times
        self.duration_s = float(times[-1])
        count = min(max(math.ceil(self.duration_s / TABLE_S), 1), MAX_ROWS)
        fine = np.linspace(0.0, self.duration_s, count + 1)
        self._step, self._count = self.duration_s / count, count
        self._tables = {name: np.hstack(path.sample(fine)) for name, path in poses.items()}
        self._closings = {name: np.interp(fine, times, values) for name, values in (closings or {}).items()}

    def poses(self, time_s: float) -> dict[str, Placed]:
        """Pose of each end effector."""
        row, share = self._row(time_s)
        found = {}
        for name, table in self._tables.items():
            values = ((1.0 - share) * table[row] + share * table[row + 1]).tolist()
            found[name] = _placed(values[:3], values[3:])
        return found

    def closings(self, time_s: float) -> dict[str, float]:
        """Closing [m] of each gripper that is moved."""
        row, share = self._row(time_s)
        return {n: float((1.0 - share) * table[row] + share * table[row + 1]) for n, table in self._closings.items()}

    def fastest(self) -> dict[str, tuple[float, float]]:
        """Largest speed [m/s] and angular speed [rad/s] of each end effector."""
        found = {}
        for name, table in self._tables.items():
            moves = np.linalg.norm(np.diff(table[:, :3], axis=0), axis=1)
            turns = 2.0 * np.linalg.norm(np.diff(table[:, 3:], axis=0), axis=1)
            found[name] = float(moves.max()) / self._step, float(turns.max()) / self._step
        return found

    def _row(self, time_s: float) -> tuple[int, float]:
        whole = min(max(time_s, 0.0), self.duration_s) / self._step
        row = min(int(whole), self._count - 1)
        return row, whole - row


class Setpoints:
    """All that a trajectory commands: its motion from time 0 [s] on, before that the way to its start."""

    def __init__(self, trajectory: Trajectory) -> None:
        closings = {
            name: path.gripper_closing_m
            for name, path in trajectory.end_effectors.items()
            if path.gripper_closing_m is not None
        }
        self._motion = Table(trajectory.poses(), closings)
        self._approach = None if trajectory.approach is None else Table(trajectory.approach.poses())
        self._retract = None if trajectory.retract is None else Table(trajectory.retract.poses())
        self.duration_s = self._motion.duration_s
        self.begin_s = 0.0 if self._approach is None else -self._approach.duration_s
        """When the way to the start begins."""

    def poses(self, time_s: float) -> dict[str, Placed]:
        """Pose of each end effector; held before the way to the start and after the end."""
        if time_s < 0.0 and self._approach is not None:
            return self._approach.poses(time_s - self.begin_s)
        return self._motion.poses(time_s)

    def closings(self, time_s: float) -> dict[str, float]:
        """Closing [m] of each gripper that the trajectory moves."""
        return self._motion.closings(time_s)

    def fastest(self) -> dict[str, tuple[float, float]]:
        """Largest speed [m/s] and angular speed [rad/s] of each end effector on all ways."""
        tables = [t.fastest() for t in (self._motion, self._approach, self._retract) if t is not None]
        return {n: (max(t[n][0] for t in tables), max(t[n][1] for t in tables)) for n in tables[0]}

    def way_back(self, time_s: float, held: Mapping[str, Placed], ended: bool) -> WayBack:
        """From the poses that are held at a time of the trajectory [s] to where the end effectors wait; ``ended``: the
        motion was gone to its end."""
        at = min(time_s, self.duration_s)
        if ended and self._retract is not None:
            return WayBack(held, self._retract, self, at)
        # End effectors that lag are held on a part of the way that was commanded before.
        lately = np.arange(at, max(at - HELD_S, self.begin_s) - TABLE_S, -TABLE_S).tolist()
        return WayBack(held, None, self, min(lately, key=lambda when: self._away(when, held)))

    def _away(self, time_s: float, held: Mapping[str, Placed]) -> float:
        """Sum of the squared distances of end effectors from where they are commanded to be at a time."""
        return sum(math.dist(pose.position, held[name].position) ** 2 for name, pose in self.poses(time_s).items())

    def rest_of(self, way: WayBack, gone_s: float, held: Mapping[str, Placed]) -> WayBack:
        """What is left of a way back that was ended after a time [s], from the poses that are held."""
        if way.planned is None:
            return WayBack(held, None, self, max(way.reached(gone_s), self.begin_s))
        return WayBack(held, way.planned, self, way.from_s, way.reached(gone_s))


@dataclass(frozen=True)
class WayBack:
    """The planned way back, or else the way that was come, from where the end effectors are ``held``.

    From within a way it is gone slower, and its speed rises from rest. ``skip_s``: how much of the planned one has been
    gone before.
    """

    held: Mapping[str, Placed]
    planned: Table | None
    came: Setpoints
    from_s: float
    skip_s: float = 0.0

    @property
    def duration_s(self) -> float:
        """How long it takes [s]."""
        if self.planned is None:
            return (self.from_s - self.came.begin_s) / BACK_SHARE + RAMP_S
        return (self.planned.duration_s - self.skip_s) / (BACK_SHARE if self.skip_s else 1.0) + RAMP_S

    def poses(self, time_s: float) -> dict[str, Placed]:
        """Pose of each end effector at a time since it began [s]."""
        path = self._path(time_s)
        share = float(minimum_jerk(np.array(min(max(time_s / RAMP_S, 0.0), 1.0))))
        if share >= 1.0:
            return path
        start = self._path(0.0)
        return {name: _moved(path[name], start[name], self.held[name], 1.0 - share) for name in path}

    def _path(self, time_s: float) -> dict[str, Placed]:
        at = self.reached(time_s)
        return self.came.poses(max(at, self.came.begin_s)) if self.planned is None else self.planned.poses(at)

    def reached(self, time_s: float) -> float:
        """How far it has been gone: the time on the planned way, or that of the trajectory to which it was gone back
        [s].

        Where the speed rises, it does so as 3 u^2 - 2 u^3 with u = t / RAMP_S: the way in the ramp is then
        RAMP_S (u^3 - u^4 / 2).
        """
        if self.planned is not None and not self.skip_s:
            return max(time_s - RAMP_S, 0.0)  # it begins at rest by itself
        u = min(max(time_s / RAMP_S, 0.0), 1.0)
        gone = BACK_SHARE * (RAMP_S * (u**3 - 0.5 * u**4) + max(time_s - RAMP_S, 0.0))
        return self.from_s - gone if self.planned is None else self.skip_s + gone


def _moved(path: Placed, start: Placed, held: Placed, share: float) -> Placed:
    """A pose, off by a share of what the pose that is held is off the start of the way."""
    position = [p + share * (h - s) for p, s, h in zip(path.position, start.position, held.position, strict=True)]
    sign = 1.0 if sum(a * b for a, b in zip(start.quaternion, held.quaternion, strict=True)) >= 0.0 else -1.0
    turned = [
        p + share * (sign * h - s) for p, s, h in zip(path.quaternion, start.quaternion, held.quaternion, strict=True)
    ]
    return _placed(position, turned)


def _placed(position: list[float], quaternion: list[float]) -> Placed:
    length = math.hypot(*quaternion)
    return Placed(tuple(position), tuple(value / length for value in quaternion))
