"""A plant for the replay's guards: an end effector that follows its target with a lag and presses on a wall, sensors
with latency and noise, a control loop with jitter, and one fault. No ROS.

Everything that the guards could know, and when, is in the log; :func:`first_violation` says from the log alone, by the
words of docs/replay.md, in which control period a replay had to end.
"""

from __future__ import annotations

import math
import random
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sim_core.rigs.trajectory import minimum_jerk
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories import Limits, Trajectory
from thinshell_ros.replay.guard import GuardSettings
from thinshell_ros.replay.session import Session
from thinshell_ros.replay.streams import Instant
from thinshell_ros.replay.tracking import Placed

STEP_S = 0.001
PERIOD_S = 0.01
JITTER_S = 0.002
SENSOR_PERIOD_S = 0.005
MARKER_PERIOD_S = 0.02
DEPTH_M = 0.02
WALL_M = -0.016
STIFFNESS_N_PER_M = 1000.0
PEAK_N = STIFFNESS_N_PER_M * (DEPTH_M + WALL_M)
NOISE_N = 0.01
LAG_S = 0.1
NEAR_M = 0.002
MARKERS = 12
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
    pose_timeout_s=0.06,
    wrench_timeout_s=0.08,
    marker_timeout_s=0.08,
    clock_tolerance_s=0.05,
)

FAULTS = (
    "none", "lag", "late", "stop", "jump", "sensor_jump", "pose_once", "pose_silent", "wrench_silent", "markers_silent",
    "pose_frozen", "pose_nan", "wrench_dead", "wrench_constant", "wrench_frame", "wrench_turned", "markers_vanish",
    "force_step", "early_contact", "clock_jump", "loop_stall", "commander_killed",
)  # fmt: skip


CAUSES = {
    "lag": r"follows its commands [\d.]+ s late|has stood still",
    "late": r"follows its commands [\d.]+ s late|has stood still",
    "stop": r"follows its commands [\d.]+ s late|has stood still",
    "jump": r"measured pose of hand jumped|hand has left the workspace|force on pad",
    "sensor_jump": r"measured pose of hand jumped|hand has left the workspace",
    "pose_once": r"measured pose of hand jumped|hand has left the workspace",
    "pose_silent": r"last reading of the pose of hand",
    "wrench_silent": r"last reading of the wrench pad",
    "markers_silent": r"last reading of the markers gel",
    "pose_frozen": r"last reading of the pose of hand",
    "pose_nan": r"pose of hand is not finite",
    "wrench_dead": r"reads exactly 0.*dead|same reading .* sensor has stopped",
    "wrench_constant": r"reads exactly .*dead|same reading .* sensor has stopped",
    "wrench_frame": r"wrench pad is in the frame 'flange', and it is expected in 'pad'",
    "wrench_turned": r"turned by \d+ deg against it.*another frame",
    "markers_vanish": r"markers gel \d+ are seen, 12 were before",
    "force_step": r"force on pad is .* at most 6 N|force on pad has changed by",
    "early_contact": r"force on pad is .* at most 6 N|force on pad has changed by",
    "clock_jump": r"ROS clock jumped by|stamp of the .* is|last reading of the .* is from",
    "loop_stall": r"control loop stood still",
}
"""What the sentence has to say where a fault ends a replay."""


def height(time_s: np.ndarray) -> np.ndarray:
    """The press: down by 20 mm in 0.4 s, and up again."""
    down = minimum_jerk(np.clip(np.asarray(time_s) / 0.4, 0.0, 1.0))
    up = minimum_jerk(np.clip((np.asarray(time_s) - 0.6) / 0.4, 0.0, 1.0))
    return np.asarray(-DEPTH_M * (down - up))


def contact_force(z: np.ndarray) -> np.ndarray:
    """Force of the wall [N], where it should be."""
    return np.asarray(STIFFNESS_N_PER_M * np.maximum(WALL_M - z, 0.0))


def press() -> Trajectory:
    """At most 0.094 m/s, 4 N where the wall is where it should be."""
    times = np.arange(101) / 100.0
    path = {
        "frame_id": "base_link",
        "positions_m": np.outer(height(times), [0.0, 0.0, 1.0]),
        "quaternions_xyzw": np.tile(UPRIGHT, (101, 1)),
        "tolerance_m": NEAR_M,
        "max_lag_s": LAG_S,
    }
    force = contact_force(height(times))
    wrench = {
        "frame_id": "pad",
        "forces_n": np.outer(force, [0.0, 0.0, -1.0]),
        "torques_nm": np.zeros((101, 3)),
        "force_noise_n": NOISE_N,
        "torque_noise_nm": 1e-4,
        "rate_hz": 1.0 / SENSOR_PERIOD_S,
    }
    rest = np.column_stack([np.arange(MARKERS) * 1e-3, np.zeros(MARKERS), np.zeros(MARKERS)])
    markers = {
        "frame_id": "pad",
        "ids": np.arange(MARKERS),
        "positions_m": rest + 1e-4 * force[:, None, None] * np.array([0.0, 0.0, 1.0]),
        "position_noise_m": 1e-5,
        "rate_hz": 1.0 / MARKER_PERIOD_S,
    }
    predicted = {"wrenches": {"pad": wrench}, "markers": {"gel": markers}}
    data = {"times_s": times, "end_effectors": {"hand": path}, "predicted": predicted, "interpolation": "spline"}
    return validate(Trajectory, data, "press")


@dataclass
class Log:
    """``poses``: (arrival, stamp, z); ``wrenches``: (arrival, stamp, force along -z, frame, exact repeats);
    ``markers``: (arrival, stamp, how many); ``ticks``: (steady, ros, commanded z or None, time of the trajectory);
    ``forces``: (time, contact force), true ones; ``ended``: steady time of the tick that ended the replay;
    ``latency``: of the sensors."""

    fault: str
    poses: list[tuple[float, float, float]] = field(default_factory=list)
    wrenches: list[tuple[float, float, tuple[float, float, float], str, int]] = field(default_factory=list)
    markers: list[tuple[float, float, int]] = field(default_factory=list)
    ticks: list[tuple[float, float, float | None, float]] = field(default_factory=list)
    forces: list[tuple[float, float]] = field(default_factory=list)
    state: str = ""
    reason: str = ""
    ended: float = math.inf
    latency: float = 0.0
    alarm: str = ""


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
            "lag": (0.02, 0.3), "late": (0.02, 0.8), "jump": (-0.012, 0.012), "sensor_jump": (-0.012, 0.012),
            "pose_once": (-0.012, 0.012), "force_step": (0.5, 12.0), "early_contact": (0.0, 0.012),
            "clock_jump": (-0.2, 0.2), "loop_stall": (0.0, 0.3), "wrench_turned": (0.2, 3.1),
            "markers_vanish": (0.1, 1.0),
        }.get(kind, (0.0, 1.0))  # fmt: skip
        return cls(kind, rng.uniform(0.0, 1.0), rng.uniform(*size), rng.choice([0.03, 0.1, math.inf, math.inf]))

    def acts(self, now: float) -> bool:
        """Whether it acts at a time [s]."""
        return self.at <= now < self.at + self.lasts


class Hand:
    """The end effector with its wall and its sensors, and one fault. ``ros_s``: of the clock that stamps."""

    def __init__(self, fault: Fault, rng: random.Random, log: Log) -> None:
        self.fault, self.log = fault, log
        self.z = self.target = 0.0
        self.sent: list[tuple[float, float]] = [(-1.0, 0.0)]
        """When was commanded what."""
        self._lag, log.latency = rng.uniform(0.005, 0.03), rng.uniform(0.0, 0.008)
        self._noise = np.random.default_rng(rng.randrange(2**31))
        self._wall = WALL_M + (fault.size if fault.kind == "early_contact" else 0.0)
        self._contact = 0.0
        self._jumped = self._shown_once = False
        self._frozen = (0.0, 0.0)
        self._held, self._last, self._repeats = np.zeros(3), np.full(3, np.nan), 0
        self._next_reading = self._next_cloud = -0.2

    def command(self, now: float, z: float) -> None:
        """This height is commanded from now on."""
        self.target = z
        self.sent.append((now, z))

    def move(self, now: float) -> None:
        """A step of time."""
        fault, acts = self.fault, self.fault.acts(now)
        slow = fault.size if fault.kind == "lag" and acts else self._lag
        aim = self.target
        if fault.kind == "late" and now >= 0.0:
            aim = next(value for when, value in reversed(self.sent) if when <= now - fault.size or when == -1.0)
        if not (fault.kind == "stop" and acts):
            self.z += (aim - self.z) * -math.expm1(-STEP_S / slow)
        if fault.kind == "jump" and now >= fault.at and not self._jumped:
            self._jumped, self.z = True, self.z + fault.size
        self._contact = STIFFNESS_N_PER_M * max(self._wall - self.z, 0.0)
        self.log.forces.append((now, self._contact))

    def sense(self, now: float, ros_s: float) -> list[tuple[str, float, Any]]:
        """Readings that are taken now: kind, stamp, and z, or (force, frame, repeats), or (how many markers, where)."""
        found: list[tuple[str, float, Any]] = []
        if now >= self._next_reading:
            self._next_reading += SENSOR_PERIOD_S
            found += [*self._pose(now, ros_s), *self._wrench(now, ros_s)]
        if now >= self._next_cloud:
            self._next_cloud += MARKER_PERIOD_S
            found += self._markers(now, ros_s)
        return found

    def _pose(self, now: float, ros_s: float) -> list[tuple[str, float, Any]]:
        kind, acts = self.fault.kind, self.fault.acts(now)
        shown = self.z + (self.fault.size if kind == "sensor_jump" and acts else 0.0)
        if kind == "pose_once" and now >= self.fault.at and not self._shown_once:
            self._shown_once, shown = True, self.z + self.fault.size
        reading = math.nan if kind == "pose_nan" and acts else shown
        if kind == "pose_frozen" and acts:
            return [("pose", *self._frozen)]
        if kind == "pose_silent" and acts:
            return []
        self._frozen = ros_s, reading
        return [("pose", ros_s, reading)]

    def _wrench(self, now: float, ros_s: float) -> list[tuple[str, float, Any]]:
        kind, size, acts = self.fault.kind, self.fault.size, self.fault.acts(now)
        force = np.array([0.0, 0.0, -self._contact]) + NOISE_N * self._noise.standard_normal(3)
        force[2] -= size if kind == "force_step" and acts else 0.0
        if kind == "wrench_turned" and acts:
            c, s = math.cos(size), math.sin(size)
            force = np.array([c * force[0] + s * force[2], force[1], c * force[2] - s * force[0]])
        if kind in ("wrench_dead", "wrench_constant") and acts:
            force = np.zeros(3) if kind == "wrench_dead" else self._held
        self._held = force
        if kind == "wrench_silent" and acts:
            return []
        self._repeats = self._repeats + 1 if np.array_equal(force, self._last) else 0
        self._last = force
        frame = "flange" if kind == "wrench_frame" and acts else "pad"
        return [("wrench", ros_s, (tuple(force.tolist()), frame, self._repeats))]

    def _markers(self, now: float, ros_s: float) -> list[tuple[str, float, Any]]:
        kind, acts = self.fault.kind, self.fault.acts(now)
        left = MARKERS - (round(self.fault.size * MARKERS) if kind == "markers_vanish" and acts else 0)
        rest = TRAJECTORY.predicted.markers["gel"].positions_m[0]
        places = rest + 1e-4 * self._contact * np.array([0.0, 0.0, 1.0])
        places = places + 1e-5 * self._noise.standard_normal(rest.shape)
        return [] if kind == "markers_silent" and acts else [("markers", ros_s, (left, places))]

    def note(self, now: float, kind: str, stamp: float, value: Any) -> None:
        """A reading has arrived."""
        if kind == "pose":
            self.log.poses.append((now, stamp, value))
        elif kind == "wrench":
            self.log.wrenches.append((now, stamp, *value))
        else:
            self.log.markers.append((now, stamp, value[0]))


def simulate(
    fault: Fault, rng: random.Random, settings: GuardSettings = SETTINGS, until: float = 1.8, scale: float = 1.0
) -> Log:
    """Execute the press at time 0 on a plant with a fault, and go on for 0.3 s; readings flow since 0.2 s before."""
    session = Session(TRAJECTORY, settings, ["pad"], scale, ["gel"])
    log = Log(fault.kind)
    hand = Hand(fault, rng, log)
    waiting: list[tuple[float, str, float, Any]] = []
    stalled = started = False
    next_tick = 0.0
    for number in range(-200, round(until / STEP_S)):
        now = number * STEP_S
        if now > log.ended + 0.3:
            break
        ros = EPOCH_S + now + (fault.size if fault.kind == "clock_jump" and now >= fault.at else 0.0)
        hand.move(now)
        waiting += [(now + log.latency, *reading) for reading in hand.sense(now, ros)]
        instant = Instant(now, ros)
        hung = fault.kind == "loop_stall" and fault.at <= now < fault.at + fault.size
        if fault.kind == "commander_killed" and now >= fault.at:
            continue
        if hung:
            stalled = True
            continue
        while waiting and waiting[0][0] <= now:
            _, kind, stamp, value = waiting.pop(0)
            hand.note(now, kind, stamp, value)
            if kind == "pose":
                session.take_pose("hand", instant, stamp, "base_link", Placed((0.0, 0.0, value), UPRIGHT))
            elif kind == "wrench":
                session.take_wrench("pad", instant, stamp, value[1], value[0], (0.0, 0.0, 0.0))
            else:
                left, places = value
                session.take_markers("gel", instant, stamp, "pad", np.arange(left), places[:left])
        if now >= next_tick:
            next_tick = (now if stalled else next_tick) + PERIOD_S
            stalled = False
            if not started:
                started = True
                log.reason = session.execute(instant)
            command = session.tick(instant)
            if command is not None:
                hand.command(now, command["hand"].position[2])
            log.ticks.append((now, ros, None if command is None else hand.target, session.time_s))
            next_tick += rng.uniform(-JITTER_S, JITTER_S) if fault.kind != "loop_stall" else 0.0
            if session.state in ("aborted", "succeeded") and math.isinf(log.ended):
                log.ended = now
    log.state, log.reason = session.state, session.reason
    log.alarm = "" if session.watch.alarm is None else session.watch.alarm.text
    return log


TRAJECTORY = press()
ALLOWED_N = 0.5 * PEAK_N
"""Half of the largest change of the predicted force."""


def first_violation(log: Log, settings: GuardSettings = SETTINGS, margin: float = 0.0, scale: float = 1.0) -> float:
    """Steady time [s] of the first control period in which a limit was violated as far as the log can tell; infinite if
    none was. ``margin``: share by which bounds of poses and forces about their predictions are wider."""
    limits = settings.limits
    assert limits.workspace_min_m is not None
    assert limits.workspace_max_m is not None
    assert limits.max_force_n is not None
    offset = log.ticks[0][1] - log.ticks[0][0]
    low, high = limits.workspace_min_m[2], limits.workspace_max_m[2]
    before = log.ticks[0][0]
    bad = math.inf
    newest: dict[str, list[tuple[float, float]]] = {"pose": [], "wrench": [], "markers": []}

    steadies, stamps = [t[0] for t in log.ticks], [t[1] for t in log.ticks]
    heights, passed = [t[2] for t in log.ticks], [t[3] for t in log.ticks]

    def taken(kind: str, arrival: float, stamp: float) -> bool:
        if newest[kind] and stamp <= newest[kind][-1][1] and arrival > before:
            return False  # no new reading
        newest[kind].append((arrival, stamp))
        return True

    for arrival, stamp, value in log.poses:
        if not math.isnan(value) and not taken("pose", arrival, stamp):
            continue
        if arrival > before:
            done = bisect_left(steadies, arrival)
            begin = min(bisect_right(stamps, stamp - LAG_S, hi=done), done)
            lately = [c for c in heights[max(begin - 1, 0) : done] if c is not None] or [0.0]
            near = NEAR_M * (1.0 + margin)
            astray = not min(lately) - near <= value <= max(lately) + near
            if math.isnan(value) or astray or not low <= value <= high:
                bad = min(bad, arrival)
    noises = 6.0 * NOISE_N
    seen = [np.array(force) for arrival, _, force, _, _ in log.wrenches if arrival <= before][-32:]
    start = np.mean(seen, axis=0)
    for arrival, stamp, force, frame, repeats in log.wrenches:
        if arrival > before and frame != "pad":
            bad = min(bad, arrival)
            continue
        if not taken("wrench", arrival, stamp) or arrival <= before:
            continue
        done = bisect_left(steadies, arrival)
        since = np.interp(stamp, stamps[max(done - 30, 0) : done], passed[max(done - 30, 0) : done])
        reach = (LAG_S + PERIOD_S) * scale
        within = contact_force(height(np.linspace(since - reach, since, 60)))
        wide = ALLOWED_N + noises + margin * PEAK_N
        off = np.array(force) - start
        odd = not within.min() - wide <= -off[2] <= within.max() + wide or max(abs(off[:2])) > wide
        # 33 readings before, none of which repeats: k in a row have the probability 1 / 34^k.
        if odd or np.linalg.norm(force) > limits.max_force_n or (repeats >= 6 + (1 if margin > 0.0 else -1)):
            bad = min(bad, arrival)
    for arrival, stamp, left in log.markers:
        if taken("markers", arrival, stamp) and arrival > before and left <= MARKERS // 2:
            bad = min(bad, arrival)
    for steady, ros, _, _ in log.ticks[1:]:
        gap, before = steady - before, steady
        if steady >= bad or gap > max(3.0 * settings.period_s, settings.pose_timeout_s):
            return steady
        if abs(ros - steady - offset) > settings.clock_tolerance_s:
            return steady
        for kind, timeout in (
            ("pose", settings.pose_timeout_s),
            ("wrench", settings.wrench_timeout_s),
            ("markers", settings.marker_timeout_s),
        ):
            last = max((i for i, (arrival, _) in enumerate(newest[kind]) if arrival <= steady), default=-1)
            if last < 0 or steady - newest[kind][last][0] > timeout or abs(ros - newest[kind][last][1]) > timeout:
                return steady
    return math.inf


def with_limits(**changes: Any) -> GuardSettings:
    """The settings with other limits."""
    return replace(SETTINGS, limits=SETTINGS.limits.model_copy(update=changes))
