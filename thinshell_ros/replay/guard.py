"""What must hold while a trajectory is replayed, and where to hold when it does not. No ROS and no clock of its own.

Two clocks are passed in: a steady one, by which arrivals and the control loop are timed, and that of ROS, which stamps
follow and which may jump. Every reading is judged when it arrives, so that none is missed between two control periods;
silence, the clocks and the loop itself are judged in each period. With simulated time, readings and commands are
timed by the ROS clock alone: where the simulation is slow, all wait.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.trajectories import Limits, Trajectory
from thinshell_ros.poses import UNIT_TOLERANCE
from thinshell_ros.replay.sensors import MarkerGuard, WrenchGuard
from thinshell_ros.replay.streams import Instant, Stream, head
from thinshell_ros.replay.tracking import Numbers, Placed, Track, TrackingLimits, nearest

LATE_PERIODS = 3.0
"""A control loop that is late by more than so many periods, and by more than the time-out of poses, has stood still."""

MEMORY_S = 10.0
"""How long it is known which time of the trajectory belongs to a stamp [s]."""


@dataclass(frozen=True)
class GuardSettings:
    """What is guarded. Lengths [m], angles [rad], times [s].

    ``limits``: besides those of the trajectory. ``tracking_*``: largest distance of a measured pose from where the
    commands were within the last ``max_lag_s``; None: as the trajectory says. ``start_*``: between the first pose and
    the measured one. ``pose_timeout_s``, ``wrench_timeout_s``, ``marker_timeout_s``: largest age of a reading, by its
    arrival, and with
    ``check_stamps`` also by its stamp; at least three readings of the sensor. ``clock_tolerance_s``: largest step of
    the ROS clock against the steady one, or with ``simulated_time`` ahead of it within a period. ``moves``: commands
    are carried out; without it, as in a dry run, nothing tracks them.
    """

    limits: Limits
    period_s: float = 0.01
    tracking_tolerance_m: float | None = None
    tracking_tolerance_rad: float | None = None
    max_lag_s: float | None = None
    start_tolerance_m: float = 0.002
    start_tolerance_rad: float = 0.02
    pose_timeout_s: float = 0.1
    wrench_timeout_s: float = 0.1
    marker_timeout_s: float = 0.1
    clock_tolerance_s: float = 0.1
    check_stamps: bool = True
    simulated_time: bool = False
    moves: bool = True


class Guard:
    """Watches the measured poses of the end effectors of a trajectory, and the named wrenches and markers."""

    def __init__(
        self,
        settings: GuardSettings,
        trajectory: Trajectory,
        tracking: Mapping[str, TrackingLimits],
        wrenches: Mapping[str, WrenchGuard],
        markers: Mapping[str, MarkerGuard],
    ) -> None:
        self.settings = settings
        self._frames = {name: path.frame_id for name, path in trajectory.end_effectors.items()}
        self._limits = {name: trajectory.limits_of(name).stricter(settings.limits) for name in self._frames}
        self._tracks = {name: Track(name, tracking[name]) for name in self._frames}
        self._wrenches, self._markers = dict(wrenches), dict(markers)
        self._poses = {name: self._stream(f"the pose of {name}", settings.pose_timeout_s) for name in self._frames}
        self._others = {
            **{n: self._stream(f"the wrench {n}", g.timeout_s(settings.wrench_timeout_s)) for n, g in wrenches.items()},
            **{n: self._stream(f"the markers {n}", g.timeout_s(settings.marker_timeout_s)) for n, g in markers.items()},
        }
        self._measured: dict[str, Placed] = {}
        self._commanded: Mapping[str, Placed] | None = None
        self._latched = ""
        self._back = False
        self._last: Instant | None = None
        self._ahead_s = 0.0
        self._offset_s = 0.0
        self._times: deque[tuple[float, float]] = deque()

    def _stream(self, name: str, timeout_s: float) -> Stream:
        return Stream(name, timeout_s, self.settings.check_stamps)

    @property
    def tracking_error_m(self) -> float:
        """Largest distance of a measured position from where the commands were lately, of the last readings [m]."""
        return max((track.error_m for track in self._tracks.values()), default=math.nan)

    @property
    def force_n(self) -> float:
        """Largest force of the last readings [N]."""
        return max((wrench.force_n for wrench in self._wrenches.values()), default=math.nan)

    def take_pose(self, name: str, now: Instant, stamp_s: float, frame_id: str, pose: Placed) -> None:
        """A measured pose has arrived."""
        stream = self._poses[name]
        fault = self._misfit(stream.name, self._frames[name], frame_id, pose)
        if stream.take(now, stamp_s, fault, self._commanded is not None):
            self._measured[name] = pose
            if self._commanded is not None:
                astray = ""
                if self.settings.moves:
                    at = stamp_s if self.settings.check_stamps else now.ros_s
                    astray = self._tracks[name].judge(at, now.ros_s, pose)
                outside = self._outside(name, pose)
                self._latch((self._tracks[name].jumped and astray) or outside or astray)
        self._latch(stream.fault)

    def take_wrench(
        self, name: str, now: Instant, stamp_s: float, frame_id: str, force_n: Numbers, torque_nm: Numbers
    ) -> None:
        """A measured force [N] and torque [N m] have arrived."""
        stream, wrench = self._others[name], self._wrenches[name]
        fault = wrench.misfit(frame_id, (*force_n, *torque_nm))
        if stream.take(now, stamp_s, fault, self._commanded is not None):
            values = np.array([*force_n, *torque_nm])
            self._latch(wrench.judge(values, self._time_of(stamp_s, now)))
        self._latch("" if self._back else stream.fault)

    def take_markers(
        self, name: str, now: Instant, stamp_s: float, frame_id: str, ids: np.ndarray, positions_m: np.ndarray
    ) -> None:
        """Markers have arrived: ``ids`` ``(m,)``, positions ``(m, 3)``, NaN where one is lost."""
        stream, markers = self._others[name], self._markers[name]
        fault = markers.misfit(frame_id)
        if stream.take(now, stamp_s, fault, self._commanded is not None):
            found = markers.judge(ids[np.isfinite(positions_m).all(axis=1)])
            self._latch("" if self._back else found)
        self._latch("" if self._back else stream.fault)

    def time_of(self, stamp_s: float, now: Instant) -> float | None:
        """Time of the trajectory [s] at which a reading was stamped; None outside of a replay."""
        return None if self._commanded is None else self._time_of(stamp_s, now)

    def _time_of(self, stamp_s: float, now: Instant) -> float | None:
        """... None while nothing is predicted."""
        if self._commanded is None or self._back or not self._times:
            return None
        at = stamp_s if self.settings.check_stamps else now.ros_s
        later = self._times[-1]
        if at >= later[0]:
            return later[1]
        for earlier in reversed(self._times):
            if earlier[0] <= at:
                share = (at - earlier[0]) / (later[0] - earlier[0]) if later[0] > earlier[0] else 0.0
                return earlier[1] + share * (later[1] - earlier[1])
            later = earlier
        return later[1]

    def begin(self, now: Instant, first: Mapping[str, Placed], time_s: float, back: bool = False) -> str:
        """Begin to guard a run that commands these poses first; returns why it must not begin, '' if it may.

        ``back``: a way back after a replay, on which force may not grow, and nothing else is asked of sensors.
        """
        self._commanded, self._latched, self._last, self._back = None, "", now, back
        self._offset_s = self._ahead_s = now.ros_s - now.steady_s
        near = self.settings.start_tolerance_m, self.settings.start_tolerance_rad
        asked = [*self._poses.values(), *(() if back else self._others.values())]
        reasons = [stream.fault for stream in asked] + [self._silent(now, asked)]
        for name, pose in self._measured.items():
            if not back:
                reasons += [_apart(name, first[name], pose, near), self._outside(name, pose)]
        for wrench in self._wrenches.values():
            reasons.append(wrench.begin(back))
        for markers in self._markers.values():
            reasons.append("" if back else markers.begin())
        reason = next((reason for reason in reasons if reason), "")
        if reason:
            self.end()
        else:
            self._commanded = dict(first)
            self._times.clear()
            self._times.append((now.ros_s, time_s))
            for name, track in self._tracks.items():
                track.begin(now.ros_s, first[name])
        return reason

    def follow(self, now: Instant, commanded: Mapping[str, Placed], time_s: float) -> None:
        """These poses, of a time of the trajectory [s], are commanded from now on."""
        self._commanded = commanded
        self._times.append((now.ros_s, time_s))
        while len(self._times) > 2 and self._times[1][0] < now.ros_s - MEMORY_S:
            self._times.popleft()
        for name, track in self._tracks.items():
            track.command(now.ros_s, commanded[name])

    def end(self) -> None:
        """The run is over."""
        self._commanded = None
        for wrench in self._wrenches.values():
            wrench.end()

    def fault(self, now: Instant) -> str:
        """What is wrong, '' if nothing is; to be asked in every control period before the next command."""
        assert self._last is not None
        last, self._last = self._last, now
        asked = [*self._poses.values(), *(() if self._back else self._others.values())]
        longest = max(now.steady_s - last.steady_s, now.ros_s - last.ros_s)
        if longest > LATE_PERIODS * self.settings.period_s and self.settings.simulated_time:
            # All wait. What has come in the meantime may be taken only after this period.
            return self._clock(last, now) or self._latched
        # A clock that jumps makes readings look late: it is named first.
        return self._clock(last, now) or self._latched or self._loop(last, now) or self._silent(now, asked)

    def hold(self, now: Instant) -> dict[str, Placed]:
        """Where to hold: where each end effector is, so that nothing moves on, if that is known, in the workspace and
        near its commands of late; else where it was commanded to be."""
        assert self._commanded is not None
        found = {}
        for name, target in self._commanded.items():
            stream, pose = self._poses[name], self._measured[name]
            known = not (stream.fault or self._silent(now, [stream]) or self._outside(name, pose))
            near = self._tracks[name].limits
            if known and self.settings.moves:
                away, turn = nearest(self._tracks[name].lately(now.ros_s), pose, near.near_m, near.near_rad)
                known = away <= near.near_m and turn <= near.near_rad
            found[name] = pose if known and self.settings.moves else target
        return found

    def _latch(self, fault: str) -> None:
        if self._commanded is not None and not self._latched:
            self._latched = fault

    def _silent(self, now: Instant, streams: list[Stream]) -> str:
        reasons = (stream.silence(now, self.settings.simulated_time) for stream in streams)
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
        """Simulated time may catch up with the wall clock what it has fallen behind since the run began: who publishes
        it, or this node, was held up."""
        step = now.ros_s - last.ros_s
        if not self.settings.simulated_time:
            step = now.ros_s - now.steady_s - self._offset_s
            wrong = abs(step) > self.settings.clock_tolerance_s
        else:
            behind = self._ahead_s - (last.ros_s - last.steady_s)
            wrong = not 0.0 <= step <= self.settings.clock_tolerance_s + behind + now.steady_s - last.steady_s
            self._ahead_s = max(self._ahead_s, now.ros_s - now.steady_s)
        if wrong:
            return (
                f"The ROS clock jumped by {step:.3f} s, at most {self.settings.clock_tolerance_s:g} s is allowed. "
                "Synchronise it before the replay, not while it runs."
            )
        return ""

    def _outside(self, name: str, pose: Placed) -> str:
        limits = self._limits[name]
        for corner, sign in ((limits.workspace_min_m, -1.0), (limits.workspace_max_m, 1.0)):
            for axis, bound in enumerate(corner or ()):
                value = pose.position[axis]
                if sign * (value - bound) > 0.0:
                    side = "above" if sign > 0.0 else "below"
                    return f"{name} has left the workspace: {'xyz'[axis]} is {value:.6g} m, {side} {bound:.6g} m."
        return ""

    @staticmethod
    def _misfit(what: str, frame: str, frame_id: str, pose: Placed) -> str:
        """What is wrong with a measured pose in itself."""
        if frame_id != frame:
            return f"{head(what)} is in the frame {frame_id!r}, and the trajectory is in {frame!r}."
        if not all(map(math.isfinite, (*pose.position, *pose.quaternion))):
            return f"{head(what)} is not finite."
        length = math.hypot(*pose.quaternion)
        if abs(length - 1.0) > UNIT_TOLERANCE:
            return f"{head(what)} has an orientation of length {length:.4g}, and a quaternion x y z w has length 1."
        return ""


def _apart(name: str, wanted: Placed, found: Placed, most: tuple[float, float]) -> str:
    """That an end effector is too far from where it has to begin, '' if it is not."""
    away, turn = nearest([wanted], found)
    if away > most[0]:
        return f"{name} is {away:.4g} m away from its first pose, at most {most[0]:g} m is allowed."
    if turn > most[1]:
        return f"{name} is turned by {turn:.4g} rad against its first pose, at most {most[1]:g} rad is allowed."
    return ""
