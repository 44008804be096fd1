"""A plant for the replay's guards: an end effector that follows its target with a lag and presses on a wall, sensors
with latency, a control loop with jitter, and one fault. No ROS.

Everything that the guards could know, and when, is in the log; :func:`first_violation` says from the log alone, by the
words of docs/replay.md, in which control period a replay had to end.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sim_core.rigs.trajectory import minimum_jerk
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories import Limits, Trajectory
from thinshell_ros.replay.guard import GuardSettings, Instant, Placed
from thinshell_ros.replay.session import Session

STEP_S = 0.001
PERIOD_S = 0.01
JITTER_S = 0.002
SENSOR_PERIOD_S = 0.005
DEPTH_M = 0.02
WALL_M = -0.016
STIFFNESS_N_PER_M = 1000.0
UPRIGHT = (0.0, 0.0, 0.0, 1.0)
EPOCH_S = 1.7e9
"""The ROS clock when the steady one shows 0."""

SETTINGS = GuardSettings(
    Limits(
        workspace_min_m=(-0.01, -0.01, -0.021),
        workspace_max_m=(0.01, 0.01, 0.001),
        max_speed_m_s=0.15,
        max_force_n=6.0,
    ),
    period_s=PERIOD_S,
    tracking_tolerance_m=0.005,
    pose_timeout_s=0.06,
    wrench_timeout_s=0.08,
    clock_tolerance_s=0.05,
)

FAULTS = (
    "none", "lag", "stop", "jump", "sensor_jump", "pose_silent", "wrench_silent", "pose_frozen", "pose_nan",
    "force_step", "early_contact", "clock_jump", "loop_stall", "commander_killed",
)  # fmt: skip


def press() -> Trajectory:
    """Down by 20 mm in 0.4 s, and up again: at most 0.094 m/s, 4 N where the wall is where it should be."""
    times = np.arange(101) / 100.0
    down = minimum_jerk(np.clip(times / 0.4, 0.0, 1.0))
    up = minimum_jerk(np.clip((times - 0.6) / 0.4, 0.0, 1.0))
    path = {
        "frame_id": "base_link",
        "positions_m": np.outer(down - up, [0.0, 0.0, -DEPTH_M]),
        "quaternions_xyzw": np.tile(UPRIGHT, (101, 1)),
    }
    return validate(Trajectory, {"times_s": times, "end_effectors": {"hand": path}}, "press")


@dataclass
class Log:
    """``poses``, ``wrenches``: (arrival, stamp, z or force); ``ticks``: (steady, ros, commanded z or None);
    ``forces``: (time, contact force), true ones; ``ended``: steady time of the tick that ended the replay;
    ``latency``: of the sensors."""

    fault: str
    poses: list[tuple[float, float, float]] = field(default_factory=list)
    wrenches: list[tuple[float, float, float]] = field(default_factory=list)
    ticks: list[tuple[float, float, float | None]] = field(default_factory=list)
    forces: list[tuple[float, float]] = field(default_factory=list)
    state: str = ""
    reason: str = ""
    ended: float = math.inf
    latency: float = 0.0


@dataclass
class Fault:
    """One fault of the plant, at a time [s], so large."""

    kind: str
    at: float
    size: float
    lasts: float

    @classmethod
    def drawn(cls, kind: str, rng: random.Random) -> Fault:
        """A fault from harmless to grave, at any time of the replay."""
        size = {
            "lag": (0.02, 0.3), "jump": (-0.012, 0.012), "sensor_jump": (-0.012, 0.012), "force_step": (0.5, 12.0),
            "early_contact": (0.0, 0.012), "clock_jump": (-0.2, 0.2), "loop_stall": (0.0, 0.3),
        }.get(kind, (0.0, 1.0))  # fmt: skip
        return cls(kind, rng.uniform(0.0, 1.0), rng.uniform(*size), rng.choice([0.03, 0.1, math.inf, math.inf]))

    def acts(self, now: float) -> bool:
        """Whether it acts at a time [s]."""
        return self.at <= now < self.at + self.lasts


def simulate(fault: Fault, rng: random.Random, settings: GuardSettings = SETTINGS, until: float = 1.8) -> Log:
    """Execute the press at time 0 on a plant with a fault, and go on for 0.3 s; readings flow since 0.1 s before."""
    session, log = Session(TRAJECTORY, settings, ["pad"]), Log(fault.kind)
    z = target = 0.0
    lag, latency = rng.uniform(0.005, 0.04), rng.uniform(0.0, 0.008)
    log.latency = latency
    wall = WALL_M + (fault.size if fault.kind == "early_contact" else 0.0)
    waiting: list[tuple[float, str, float, float]] = []
    stalled = jumped = started = False
    next_tick, next_reading, frozen = 0.0, -0.1, (0.0, 0.0)
    for number in range(-100, round(until / STEP_S)):
        now = number * STEP_S
        if now > log.ended + 0.3:
            break
        acts = fault.acts(now)
        ros = EPOCH_S + now + (fault.size if fault.kind == "clock_jump" and now >= fault.at else 0.0)
        slow = fault.size if fault.kind == "lag" and acts else lag
        if not (fault.kind == "stop" and acts):
            z += (target - z) * -math.expm1(-STEP_S / slow)
        if fault.kind == "jump" and now >= fault.at and not jumped:
            jumped, z = True, z + fault.size
        contact = STIFFNESS_N_PER_M * max(wall - z, 0.0)
        log.forces.append((now, contact))
        if now >= next_reading:
            next_reading += SENSOR_PERIOD_S
            shown = z + (fault.size if fault.kind == "sensor_jump" and acts else 0.0)
            reading = math.nan if fault.kind == "pose_nan" and acts else shown
            if fault.kind == "pose_frozen" and acts:
                waiting.append((now + latency, "pose", *frozen))
            elif not (fault.kind == "pose_silent" and acts):
                frozen = ros, reading
                waiting.append((now + latency, "pose", ros, reading))
            if not (fault.kind == "wrench_silent" and acts):
                force = contact + (fault.size if fault.kind == "force_step" and acts else 0.0)
                waiting.append((now + latency, "wrench", ros, force))
        instant = Instant(now, ros)
        hung = fault.kind == "loop_stall" and fault.at <= now < fault.at + fault.size
        if fault.kind == "commander_killed" and now >= fault.at:
            continue
        if hung:
            stalled = True
            continue
        while waiting and waiting[0][0] <= now:
            _, kind, stamp, value = waiting.pop(0)
            if kind == "pose":
                log.poses.append((now, stamp, value))
                session.guard.take_pose("hand", instant, stamp, "base_link", Placed((0.0, 0.0, value), UPRIGHT))
            else:
                log.wrenches.append((now, stamp, value))
                session.guard.take_wrench("pad", instant, stamp, (0.0, 0.0, -value), (0.0, 0.0, 0.0))
        if now >= next_tick:
            next_tick = (now if stalled else next_tick) + PERIOD_S
            stalled = False
            if not started:
                started = True
                log.reason = session.execute(instant)
            command = session.tick(instant)
            if command is not None:
                target = command["hand"].position[2]
            log.ticks.append((now, ros, None if command is None else target))
            next_tick += rng.uniform(-JITTER_S, JITTER_S) if fault.kind != "loop_stall" else 0.0
            if session.state in ("aborted", "succeeded") and math.isinf(log.ended):
                log.ended = now
    log.state, log.reason = session.state, session.reason
    return log


TRAJECTORY = press()


def first_violation(log: Log, settings: GuardSettings = SETTINGS) -> float:
    """Steady time [s] of the first control period in which a limit was violated as far as the log can tell; infinite if
    none was."""
    limits = settings.limits
    assert limits.workspace_min_m is not None
    assert limits.workspace_max_m is not None
    assert limits.max_force_n is not None
    offset = log.ticks[0][1] - log.ticks[0][0]
    low, high = limits.workspace_min_m[2], limits.workspace_max_m[2]
    bad = math.inf
    newest: dict[str, list[float]] = {"pose": [], "wrench": []}
    for kind, readings in (("pose", log.poses), ("wrench", log.wrenches)):
        stamps: list[tuple[float, float]] = []
        for arrival, stamp, value in readings:
            if stamps and stamp <= stamps[-1][1] and arrival > 0.0:
                continue  # no new reading
            if math.isnan(value):
                bad = min(bad, arrival) if arrival > 0.0 else bad
                continue
            stamps.append((arrival, stamp))
            if arrival <= 0.0:
                continue
            if kind == "wrench":
                wrong = value > limits.max_force_n
            else:
                commands = [c for t, _, c in log.ticks if t < arrival and c is not None]
                astray = bool(commands) and abs(commands[-1] - value) > settings.tracking_tolerance_m
                wrong = astray or not low <= value <= high
            if wrong:
                bad = min(bad, arrival)
        newest[kind] = [x for pair in stamps for x in pair]
    before = log.ticks[0][0]
    for steady, ros, _ in log.ticks[1:]:
        gap, before = steady - before, steady
        if steady >= bad or gap > max(3.0 * settings.period_s, settings.pose_timeout_s):
            return steady
        if abs(ros - steady - offset) > settings.clock_tolerance_s:
            return steady
        for kind, timeout in (("pose", settings.pose_timeout_s), ("wrench", settings.wrench_timeout_s)):
            arrivals, stamps_ = newest[kind][::2], newest[kind][1::2]
            last = max((i for i, arrival in enumerate(arrivals) if arrival <= steady), default=-1)
            if last < 0 or steady - arrivals[last] > timeout or abs(ros - stamps_[last]) > timeout:
                return steady
    return math.inf


def with_limits(**changes: Any) -> GuardSettings:
    """The settings with other limits."""
    return replace(SETTINGS, limits=SETTINGS.limits.model_copy(update=changes))
