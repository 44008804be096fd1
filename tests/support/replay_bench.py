"""A session of a replay with a robot that follows exactly, from which readings can be made to differ."""

from __future__ import annotations

import math
from typing import Any

from replay_plant import DEPTH_M, LAG_S, NEAR_M, PERIOD_S, SETTINGS, TRAJECTORY, UPRIGHT

from sim_core.rigs.trajectory import MINIMUM_JERK_PEAK
from sim_core.trajectories import Prediction, Trajectory
from thinshell_ros.replay.guard import GuardSettings
from thinshell_ros.replay.session import Session
from thinshell_ros.replay.streams import Instant
from thinshell_ros.replay.tracking import Placed

PEAK_M_S = MINIMUM_JERK_PEAK * DEPTH_M / 0.4
HELD_M = NEAR_M + PEAK_M_S * (LAG_S + 0.02)
"""Farthest from its command that an end effector may be where it holds."""

CALM = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


PLAIN = TRAJECTORY.model_copy(update={"predicted": Prediction()})
"""The press without a prediction."""


class Bench:
    """A session with a robot that follows exactly, from which readings can be made to differ."""

    def __init__(self, given: GuardSettings = SETTINGS, scale: float = 1.0, trajectory: Trajectory = PLAIN) -> None:
        self.session = Session(trajectory, given, ["pad"], scale)
        self.given = given
        self.at_s = 0.0
        self.jump_s = 0.0
        self.still_s: float | None = None

    @property
    def now(self) -> Instant:
        if self.still_s is not None:
            return Instant(self.at_s, self.still_s)
        return Instant(self.at_s, 1.7e9 + self.at_s + self.jump_s)

    def feed(
        self,
        *,
        away: float = 0.0,
        turn: float = 0.0,
        z: float | None = None,
        length: float = 1.0,
        frame: str = "base_link",
        wrench: Any = CALM,
        late: float = 0.0,
    ) -> None:
        """Readings of a robot that is where it should be, but for what is said."""
        commanded = self.session.commanded.get("hand", Placed((0.0, 0.0, 0.0), UPRIGHT))
        height = commanded.position[2] if z is None else z
        half = turn / 2.0
        pose = Placed((away, 0.0, height), (length * math.sin(half), 0.0, 0.0, length * math.cos(half)))
        self.session.take_pose("hand", self.now, self.now.ros_s - late, frame, pose)
        self.session.take_wrench("pad", self.now, self.now.ros_s - late, "pad", *wrench)

    def start(self) -> Bench:
        self.feed()
        assert self.session.execute(self.now) == ""
        return self

    def run(self, seconds: float) -> Bench:
        """Control periods in which all is well."""
        for _ in range(round(seconds / PERIOD_S)):
            self.at_s += PERIOD_S
            self.feed()
            self.session.tick(self.now)
        return self
