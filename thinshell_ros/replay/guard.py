"""What must hold while a trajectory is replayed, and where to hold when it does not. No ROS and no clock of its own.

Two clocks are passed in: a steady one, by which arrivals and the control loop are timed, and that of ROS, which stamps
follow and which may jump. Every reading is judged when it arrives, so that none is missed between two control periods;
silence, the clocks and the loop itself are judged in each period.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim_core.trajectories import Limits
from thinshell_ros.poses import UNIT_TOLERANCE

Numbers = tuple[float, ...]

SILENT_S = 2.0
"""With simulated time, which may be slow, readings are also too old when none has come for so long by the wall [s]."""

LATE_PERIODS = 3.0
"""A control loop that is late by more than so many periods, and by more than the time-out of poses, has stood still."""


@dataclass(frozen=True)
class Instant:
    """The same moment by a steady clock and by that of ROS [s]."""

    steady_s: float
    ros_s: float


@dataclass(frozen=True)
class Placed:
    """A pose as plain numbers: x y z [m], unit quaternion x y z w."""

    position: Numbers
    quaternion: Numbers


@dataclass(frozen=True)
class GuardSettings:
    """What is guarded. Lengths [m], angles [rad], times [s].

    ``period_s``: of control. ``tracking_*``: largest distance between the commanded and the measured pose; ``start_*``:
    between the first pose and the measured one. ``pose_timeout_s``, ``wrench_timeout_s``: largest age of a reading, by
    its arrival, and with ``check_stamps`` also by its stamp. ``clock_tolerance_s``: largest step of the ROS clock
    against the steady one, or with ``simulated_time`` in itself within a period. ``moves``: commands are carried out;
    without it, as in a dry run, nothing tracks them.
    """

    limits: Limits
    period_s: float = 0.01
    tracking_tolerance_m: float = 0.01
    tracking_tolerance_rad: float = 0.1
    start_tolerance_m: float = 0.002
    start_tolerance_rad: float = 0.02
    pose_timeout_s: float = 0.1
    wrench_timeout_s: float = 0.1
    clock_tolerance_s: float = 0.1
    check_stamps: bool = True
    simulated_time: bool = False
    moves: bool = True


@dataclass
class _Stream:
    """Readings of one topic. ``heard``: when the last good one arrived; ``fault``: what is wrong with the last one."""

    name: str
    timeout_s: float
    settings: GuardSettings
    heard: Instant | None = None
    stamp: float = -math.inf
    fault: str = ""

    def take(self, now: Instant, stamp_s: float, fault: str, running: bool) -> bool:
        """Count a reading that has arrived; returns whether it is a good one.

        In a run, one that is not newer than the last one does not count: a driver that hangs may repeat itself. Before
        a run, time may begin anew.
        """
        if self.settings.check_stamps:
            if stamp_s <= 0.0:
                fault = (
                    fault or f"{_head(self.name)} has no stamp. Have its publisher stamp it, or leave check_stamps out."
                )
            elif running and stamp_s <= self.stamp:
                return False
        self.fault = fault
        if fault:
            return False
        self.heard, self.stamp = now, stamp_s
        return True

    def silence(self, now: Instant) -> str:
        """What is wrong with its age, '' if nothing is."""
        if self.heard is None:
            return f"No reading of {self.name} has come. Check its topic and that it is published."
        age, most = now.steady_s - self.heard.steady_s, self.timeout_s
        if self.settings.simulated_time and age <= SILENT_S:
            age = now.ros_s - self.heard.ros_s
        if age > most:
            return f"The last reading of {self.name} came {age:.3f} s ago, at most {most:g} s is allowed."
        old = now.ros_s - self.stamp
        if self.settings.check_stamps and abs(old) > most:
            if age > 0.5 * old > 0.0:
                return f"The last reading of {self.name} is from {old:.3f} s ago, at most {most:g} s is allowed."
            when = "old" if old > 0.0 else "in the future"
            return (
                f"The stamp of {self.name} is {abs(old):.3f} s {when}, at most {most:g} s is allowed. "
                "Synchronise the clocks of the machines."
            )
        return ""


class Guard:
    """Watches the poses of ``effectors`` (name to base frame) and the wrenches of ``sensors``."""

    def __init__(self, settings: GuardSettings, effectors: Mapping[str, str], sensors: Sequence[str]) -> None:
        self.settings = settings
        self._frames = dict(effectors)
        times = settings.pose_timeout_s, settings.wrench_timeout_s
        self._poses = {name: _Stream(f"the pose of {name}", times[0], settings) for name in effectors}
        self._wrenches = {name: _Stream(f"the wrench {name}", times[1], settings) for name in sensors}
        self._measured: dict[str, Placed] = {}
        self._strong: dict[str, str] = {}
        self._commanded: Mapping[str, Placed] | None = None
        self._latched = ""
        self._last: Instant | None = None
        self._offset_s = 0.0
        self.tracking_error_m = math.nan
        """Largest distance of a measured from a commanded pose, of the last readings [m]."""
        self.force_n = math.nan
        """Largest force of the last readings [N]."""

    def take_pose(self, name: str, now: Instant, stamp_s: float, frame_id: str, pose: Placed) -> None:
        """A measured pose has arrived."""
        stream = self._poses[name]
        fault = self._misfit(stream.name, self._frames[name], frame_id, pose)
        if stream.take(now, stamp_s, fault, self._commanded is not None):
            self._measured[name] = pose
            self._latch(self._outside(name, pose) or self._astray(name, pose))
        self._latch(stream.fault)

    def take_wrench(self, name: str, now: Instant, stamp_s: float, force_n: Numbers, torque_nm: Numbers) -> None:
        """A measured force [N] and torque [N m] have arrived."""
        stream = self._wrenches[name]
        finite = all(map(math.isfinite, (*force_n, *torque_nm)))
        fault = "" if finite else f"{_head(stream.name)} is not finite."
        if stream.take(now, stamp_s, fault, self._commanded is not None):
            self._strong[name] = self._too_strong(name, force_n, torque_nm)
            self._latch(self._strong[name])
        self._latch(stream.fault)

    def begin(self, now: Instant, first: Mapping[str, Placed]) -> str:
        """Begin to guard a run that commands these poses first; returns why it must not begin, '' if it may."""
        self._commanded, self._latched, self._last = None, "", now
        self._offset_s = now.ros_s - now.steady_s
        near = self.settings.start_tolerance_m, self.settings.start_tolerance_rad
        reasons = [stream.fault for stream in self._streams()] + [self._silent(now), *self._strong.values()]
        for name, pose in self._measured.items():
            reasons += [self._outside(name, pose), _apart(f"{name} is", first[name], pose, near, "first pose")]
        reason = next((reason for reason in reasons if reason), "")
        if not reason:
            self._commanded = dict(first)
        return reason

    def follow(self, commanded: Mapping[str, Placed]) -> None:
        """These poses are commanded from now on."""
        self._commanded = commanded

    def end(self) -> None:
        """The run is over."""
        self._commanded = None

    def fault(self, now: Instant) -> str:
        """What is wrong, '' if nothing is; to be asked in every control period before the next command."""
        assert self._last is not None
        last, self._last = self._last, now
        return self._latched or self._loop(last, now) or self._clock(last, now) or self._silent(now)

    def hold(self, now: Instant) -> dict[str, Placed]:
        """Where to hold: where each end effector is, so that nothing moves on, if that is known, in the workspace and
        within the tracking tolerance of its command; else where it was commanded to be."""
        assert self._commanded is not None
        found = {}
        for name, target in self._commanded.items():
            stream, pose = self._poses[name], self._measured[name]
            known = not (stream.fault or stream.silence(now) or self._outside(name, pose) or self._astray(name, pose))
            found[name] = pose if known and self.settings.moves else target
        return found

    def _streams(self) -> list[_Stream]:
        return [*self._poses.values(), *self._wrenches.values()]

    def _latch(self, fault: str) -> None:
        if self._commanded is not None and not self._latched:
            self._latched = fault

    def _silent(self, now: Instant) -> str:
        reasons = (stream.silence(now) for stream in self._streams())
        return next((reason for reason in reasons if reason), "")

    def _loop(self, last: Instant, now: Instant) -> str:
        gap = now.steady_s - last.steady_s
        if gap > max(LATE_PERIODS * self.settings.period_s, self.settings.pose_timeout_s):
            return (
                f"The control loop stood still for {gap:.3f} s, its period is {self.settings.period_s:g} s. "
                "Take load off the machine."
            )
        return ""

    def _clock(self, last: Instant, now: Instant) -> str:
        step = now.ros_s - last.ros_s
        if not self.settings.simulated_time:
            step = now.ros_s - now.steady_s - self._offset_s
            wrong = abs(step) > self.settings.clock_tolerance_s
        else:
            wrong = not 0.0 <= step <= self.settings.clock_tolerance_s
        if wrong:
            return (
                f"The ROS clock jumped by {step:.3f} s, at most {self.settings.clock_tolerance_s:g} s is allowed. "
                "Synchronise it before the replay, not while it runs."
            )
        return ""

    def _outside(self, name: str, pose: Placed) -> str:
        limits = self.settings.limits
        for corner, sign in ((limits.workspace_min_m, -1.0), (limits.workspace_max_m, 1.0)):
            for axis, bound in enumerate(corner or ()):
                value = pose.position[axis]
                if sign * (value - bound) > 0.0:
                    side = "above" if sign > 0.0 else "below"
                    return f"{name} has left the workspace: {'xyz'[axis]} is {value:.6g} m, {side} {bound:.6g} m."
        return ""

    def _astray(self, name: str, pose: Placed) -> str:
        if not self.settings.moves or self._commanded is None:
            return ""
        self.tracking_error_m = math.dist(self._commanded[name].position, pose.position)
        near = self.settings.tracking_tolerance_m, self.settings.tracking_tolerance_rad
        return _apart(f"{name} is", self._commanded[name], pose, near, "commanded pose")

    def _too_strong(self, name: str, force_n: Numbers, torque_nm: Numbers) -> str:
        force, torque = math.hypot(*force_n), math.hypot(*torque_nm)
        self.force_n = force
        limits = self.settings.limits
        if limits.max_force_n is not None and force > limits.max_force_n:
            return f"The force on {name} is {force:.4g} N, at most {limits.max_force_n:g} N is allowed."
        if limits.max_torque_nm is not None and torque > limits.max_torque_nm:
            return f"The torque on {name} is {torque:.4g} N m, at most {limits.max_torque_nm:g} N m is allowed."
        return ""

    @staticmethod
    def _misfit(what: str, frame: str, frame_id: str, pose: Placed) -> str:
        """What is wrong with a measured pose in itself."""
        if frame_id != frame:
            return f"{_head(what)} is in the frame {frame_id!r}, and the trajectory is in {frame!r}."
        if not all(map(math.isfinite, (*pose.position, *pose.quaternion))):
            return f"{_head(what)} is not finite."
        length = math.hypot(*pose.quaternion)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            return f"{_head(what)} has an orientation of length {length:.4g}, and a quaternion x y z w has length 1."
        return ""


def turn_between(first: Numbers, second: Numbers) -> float:
    """Angle [rad] between two orientations."""
    dot = abs(sum(a * b for a, b in zip(first, second, strict=True)))
    return 2.0 * math.acos(min(dot / (math.hypot(*first) * math.hypot(*second)), 1.0))


def _apart(who: str, wanted: Placed, found: Placed, most: tuple[float, float], what: str) -> str:
    """That two poses are too far from each other, '' if they are not."""
    away, turn = math.dist(wanted.position, found.position), turn_between(wanted.quaternion, found.quaternion)
    if away > most[0]:
        return f"{who} {away:.4g} m away from its {what}, at most {most[0]:g} m is allowed."
    if turn > most[1]:
        return f"{who} turned by {turn:.4g} rad against its {what}, at most {most[1]:g} rad is allowed."
    return ""


def _head(words: str) -> str:
    return words[0].upper() + words[1:]
