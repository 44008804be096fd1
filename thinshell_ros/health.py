"""What the nodes say on /diagnostics, as plain values. No ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from thinshell_ros.protocol import Status
from thinshell_ros.streams import EVENT_TOPIC

Level = Literal["ok", "warn", "error"]

REAL_TIME = 0.9
"""A real-time factor below this times the wanted one is worth a warning."""

LAG_S = 0.15
"""Stamps behind the wall clock by more than this [s] are worth a warning; less is caught up."""

SILENT_S = 1.0
"""A step that takes longer than this [s] is worth a warning."""

REPEAT_S = 30.0
"""Time [s] after which a fault that stays is logged again."""

BEHIND_M = 1e-3
BEHIND_RAD = 0.01
"""Distance [m] and angle [rad] behind a target that are worth a warning while a speed limit holds an end effector."""


@dataclass(frozen=True)
class Report:
    """One status: level, a sentence, and named values."""

    name: str
    level: Level
    message: str
    values: dict[str, str] = field(default_factory=dict)


class Announcer:
    """Which reports are worth a line of the log: a level that changes at once, one that stays from time to time."""

    def __init__(self) -> None:
        self._reported: dict[str, tuple[Level, float]] = {}

    def is_news(self, report: Report, now_s: float) -> bool:
        """Whether to tell a report at wall time ``now_s`` [s]."""
        level, at = self._reported.get(report.name, ("ok", -math.inf))
        news = report.level != level or (report.level != "ok" and now_s - at > REPEAT_S)
        if news:
            self._reported[report.name] = report.level, now_s
        return news


@dataclass
class CommandLog:
    """Which commands came, and what was wrong with those that were rejected. ``timeout_s``: age [s] from which a
    command is stale."""

    timeout_s: float = math.inf
    accepted: int = 0
    dropped: int = 0
    last_reason: str = ""
    _news: int = 0
    _in_a_row: int = 0
    _last_s: dict[str, float] = field(default_factory=dict)

    def accept(self, end_effector: str, now_s: float) -> None:
        """A target was taken at wall time ``now_s`` [s]."""
        self.accepted += 1
        self._in_a_row = 0
        self._last_s[end_effector] = now_s

    def reject(self, reason: str) -> None:
        """A target was rejected."""
        self.dropped += 1
        self._news += 1
        self._in_a_row += 1
        self.last_reason = reason

    def report(self, now_s: float, status: Status | None = None, commanders: int = 1) -> Report:
        """State at wall time ``now_s`` [s]. ``status``: of the simulation; ``commanders``: publishers of one topic of
        targets, the most there are."""
        faults = []
        news, self._news = self._news, 0
        if news or self._in_a_row:
            count = max(news, self._in_a_row)
            faults.append(f"{count} target{'s' if count > 1 else ''} rejected, the last: {self.last_reason}")
        stale = [f"{n} for {now_s - at:.3g} s" for n, at in self._last_s.items() if now_s - at > self.timeout_s]
        if stale:
            faults.append(f"no target of {', '.join(stale)} (command_timeout_s): the last one is kept")
        if status is not None and status.trouble:
            faults.append("targets are not carried out, see the status of the physics")
        if status is not None and (status.behind_m > BEHIND_M or status.behind_rad > BEHIND_RAD):
            faults.append(
                f"{status.behind_m:.3g} m and {status.behind_rad:.3g} rad behind the target, "
                "limited to max_speed_m_s and max_turn_rate_rad_s"
            )
        if commanders > 1:
            faults.append(f"{commanders} publishers on one topic of targets: they take turns")
        message = "; ".join(faults) or ("following targets" if self.accepted else "waiting for a target")
        values = {
            "command_age_s": _number(max((now_s - at for at in self._last_s.values()), default=math.nan)),
            "accepted_commands": str(self.accepted),
            "dropped_commands": str(self.dropped),
            "last_rejection": self.last_reason,
            "behind_target_m": _number(status.behind_m if status is not None else math.nan),
        }
        return Report("commands", "warn" if faults else "ok", message, values)


def physics_report(
    status: Status | None, fault: str, pid: int | None, wanted: float = 1.0, silent_s: float = 0.0
) -> Report:
    """State of the simulation. ``fault``: what is wrong with its process, '' if nothing is; ``wanted``: simulated time
    per wall time, 0 for as fast as it can; ``silent_s``: time since the last sign of life [s]."""
    pid_value = {"process": str(pid), "silent_s": _number(silent_s)}
    if fault:
        why = f"{status.trouble} " if status is not None and status.trouble else ""
        return Report("physics", "error", f"{why}{fault} Call ~/reset to start it again.", pid_value)
    if status is None:
        return Report("physics", "warn", f"starting: the scene is being built, for {silent_s:.0f} s now", pid_value)
    values = {
        "real_time_factor": _number(status.real_time_factor),
        "wanted_real_time_factor": _number(wanted),
        "lag_s": _number(status.lag_s),
        "simulated_time_s": _number(status.simulated_s),
        "newton_iterations": str(status.iterations),
        "residual_n": _number(status.residual_n),
        "contacts": str(status.contacts),
        "min_gap_m": _number(status.min_gap_m),
        "nan_count": str(status.not_finite),
        **pid_value,
    }
    if status.trouble:
        remedy = "Call ~/reset to start it again." if status.ended else "Command another pose, or call ~/reset."
        return Report("physics", "error", f"{status.trouble} {remedy}", values)
    faults = []
    if status.not_finite:
        faults.append(f"{status.not_finite} values of the readings are not finite")
    if silent_s > SILENT_S:
        faults.append(f"the present step has taken {silent_s:.1f} s so far")
    if not status.paused and status.lag_s > LAG_S:
        faults.append(f"stamps are {status.lag_s:.2f} s behind the wall clock")
    if not status.paused and status.real_time_factor < REAL_TIME * wanted:
        faults.append(f"slower than wanted: real-time factor {status.real_time_factor:.2f} instead of {wanted:g}")
    message = "; ".join(faults) or ("paused" if status.paused else "running")
    return Report("physics", "warn" if faults else "ok", message, values)


def topics_report(others: Mapping[str, Sequence[str]]) -> Report:
    """Who else publishes on the topics of a simulated rig. ``others``: names of nodes by topic."""
    if not others:
        return Report("topics", "ok", "nobody else publishes on the topics of this rig")
    nodes = sorted({name for names in others.values() for name in names})
    words = f"{', '.join(nodes)} also publish{'es' if len(nodes) == 1 else ''} on {', '.join(sorted(others))}"
    remedy = "Whoever listens gets a mixture: stop one of the two, or start one in another namespace."
    values = {topic: " ".join(names) for topic, names in others.items()}
    return Report("topics", "error", f"{words}. {remedy}", values)


def recording_report(
    counts: dict[str, int],
    missing: list[str],
    refused: dict[str, str],
    where: str,
    lost: Mapping[str, int] | None = None,
) -> Report:
    """State of a recorder. ``missing``: expected but never published; ``refused``: reasons by topic; ``lost``: messages
    published and not received, by topic, of those where that is known."""
    message = f"{sum(counts.values())} messages in {where}"
    faults = [f"{topic}: {reason}" for topic, reason in refused.items()]
    if missing:
        faults.append(f"nobody publishes {', '.join(missing)}")
    # Nothing need ever happen on the topic of events.
    silent = [topic for topic, count in counts.items() if not count and topic.rsplit("/", 1)[-1] != EVENT_TOPIC]
    if silent:
        faults.append(f"no message yet on {', '.join(silent)}")
    losses = {topic: count for topic, count in (lost or {}).items() if count}
    if losses:
        faults.append(f"lost: {', '.join(f'{count} of {topic}' for topic, count in losses.items())}")
    values = {topic: str(count) for topic, count in counts.items()}
    values |= {f"lost {topic}": str(count) for topic, count in (lost or {}).items()}
    return Report("recording", "warn" if faults else "ok", "; ".join([message, *faults]), values)


def _number(value: float) -> str:
    return f"{value:.6g}"
