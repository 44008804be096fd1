"""A trajectory as a table that a control loop reads in no time. No ROS."""

from __future__ import annotations

import math

import numpy as np

from sim_core.trajectories import Trajectory
from thinshell_ros.replay.guard import Placed

TABLE_S = 0.002
"""Interval [s] of the table; between its rows poses are interpolated linearly."""

MAX_ROWS = 4_000_000


class Setpoints:
    """Poses, and gripper closings [m], of all end effectors at any time [s] of a trajectory."""

    def __init__(self, trajectory: Trajectory) -> None:
        self.duration_s = trajectory.duration_s
        count = min(max(math.ceil(self.duration_s / TABLE_S), 1), MAX_ROWS)
        times = np.linspace(0.0, self.duration_s, count + 1)
        self._step = self.duration_s / count
        self._tables = {name: np.hstack(path.sample(times)) for name, path in trajectory.poses().items()}
        self._closings = {
            name: np.interp(times, trajectory.times_s, path.gripper_closing_m)
            for name, path in trajectory.end_effectors.items()
            if path.gripper_closing_m is not None
        }

    def poses(self, time_s: float) -> dict[str, Placed]:
        """Pose of each end effector; held before the start and after the end."""
        row, share = self._row(time_s)
        found = {}
        for name, table in self._tables.items():
            values = ((1.0 - share) * table[row] + share * table[row + 1]).tolist()
            length = math.hypot(*values[3:])
            found[name] = Placed(tuple(values[:3]), tuple(value / length for value in values[3:]))
        return found

    def closings(self, time_s: float) -> dict[str, float]:
        """Closing [m] of each gripper that the trajectory moves."""
        row, share = self._row(time_s)
        return {n: float((1.0 - share) * table[row] + share * table[row + 1]) for n, table in self._closings.items()}

    def _row(self, time_s: float) -> tuple[int, float]:
        whole = min(max(time_s, 0.0), self.duration_s) / self._step
        row = min(int(whole), round(self.duration_s / self._step) - 1)
        return row, whole - row
