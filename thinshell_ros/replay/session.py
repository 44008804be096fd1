"""One trajectory being replayed: when it may begin, what is commanded in each control period, how it ends. No ROS."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from sim_core.errors import ConfigError
from sim_core.rigs import Rig
from sim_core.trajectories import Review, Trajectory, check_trajectory
from thinshell_ros.health import Level, Report
from thinshell_ros.replay.guard import Guard, GuardSettings, Instant, Placed
from thinshell_ros.replay.setpoints import Setpoints

State = Literal["idle", "running", "succeeded", "aborted"]

SETTLE_S = 0.5
"""Time [s] for which the last pose is guarded before the replay has succeeded."""

HOLD_S = 1.0
"""Time [s] for which the pose that is held is repeated after the end; a controller then keeps it."""

CATCH_UP = 1.5
"""A control period that is late moves on by at most so many periods, so that no command leaps."""

_LEVELS: dict[State, Level] = {"idle": "ok", "running": "ok", "succeeded": "ok", "aborted": "error"}


def checked(trajectory: Trajectory, settings: GuardSettings, speed_scale: float, rig: Rig | None = None) -> Review:
    """The check of the whole trajectory against the limits of the file and of the settings.

    Raises:
        ConfigError: it must not be replayed; all reasons are in the message.
    """
    review = check_trajectory(trajectory, settings.limits, rig, speed_scale)
    limits = trajectory.limits.stricter(settings.limits)
    errors = list(review.errors)
    if settings.moves and (limits.workspace_min_m is None or limits.workspace_max_m is None):
        errors.append("There is no workspace box. Set workspace_min_m and workspace_max_m, here or in the file.")
    if errors:
        raise ConfigError(f"The trajectory must not be replayed: {' '.join(errors)}")
    return review


class Session:
    """Replays one trajectory, as often as it is executed."""

    def __init__(
        self, trajectory: Trajectory, settings: GuardSettings, sensors: list[str], speed_scale: float = 1.0
    ) -> None:
        """``sensors``: names of the wrenches that are guarded; ``speed_scale``: share of the planned speed."""
        settings = replace(settings, limits=trajectory.limits.stricter(settings.limits))
        frames = {name: path.frame_id for name, path in trajectory.end_effectors.items()}
        self.guard = Guard(settings, frames, sensors)
        self.setpoints = Setpoints(trajectory)
        self._scale = speed_scale
        self.state: State = "idle"
        self.reason = ""
        """Why the last replay was aborted, or could not begin."""
        self.time_s = 0.0
        """How far into the trajectory it is [s]."""
        self.commanded: dict[str, Placed] = {}
        self._ended_s = 0.0
        self._last: Instant | None = None

    def execute(self, now: Instant) -> str:
        """Begin; returns why it cannot, '' if it has."""
        if self.state == "running":
            return "A replay is running. Wait for its end, or abort it first."
        first = self.setpoints.poses(0.0)
        self.reason = self.guard.begin(now, first)
        if not self.reason:
            self.state, self.time_s, self.commanded, self._last, self._ended_s = "running", 0.0, first, now, 0.0
        return self.reason

    def abort(self, now: Instant, reason: str) -> bool:
        """Hold at once; returns whether a replay was running. The pose to hold is in ``commanded``."""
        if self.state != "running":
            return False
        self.commanded = self.guard.hold(now)
        self.guard.end()
        self.state, self.reason, self._ended_s = "aborted", reason, now.steady_s
        return True

    def tick(self, now: Instant) -> dict[str, Placed] | None:
        """What to command in this control period; None for nothing."""
        if self.state != "running":
            holds = self.state != "idle" and now.steady_s - self._ended_s <= HOLD_S
            return self.commanded if holds else None
        if fault := self.guard.fault(now):
            self.abort(now, fault)
            return self.commanded
        self._advance(now)
        return self.commanded

    def _advance(self, now: Instant) -> None:
        assert self._last is not None
        simulated, most = self.guard.settings.simulated_time, CATCH_UP * self.guard.settings.period_s
        passed = now.ros_s - self._last.ros_s if simulated else now.steady_s - self._last.steady_s
        self._last = now
        self.time_s += self._scale * min(passed, most)
        self.commanded = self.setpoints.poses(self.time_s)
        self.guard.follow(self.commanded)
        if self.time_s >= self.setpoints.duration_s + SETTLE_S * self._scale:
            self.guard.end()
            self.state, self._ended_s = "succeeded", now.steady_s

    @property
    def progress(self) -> float:
        """Share of the trajectory that was commanded."""
        return min(self.time_s / self.setpoints.duration_s, 1.0)

    def report(self) -> Report:
        """The state, why it ended so, and figures."""
        dry = not self.guard.settings.moves
        values = {
            "dry_run": str(dry).lower(),
            "progress": f"{self.progress:.4f}",
            "time_s": f"{self.time_s:.3f}",
            "duration_s": f"{self.setpoints.duration_s:.3f}",
            "tracking_error_m": f"{self.guard.tracking_error_m:.6g}",
            "force_n": f"{self.guard.force_n:.6g}",
            "detail": self.reason,
        }
        return Report(
            "replay", "warn" if self.reason and self.state == "idle" else _LEVELS[self.state], self.state, values
        )
