"""Simulated time against the wall clock. No ROS."""

from __future__ import annotations

from collections import deque

SLACK_S = 0.1
"""A simulation that is late by up to this [s] catches up by itself; beyond it simulated time stays behind."""

MOST_LAG_S = 2.0
"""A simulation that is always too slow is behind the wall clock by at most so much [s]; the rest is left out."""

KEEPS_UP_S = 0.5
"""A simulation that has fallen behind keeps up again when it ran at the wanted pace for so long [s of wall time]."""

WINDOW_S = 2.0
"""The real-time factor is measured over the last seconds of wall time."""


class Pacer:
    """When the next step is due. All wall times [s] are passed in, from one monotonic clock.

    Simulated time falls behind while steps take longer than they should. As soon as they do not any more, what was lost
    is left out at once: simulated time goes on where it is, and ``skipped_s`` grows, so that simulated time plus
    ``skipped_s`` is the wall clock's time again. ``factor``: wanted simulated time per wall time, 0 for no pace at all.
    ``catches_up``: without it nothing that is lost is caught up, so that simulated time never runs faster than wanted.
    """

    def __init__(self, factor: float = 1.0, catches_up: bool = True) -> None:
        self._factor, self._catches_up = factor, catches_up
        self._wall = 0.0
        self._simulated = 0.0
        self._samples: deque[tuple[float, float]] = deque()
        self.lag_s = 0.0
        """Wall time [s] by which simulated time is behind."""
        self.skipped_s = 0.0
        """Wall time [s] that simulated time has left out since the start."""

    def start(self, wall: float, simulated: float) -> None:
        """Simulated time goes on from ``simulated`` [s] at wall time ``wall`` [s]. By what it is behind, since steps
        were slow or it stood still, is left out."""
        if self._samples and self._factor > 0.0:
            self._leave_out(wall, simulated)
        self._wall, self._simulated = wall, simulated
        self._samples.clear()
        self._samples.append((wall, simulated))

    def wait_s(self, wall: float, simulated: float, dt: float) -> float:
        """Wall time [s] until a step of ``dt`` [s] from ``simulated`` is due, which is at its end; 0 when late.

        To be called before every step.
        """
        self._samples.append((wall, simulated))
        while len(self._samples) > 2 and wall - self._samples[1][0] > WINDOW_S:
            self._samples.popleft()
        if self._factor == 0.0:
            return 0.0
        early = self._early(wall, simulated + dt)
        self.lag_s = max(-early, 0.0)
        if self._lost(wall, simulated):
            self._leave_out(wall, simulated)
        return max(early, 0.0)

    def _lost(self, wall: float, simulated: float) -> bool:
        """Whether what it is behind is to be left out."""
        if not self._catches_up or self.lag_s > MOST_LAG_S:
            return self.lag_s > 0.0
        return self.lag_s > SLACK_S and self._keeps_up(wall, simulated)

    def _early(self, wall: float, simulated: float) -> float:
        return (simulated - self._simulated) / self._factor - (wall - self._wall)

    def _leave_out(self, wall: float, simulated: float) -> None:
        self.skipped_s += max(-self._early(wall, simulated), 0.0)
        self.lag_s = 0.0
        self._wall, self._simulated = wall, simulated

    def _keeps_up(self, wall: float, simulated: float) -> bool:
        """Whether the last ``KEEPS_UP_S`` of steps, which did not wait, were as fast as wanted."""
        for then, at in reversed(self._samples):
            if wall - then >= KEEPS_UP_S:
                return simulated - at >= self._factor * (wall - then)
        return False

    def factor(self) -> float:
        """Simulated over wall time lately; 1 is real time, NaN right after a start."""
        (wall, simulated), (wall_end, simulated_end) = self._samples[0], self._samples[-1]
        elapsed = wall_end - wall
        return (simulated_end - simulated) / elapsed if elapsed > 0.0 else float("nan")
