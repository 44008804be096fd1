"""Which commanded poses are taken, and how far an end effector gets towards one in a step. No ROS."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]

UNIT_TOLERANCE = 1e-3
"""How far the length of a quaternion may be from 1."""


YEAR_S = 365.0 * 86400.0


def unstamped(stamp_s: float) -> str:
    """Why a command with a stamp [s] since 1970 is rejected, '' if it is not: a stamp of that year is none."""
    if stamp_s >= YEAR_S:
        return ""
    return (
        f"its stamp is {stamp_s:g} s after the beginning of 1970: have its publisher stamp it, with use_sim_time where "
        "/clock is published"
    )


@dataclass(frozen=True)
class Pose:
    """Position [m] ``(3,)`` and unit quaternion x y z w ``(4,)`` in the base frame."""

    position: Floats
    quaternion: Floats

    @classmethod
    def of(cls, values: Floats) -> Pose:
        """Pose from its seven numbers: x y z [m], x y z w."""
        return cls(values[:3], values[3:])

    def array(self) -> Floats:
        """The seven numbers."""
        return np.concatenate([self.position, self.quaternion])

    def rotation(self) -> Rotation:
        """The orientation."""
        return Rotation.from_quat(self.quaternion)


@dataclass(frozen=True)
class PoseGate:
    """What a commanded pose must fulfil.

    ``max_jump_m`` and ``max_jump_rad``: largest distance from the last command that was taken, or from where the end
    effector is: a stream of commands may go ahead of an end effector that its speed limit holds back.
    """

    base_frame: str
    max_jump_m: float
    max_jump_rad: float

    def check(
        self, frame_id: str, position: Sequence[float], quaternion: Sequence[float], now: Pose, last: Pose | None = None
    ) -> Pose | str:
        """The pose with a normalised quaternion, or why it is rejected.

        ``now``: pose of the end effector at this moment; ``last``: the last command that was taken.
        """
        if frame_id != self.base_frame:
            return f"frame_id is {frame_id!r}, expected {self.base_frame!r}"
        if not all(map(math.isfinite, (*position, *quaternion))):
            return f"not finite: position {list(position)}, orientation {list(quaternion)}"
        length = math.sqrt(sum(q * q for q in quaternion))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            return f"the orientation has length {length:.4g}, a quaternion x y z w has length 1"
        pose = Pose(np.array(position, dtype=np.float64), np.array(quaternion, dtype=np.float64) / length)
        near = [separation(start, pose) for start in ((now,) if last is None else (now, last))]
        if any(jump <= self.max_jump_m and turn <= self.max_jump_rad for jump, turn in near):
            return pose
        jump, turn = near[-1]
        whence = "current pose" if last is None else "last target"
        if jump > self.max_jump_m:
            return f"{jump:.4g} m away from the {whence}, at most {self.max_jump_m:g} m (max_jump_m)"
        return f"{turn:.4g} rad away from the {whence}, at most {self.max_jump_rad:g} rad (max_jump_rad)"


def velocity_fault(
    frames: tuple[str, str], linear: Sequence[float], angular: Sequence[float], most: tuple[float, float]
) -> str:
    """Why a commanded velocity [m/s] and angular velocity [rad/s] are rejected, '' if they are not. ``frames``: the one
    given and the one expected; ``most``: largest speed and turn rate."""
    if frames[0] != frames[1]:
        return f"frame_id is {frames[0]!r}, expected {frames[1]!r}"
    if not all(map(math.isfinite, (*linear, *angular))):
        return f"not finite: linear {list(linear)}, angular {list(angular)}"
    speed, turn = math.hypot(*linear), math.hypot(*angular)
    if speed > most[0]:
        return f"{speed:.4g} m/s, at most {most[0]:g} m/s (max_speed_m_s)"
    return f"{turn:.4g} rad/s, at most {most[1]:g} rad/s (max_turn_rate_rad_s)" if turn > most[1] else ""


def separation(start: Pose, end: Pose) -> tuple[float, float]:
    """Distance [m] and angle [rad] between two poses."""
    turn = float((start.rotation().inv() * end.rotation()).magnitude())
    return float(np.linalg.norm(end.position - start.position)), turn


def towards(now: Pose, target: Pose, max_move_m: float, max_turn_rad: float) -> Pose:
    """The pose reached on the way from ``now`` to ``target`` within a move and a turn of limited size."""
    way = target.position - now.position
    length = float(np.linalg.norm(way))
    position = target.position if length <= max_move_m else now.position + way * (max_move_m / length)
    turn = (target.rotation() * now.rotation().inv()).as_rotvec()
    angle = float(np.linalg.norm(turn))
    quaternion = target.quaternion
    if angle > max_turn_rad:
        turned = Rotation.from_rotvec(turn * (max_turn_rad / angle)) * now.rotation()
        quaternion = np.asarray(turned.as_quat(), dtype=np.float64)
    if float(quaternion @ now.quaternion) < 0.0:
        quaternion = -quaternion
    return Pose(position, quaternion)


def moved(now: Pose, linear: Floats, angular: Floats, seconds: float) -> Pose:
    """The pose after a time [s] with a velocity [m/s] and an angular one [rad/s], each ``(3,)``, in the base frame."""
    turned = Rotation.from_rotvec(angular * seconds) * now.rotation()
    return Pose(now.position + linear * seconds, np.asarray(turned.as_quat(), dtype=np.float64))
