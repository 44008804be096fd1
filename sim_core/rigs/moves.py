"""What motions are made of: moves from rest to rest, and rests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs.fields import FloatArray
from sim_core.rigs.trajectory import MINIMUM_JERK_PEAK, Profile, minimum_jerk, trapezoidal, trapezoidal_timing


@dataclass(frozen=True)
class Move:
    """One move from rest to rest. ``turn`` acts about the end effector's origin.

    ``shift`` [m] ``(3,)`` and ``turn`` are along the axes named by ``own``; ``speed`` in m/s,
    ``turn_speed`` in rad/s, ``acceleration`` in m/s^2 (None: minimum jerk).
    """

    shift: FloatArray
    turn: Rotation
    own: bool
    speed: float
    turn_speed: float
    acceleration: float | None

    def timing(self) -> tuple[float, Profile]:
        """Duration [s] and profile."""
        distance, angle = float(np.linalg.norm(self.shift)), float(self.turn.magnitude())
        if self.acceleration is None:
            return MINIMUM_JERK_PEAK * max(distance / self.speed, angle / self.turn_speed), minimum_jerk
        duration, ramp = trapezoidal_timing(distance, self.speed, self.acceleration) if distance else (0.0, 0.5)
        turning, turn_ramp = 0.0, 0.5
        if angle:
            turn_acceleration = self.turn_speed * self.acceleration / self.speed
            turning, turn_ramp = trapezoidal_timing(angle, self.turn_speed, turn_acceleration)
        return (duration, trapezoidal(ramp)) if duration >= turning else (turning, trapezoidal(turn_ramp))


@dataclass(frozen=True)
class Rest:
    """Stand still for ``duration`` [s]."""

    duration: float


Step = Move | Rest
