"""Simulated time against the wall clock. No ROS."""

from __future__ import annotations

from collections import deque

SLACK_S = 0.1
"""A simulation that is late by up to this catches up; beyond it simulated time slows down instead."""

WINDOW_S = 2.0
"""The real-time factor is measured over the last seconds of wall time."""


class Pacer:
    """When the next step is due. All wall times [s] are passed in, from one monotonic clock."""

    def __init__(self) -> None:
        self._wall = 0.0
        self._simulated = 0.0
        self._samples: deque[tuple[float, float]] = deque()

    def restart(self, wall: float, simulated: float) -> None:
        """Simulated time goes on from ``simulated`` [s] at wall time ``wall`` [s]."""
        self._wall, self._simulated = wall, simulated
        self._samples.clear()
        self._samples.append((wall, simulated))

    def wait_s(self, wall: float, simulated: float) -> float:
        """Time [s] until the wall clock reaches ``simulated``; 0 when late. To be called every step."""
        self._samples.append((wall, simulated))
        while wall - self._samples[1][0] > WINDOW_S:
            self._samples.popleft()
        early = (simulated - self._simulated) - (wall - self._wall)
        if early < -SLACK_S:
            self._wall -= early + SLACK_S
        return max(early, 0.0)

    def factor(self) -> float:
        """Simulated over wall time lately; 1 is real time, NaN right after a restart."""
        (wall, simulated), (wall_end, simulated_end) = self._samples[0], self._samples[-1]
        elapsed = wall_end - wall
        return (simulated_end - simulated) / elapsed if elapsed > 0.0 else float("nan")
