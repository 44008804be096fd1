"""One trajectory being replayed: when it may begin, what is commanded in each control period, how it ends. No ROS."""

from __future__ import annotations

from typing import Literal

import numpy as np

from sim_core.errors import ConfigError
from sim_core.rigs import HandLimits, Rig
from sim_core.trajectories import Limits, Review, Trajectory, check_trajectory
from sim_core.trajectories.expected import (
    noise_factor,
    path_tolerances,
    spread_factor,
    values_in_a_replay,
    wrench_band,
)
from thinshell_ros.health import Level, Report
from thinshell_ros.replay.expectation import Expectation
from thinshell_ros.replay.guard import Guard, GuardSettings
from thinshell_ros.replay.sensors import MarkerGuard, WrenchGuard
from thinshell_ros.replay.setpoints import Setpoints, WayBack
from thinshell_ros.replay.streams import Instant
from thinshell_ros.replay.tracking import Numbers, Placed, TrackingLimits
from thinshell_ros.replay.watch import PredictionWatch

State = Literal["idle", "running", "succeeded", "aborted", "retracting", "retracted"]

SETTLE_S = 0.5
"""Time [s] for which the last pose is guarded before the replay has succeeded."""

HOLD_S = 1.0
"""Time [s] for which the pose that is held is repeated after the end; a controller then keeps it."""

CATCH_UP = 1.5
"""A control period that is late moves on by at most so many periods, so that no command leaps."""

_LEVELS: dict[State, Level] = {
    "idle": "ok", "running": "ok", "succeeded": "ok", "aborted": "error", "retracting": "ok", "retracted": "ok",
}  # fmt: skip


def checked(trajectory: Trajectory, settings: GuardSettings, speed_scale: float, rig: Rig | None = None) -> Review:
    """The check of the whole trajectory against the limits of the file and of the settings.

    Raises:
        ConfigError: it must not be replayed; all reasons are in the message.
    """
    review = check_trajectory(trajectory, settings.limits, rig, speed_scale)
    errors = list(review.errors)
    for name in trajectory.end_effectors if settings.moves else ():
        limits = trajectory.limits_of(name).stricter(settings.limits)
        if limits.workspace_min_m is None or limits.workspace_max_m is None:
            errors.append(
                f"There is no workspace box for {name}. Set workspace_min_m and workspace_max_m, here or in the file."
            )
    if errors:
        raise ConfigError(f"The trajectory must not be replayed: {' '.join(errors)}")
    return review


def tracking_limits(
    trajectory: Trajectory, settings: GuardSettings, setpoints: Setpoints, scale: float
) -> dict[str, TrackingLimits]:
    """How each end effector has to follow: as the settings say, else the trajectory, else what its motion asks for."""
    usual, found = HandLimits(), {}
    fastest, poses = setpoints.fastest(), trajectory.poses()
    for name, path in trajectory.end_effectors.items():
        wrenches = list(trajectory.predicted.wrenches.values())
        near, turn = path_tolerances(poses[name], wrenches, (usual.accuracy_m, usual.accuracy_rad))
        found[name] = TrackingLimits(
            settings.tracking_tolerance_m or path.tolerance_m or near,
            settings.tracking_tolerance_rad or path.tolerance_rad or turn,
            settings.max_lag_s or path.max_lag_s or usual.max_lag_s,
            scale * fastest[name][0],
            scale * fastest[name][1],
        )
    return found


class Session:
    """Replays one trajectory, as often as it is executed."""

    def __init__(
        self,
        trajectory: Trajectory,
        settings: GuardSettings,
        wrenches: list[str],
        speed_scale: float = 1.0,
        markers: list[str] | None = None,
        watch_aborts: bool = False,
        step_s: float | None = None,
    ) -> None:
        """``wrenches``, ``markers``: names of the sensors that are guarded; ``speed_scale``: share of the planned
        speed; ``watch_aborts``: an alarm of the watch ends the replay; ``step_s``: of the simulation that predicted,
        None where that is not known."""
        predicted = trajectory.predicted
        self.setpoints = Setpoints(trajectory)
        follow = tracking_limits(trajectory, settings, self.setpoints, speed_scale)
        lag = speed_scale * (max(f.lag_s for f in follow.values()) + settings.period_s)
        count = values_in_a_replay(predicted, trajectory.duration_s / speed_scale)
        factors = spread_factor(predicted), noise_factor(count)
        limits = trajectory.limits.stricter(settings.limits)
        guards = {}
        for name in wrenches:
            wrench = predicted.wrenches.get(name)
            if wrench is None:
                guards[name] = WrenchGuard(name, limits)
                continue
            band = wrench_band(wrench, trajectory.times_s, factors, trajectory.limits)
            expected = Expectation(band, lag + speed_scale * wrench.delay_s)
            own = limits.stricter(Limits(max_force_n=wrench.max_force_n, max_torque_nm=wrench.max_torque_nm))
            guards[name] = WrenchGuard(name, own, wrench.frame_id, expected, wrench.rate_hz)
        seen = {n: predicted.markers[n] for n in markers or []}
        marked = {n: MarkerGuard(n, m.ids, m.frame_id, m.rate_hz) for n, m in seen.items()}
        self.guard = Guard(settings, trajectory, follow, guards, marked)
        self.watch = PredictionWatch(trajectory, lag, speed_scale, step_s=step_s, held_s=settings.period_s)
        self._watch_aborts = watch_aborts
        self._scale = speed_scale
        self.state: State = "idle"
        self.reason = ""
        """Why the last replay was aborted, or could not begin."""
        self.time_s = self.setpoints.begin_s
        """How far into the trajectory it is [s]."""
        self.waiting_s = 0.0
        """For how long simulated time has stood still, and all with it [s]."""
        self.commanded: dict[str, Placed] = {}
        self._ended_s = 0.0
        self._last: Instant | None = None
        self._way: WayBack | None = None
        self._gone_s = 0.0

    def take_pose(self, name: str, now: Instant, stamp_s: float, frame_id: str, pose: Placed) -> None:
        """A measured pose has arrived."""
        self.guard.take_pose(name, now, stamp_s, frame_id, pose)

    def take_wrench(
        self, name: str, now: Instant, stamp_s: float, frame_id: str, force_n: Numbers, torque_nm: Numbers
    ) -> None:
        """A measured force [N] and torque [N m] have arrived."""
        self.guard.take_wrench(name, now, stamp_s, frame_id, force_n, torque_nm)
        if self.state not in ("retracting", "retracted"):
            self.watch.take_wrench(name, stamp_s, np.array([*force_n, *torque_nm]), self.guard.time_of(stamp_s, now))

    def take_markers(
        self, name: str, now: Instant, stamp_s: float, frame_id: str, ids: np.ndarray, positions_m: np.ndarray
    ) -> None:
        """Markers have arrived: ``ids`` ``(m,)``, positions ``(m, 3)``, NaN where one is lost."""
        self.guard.take_markers(name, now, stamp_s, frame_id, ids, positions_m)
        if self.state not in ("retracting", "retracted"):
            self.watch.take_markers(name, stamp_s, ids, positions_m, self.guard.time_of(stamp_s, now))

    def execute(self, now: Instant) -> str:
        """Begin; returns why it cannot, '' if it has."""
        if self.moving:
            return "A replay is running. Wait for its end, or abort it first."
        first = self.setpoints.poses(self.setpoints.begin_s)
        self.reason = self.guard.begin(now, first, self.setpoints.begin_s)
        if not self.reason:
            self.watch.begin()
            self.state, self.time_s, self.commanded = "running", self.setpoints.begin_s, first
            self._last, self._ended_s, self.waiting_s, self._way = now, 0.0, 0.0, None
        return self.reason

    def retract(self, now: Instant) -> str:
        """Go back to where the end effectors wait, after a replay has ended; returns why it cannot, '' if it does."""
        if self.moving:
            return "A replay is running. Abort it first."
        if self.state not in ("succeeded", "aborted"):
            return "There is nothing to come back from: no replay has ended since the last way back."
        reason = self.guard.begin(now, self.commanded, self.time_s, back=True)
        if not reason:
            if self._way is None:
                self._way = self.setpoints.way_back(self.time_s, self.commanded, self.state == "succeeded")
            self.state, self._gone_s, self._last, self.waiting_s = "retracting", 0.0, now, 0.0
        return reason

    @property
    def moving(self) -> bool:
        """Whether something is being commanded that moves."""
        return self.state in ("running", "retracting")

    def abort(self, now: Instant, reason: str) -> bool:
        """Hold at once; returns whether a replay was running. The pose to hold is in ``commanded``."""
        if not self.moving:
            return False
        self.commanded = self.guard.hold(now)
        self.guard.end()
        if self.state == "retracting" and self._way is not None:
            self._way = self.setpoints.rest_of(self._way, self._gone_s, self.commanded)
        self.state, self.reason, self._ended_s = "aborted", reason, now.steady_s
        return True

    def tick(self, now: Instant) -> dict[str, Placed] | None:
        """What to command in this control period; None for nothing."""
        if not self.moving:
            holds = self.state != "idle" and now.steady_s - self._ended_s <= HOLD_S
            return self.commanded if holds else None
        fault = self.guard.fault(now)
        if not fault and self._watch_aborts and self.state == "running" and self.watch.alarm is not None:
            fault = self.watch.alarm.text
        if fault:
            self.abort(now, fault)
            return self.commanded
        # While simulated time stands still, a command would only repeat the one before, under the same stamp.
        return self.commanded if self._advance(now) else None

    def _advance(self, now: Instant) -> bool:
        """Move on by the time that has passed; returns whether any has."""
        assert self._last is not None
        simulated, most = self.guard.settings.simulated_time, CATCH_UP * self.guard.settings.period_s
        passed = now.ros_s - self._last.ros_s if simulated else now.steady_s - self._last.steady_s
        self.waiting_s = self.waiting_s + now.steady_s - self._last.steady_s if passed == 0.0 else 0.0
        self._last = now
        step = self._scale * min(passed, most)
        if self.state == "retracting":
            assert self._way is not None
            self._gone_s += step
            self.commanded = self._way.poses(self._gone_s)
            over = self._gone_s >= self._way.duration_s + SETTLE_S * self._scale
        else:
            self.time_s += step
            self.commanded = self.setpoints.poses(self.time_s)
            over = self.time_s >= self.setpoints.duration_s + SETTLE_S * self._scale
        self.guard.follow(now, self.commanded, self.time_s)
        if over:
            self.guard.end()
            self._ended_s = now.steady_s
            self.state = "retracted" if self.state == "retracting" else "succeeded"
        return passed > 0.0

    @property
    def progress(self) -> float:
        """Share of the trajectory, with the way to its start, that was commanded."""
        begin, end = self.setpoints.begin_s, self.setpoints.duration_s
        return min(max((self.time_s - begin) / (end - begin), 0.0), 1.0)

    def report(self) -> Report:
        """The state, why it ended so, and figures."""
        dry = not self.guard.settings.moves
        alarm = self.watch.alarm
        values = {
            "dry_run": str(dry).lower(),
            "progress": f"{self.progress:.4f}",
            "time_s": f"{self.time_s:.3f}",
            "duration_s": f"{self.setpoints.duration_s:.3f}",
            "tracking_error_m": f"{self.guard.tracking_error_m:.6g}",
            "force_n": f"{self.guard.force_n:.6g}",
            "waiting_s": f"{self.waiting_s:.1f}",
            "watch": "as predicted" if alarm is None else alarm.text,
            "watch_time_s": "" if alarm is None else f"{alarm.time_s:.3f}",
            "detail": self.reason,
        }
        level = "warn" if (self.reason and self.state == "idle") or alarm is not None else _LEVELS[self.state]
        return Report("replay", "error" if self.state == "aborted" else level, self.state, values)
