"""Whether an end effector follows its commands: it has to be near where they were lately. No ROS."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

Numbers = tuple[float, ...]

STILL_SHARE = 0.1
"""An end effector that moved by less than this share of its tolerance stands still."""

FAST, JITTER_SHARE = 2.0, 0.25
"""A measured pose that moved by more than so many times what the fastest planned motion makes, and a share of its
tolerance for noise, has jumped."""

REMEMBERED = 3.0
"""A jump that was within what is allowed is what is wrong with poses that are not, for so many times the lag."""


@dataclass(frozen=True)
class Placed:
    """A pose as plain numbers: x y z [m], unit quaternion x y z w."""

    position: Numbers
    quaternion: Numbers


@dataclass(frozen=True)
class TrackingLimits:
    """How an end effector has to follow: within ``near_m``, ``near_rad`` of where its commands were within the last
    ``lag_s``; ``speed_m_s``, ``turn_rad_s``: fastest planned motion."""

    near_m: float
    near_rad: float
    lag_s: float
    speed_m_s: float = math.inf
    turn_rad_s: float = math.inf


class Track:
    """The commands and the measured poses of one end effector, all times [s] of one clock."""

    def __init__(self, name: str, limits: TrackingLimits, keep_s: float = 5.0) -> None:
        """``keep_s``: how far back a lag can be measured."""
        self._name, self.limits = name, limits
        self._keep = max(keep_s, 2.0 * limits.lag_s)
        self._commands: deque[tuple[float, Placed]] = deque()
        self._last: tuple[float, Placed, bool] | None = None
        self._still: tuple[float, Placed] | None = None
        self._step: tuple[float, str] | None = None
        self.jumped = False
        """Whether the last measured pose is farther from the one before than it can have moved."""
        self.error_m = math.nan
        """Distance of the last measured position from the commands of late [m]."""

    def begin(self, now: float, first: Placed) -> None:
        """A run begins, and this pose is commanded."""
        self._commands.clear()
        self._commands.append((now, first))
        self._still = self._step = None
        self._last = None

    def command(self, now: float, pose: Placed) -> None:
        """This pose is commanded from now on."""
        self._commands.append((now, pose))
        while len(self._commands) > 2 and self._commands[1][0] < now - self._keep:
            self._commands.popleft()

    def judge(self, stamp: float, arrival: float, pose: Placed) -> str:
        """What is wrong with a pose that was measured at its stamp and arrived later, '' if nothing is."""
        f, name = self.limits, self._name
        last, still = self._last, self._still
        if (
            still is None
            or math.dist(still[1].position, pose.position) > STILL_SHARE * f.near_m
            or (turn_between(still[1].quaternion, pose.quaternion) > STILL_SHARE * f.near_rad)
        ):
            self._still = still = (stamp, pose)
        recent = self._since(min(stamp, arrival) - f.lag_s)
        away, turn = nearest(recent, pose, f.near_m, f.near_rad)
        self.error_m = away
        fits = away <= f.near_m and turn <= f.near_rad
        self._last = (stamp, pose, fits)
        jump = self._jumped(last, stamp, pose) if last is not None and last[2] else ""
        self.jumped = bool(jump) and not fits
        if fits:
            if jump:
                self._step = (stamp, jump) if self._step is None else None  # else it has jumped back
            return ""
        if jump:
            return jump
        if self._step is not None and stamp - self._step[0] <= REMEMBERED * f.lag_s:
            return f"{self._step[1]} It is {away:.3g} m and {turn:.3g} rad away from where its commands were since."
        limits = f"at most {f.near_m:.3g} m and {f.near_rad:.3g} rad are allowed"
        if stamp - still[0] > f.lag_s:
            return (
                f"{name} has stood still for {stamp - still[0]:.2f} s, {away:.3g} m and {turn:.3g} rad away from where "
                f"its commands were within the last {f.lag_s:g} s: it does not follow, {limits}."
            )
        if (late := self._late(arrival, pose)) is not None:
            return (
                f"{name} follows its commands {late:.2f} s late, at most {f.lag_s:g} s is allowed: it is {away:.3g} m "
                f"and {turn:.3g} rad away from where they were within that time, {limits}."
            )
        return (
            f"{name} is {away:.4g} m and {turn:.3g} rad away from its path, where its commands were within the last "
            f"{f.lag_s:g} s, {limits}."
        )

    def _jumped(self, last: tuple[float, Placed, bool], stamp: float, pose: Placed) -> str:
        f, span = self.limits, max(stamp - last[0], 0.0)
        way, turn = math.dist(last[1].position, pose.position), turn_between(last[1].quaternion, pose.quaternion)
        for size, unit, speed, near in ((way, "m", f.speed_m_s, f.near_m), (turn, "rad", f.turn_rad_s, f.near_rad)):
            if size > (most := FAST * speed * span + JITTER_SHARE * near):
                return (
                    f"The measured pose of {self._name} jumped by {size:.3g} {unit} within {span:.3g} s, at most "
                    f"{most:.3g} {unit} is allowed: a reading is wrong, or it was pushed."
                )
        return ""

    def lately(self, now: float) -> list[Placed]:
        """Commands within the lag that is allowed."""
        return self._since(now - self.limits.lag_s)

    def _since(self, begin: float) -> list[Placed]:
        """Commands from a time on, and the one before."""
        found: list[Placed] = []
        for when, pose in reversed(self._commands):
            found.append(pose)
            if when <= begin:
                break
        return found

    def _late(self, now: float, pose: Placed) -> float | None:
        """By how much the end effector is late, if it is near an older command [s]."""
        for when, command in reversed(self._commands):
            if math.dist(command.position, pose.position) <= self.limits.near_m and (
                turn_between(command.quaternion, pose.quaternion) <= self.limits.near_rad
            ):
                return now - when if now - when > self.limits.lag_s else None
        return None


def nearest(path: list[Placed], pose: Placed, near_m: float = 0.0, near_rad: float = 0.0) -> tuple[float, float]:
    """Least distance [m] and least turn [rad], each by itself, of a pose from the line through poses, the newest first;
    where one is within ``near_m`` or ``near_rad``, the first least one of those."""
    away = _least([(one.position, one.position) for one in path[:1]], pose.position, near_m)
    turn = turn_between(path[0].quaternion, pose.quaternion)
    if len(path) > 1:
        away = _least([(a.position, b.position) for a, b in pairwise(path)], pose.position, near_m)
        # 2 |q - p|, the chord, is the turn between quaternions to third order.
        sides = [_same_side(pose.quaternion, one.quaternion) for one in path]
        turn = 2.0 * _least(list(pairwise(sides)), pose.quaternion, 0.5 * near_rad)
    return away, turn


def _least(segments: list[tuple[Numbers, Numbers]], point: Numbers, near: float) -> float:
    best = math.inf
    for start, end in segments:
        now = _from_segment(start, end, point)
        if best <= near and now > best:
            break
        best = min(best, now)
    return best


def _same_side(quaternion: Numbers, other: Numbers) -> Numbers:
    """The other quaternion, or its negative, whichever is nearer."""
    x, y, z, w = other
    a, b, c, d = quaternion
    return other if a * x + b * y + c * z + d * w >= 0.0 else (-x, -y, -z, -w)


def _from_segment(start: Numbers, end: Numbers, point: Numbers) -> float:
    if start == end:
        return math.dist(point, start)
    dot = length2 = 0.0
    for a, b, p in zip(start, end, point, strict=True):
        way = b - a
        dot += way * (p - a)
        length2 += way * way
    share = min(max(dot / length2, 0.0), 1.0) if length2 > 0.0 else 0.0
    return math.dist(point, [a + share * (b - a) for a, b in zip(start, end, strict=True)])


def turn_between(first: Numbers, second: Numbers) -> float:
    """Angle [rad] between two orientations."""
    dot = abs(sum(a * b for a, b in zip(first, second, strict=True)))
    return 2.0 * math.acos(min(dot / (math.hypot(*first) * math.hypot(*second)), 1.0))
