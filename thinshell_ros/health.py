"""What the nodes say on /diagnostics, as plain values. No ROS."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from thinshell_ros.physics import Status

Level = Literal["ok", "warn", "error"]

REAL_TIME = 0.9
"""A real-time factor below this is worth a warning."""


@dataclass(frozen=True)
class Report:
    """One status: level, a sentence, and named values."""

    name: str
    level: Level
    message: str
    values: dict[str, str] = field(default_factory=dict)


@dataclass
class CommandLog:
    """Which commands came, and what was wrong with those that were rejected."""

    accepted: int = 0
    dropped: int = 0
    last_reason: str = ""
    _news: int = 0
    _last_s: float = math.nan

    def accept(self, now_s: float) -> None:
        """A target was taken at wall time ``now_s`` [s]."""
        self.accepted += 1
        self._last_s = now_s

    def reject(self, reason: str) -> None:
        """A target was rejected."""
        self.dropped += 1
        self._news += 1
        self.last_reason = reason

    def report(self, now_s: float) -> Report:
        """State at wall time ``now_s`` [s]; rejections since the last report make it a warning."""
        news, self._news = self._news, 0
        level: Level = "warn" if news else "ok"
        message = "waiting for a target" if not self.accepted else "following targets"
        if news:
            message = f"{news} target{'s' if news > 1 else ''} rejected, the last: {self.last_reason}"
        return Report(
            "commands",
            level,
            message,
            {
                "command_age_s": _number(now_s - self._last_s),
                "accepted_commands": str(self.accepted),
                "dropped_commands": str(self.dropped),
                "last_rejection": self.last_reason,
            },
        )


def physics_report(status: Status | None, ended: str, pid: int | None) -> Report:
    """State of the simulation. ``ended``: how its process ended, '' while it runs."""
    pid_value = {"process": str(pid)}
    if ended:
        why = f"{status.trouble} " if status is not None and status.trouble else ""
        return Report("physics", "error", f"{why}{ended} Call ~/reset to start it again.", pid_value)
    if status is None:
        return Report("physics", "warn", "starting: the scene is being built", pid_value)
    values = {
        "real_time_factor": _number(status.real_time_factor),
        "simulated_time_s": _number(status.simulated_s),
        "newton_iterations": str(status.iterations),
        "residual_n": _number(status.residual_n),
        "contacts": str(status.contacts),
        "min_gap_m": _number(status.min_gap_m),
        "nan_count": str(status.not_finite),
        **pid_value,
    }
    level: Level = "ok"
    message = "running"
    if status.trouble:
        level, message = "error", f"{status.trouble} The state is held; call ~/reset."
    elif status.not_finite:
        level, message = "warn", f"{status.not_finite} values of the readings are not finite"
    elif status.paused:
        message = "paused"
    elif status.real_time_factor < REAL_TIME:
        level = "warn"
        message = f"slower than real time: factor {status.real_time_factor:.2f}, simulated time is slowed down"
    return Report("physics", level, message, values)


def recording_report(counts: dict[str, int], missing: list[str], refused: dict[str, str], where: str) -> Report:
    """State of a recorder. ``missing``: expected but never published; ``refused``: reasons by topic."""
    message = f"{sum(counts.values())} messages in {where}"
    faults = [f"{topic}: {reason}" for topic, reason in refused.items()]
    if missing:
        faults.append(f"nobody publishes {', '.join(missing)}")
    silent = [topic for topic, count in counts.items() if not count]
    if silent:
        faults.append(f"no message yet on {', '.join(silent)}")
    values = {topic: str(count) for topic, count in counts.items()}
    return Report("recording", "warn" if faults else "ok", "; ".join([message, *faults]), values)


def _number(value: float) -> str:
    return f"{value:.6g}"
