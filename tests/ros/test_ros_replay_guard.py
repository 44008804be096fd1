"""The guards of the replay without ROS: no limit is exceeded by more than one control period, whatever fails."""

from __future__ import annotations

import math
import random
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_plant import (
    DEPTH_M,
    FAULTS,
    JITTER_S,
    PERIOD_S,
    SENSOR_PERIOD_S,
    SETTINGS,
    STEP_S,
    STIFFNESS_N_PER_M,
    TRAJECTORY,
    UPRIGHT,
    Fault,
    Log,
    first_violation,
    simulate,
    with_limits,
)

from sim_core.errors import ConfigError
from sim_core.rigs.trajectory import MINIMUM_JERK_PEAK
from sim_core.trajectories import Limits, check_trajectory
from thinshell_ros.replay.guard import GuardSettings, Instant, Placed, turn_between
from thinshell_ros.replay.session import CATCH_UP, HOLD_S, Session, checked

PEAK_M_S = MINIMUM_JERK_PEAK * DEPTH_M / 0.4


def assert_nothing_is_exceeded(log: Log) -> None:
    """What must hold of every replay, whatever failed."""
    limits = SETTINGS.limits
    assert limits.workspace_min_m is not None
    assert limits.workspace_max_m is not None
    assert limits.max_speed_m_s is not None
    assert limits.max_force_n is not None
    if log.fault != "commander_killed":
        violated = first_violation(log)
        if math.isinf(violated) or violated > log.ended:
            assert log.state == "succeeded", log.reason
        else:
            assert log.state == "aborted"
            assert log.ended == violated, "it ends in the first period in which a limit is exceeded"
    commands = [(t, z) for t, _, z in log.ticks if z is not None]
    held = [z for t, z in commands if t >= log.ended]
    assert len(set(held)) <= 1, "what is held does not move"
    assert all(limits.workspace_min_m[2] <= z <= limits.workspace_max_m[2] for _, z in commands)
    for (before, start), (now, end) in pairwise(commands):
        if now == log.ended and log.state == "aborted":
            assert abs(end - start) <= SETTINGS.tracking_tolerance_m
        else:
            most = min(now - before, CATCH_UP * PERIOD_S)
            assert abs(end - start) <= limits.max_speed_m_s * most + 1e-12
    if log.fault != "jump":  # the wall's answer to a jump is at once, before anyone can know
        seen_after_s = STEP_S + SENSOR_PERIOD_S + log.latency + PERIOD_S + 2.0 * JITTER_S
        most = limits.max_force_n + STIFFNESS_N_PER_M * PEAK_M_S * seen_after_s
        assert max(force for _, force in log.forces) <= most


def replays(count: int) -> Counter[tuple[str, str]]:
    """Replays with faults by seed; how often each kind of fault ended how."""
    ends: Counter[tuple[str, str]] = Counter()
    for seed in range(count):
        rng = random.Random(seed)
        fault = Fault.drawn(FAULTS[seed % len(FAULTS)], rng)
        log = simulate(fault, rng)
        try:
            assert_nothing_is_exceeded(log)
        except AssertionError as error:
            raise AssertionError(f"seed {seed}, {fault}: {log.state}, {log.reason!r}: {error}") from error
        ends[fault.kind, log.state] += 1
    return ends


def test_some_random_faults_exceed_nothing_by_more_than_a_period() -> None:
    ends = replays(3 * len(FAULTS))
    assert ends["none", "succeeded"] == 3


@pytest.mark.slow
def test_a_thousand_random_faults_exceed_nothing_by_more_than_a_period() -> None:
    ends = replays(1000)
    for kind in FAULTS:
        if kind not in ("none", "commander_killed"):
            assert ends[kind, "aborted"] >= 5, f"{kind}: {ends}"
    assert {state for kind, state in ends if kind == "none"} == {"succeeded"}
    assert {state for kind, state in ends if kind == "commander_killed"} <= {"running", "succeeded"}


# The guards one by one, each on both sides of its limit.

CALM = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class Bench:
    """A session with a robot that follows exactly, from which readings can be made to differ."""

    def __init__(self, given: GuardSettings = SETTINGS, scale: float = 1.0) -> None:
        self.session = Session(TRAJECTORY, given, ["pad"], scale)
        self.given = given
        self.at_s = 0.0
        self.jump_s = 0.0

    @property
    def now(self) -> Instant:
        return Instant(self.at_s, 1.7e9 + self.at_s + self.jump_s)

    def feed(
        self,
        *,
        away: float = 0.0,
        turn: float = 0.0,
        z: float | None = None,
        length: float = 1.0,
        frame: str = "base_link",
        wrench: Any = CALM,
        late: float = 0.0,
    ) -> None:
        """Readings of a robot that is where it should be, but for what is said."""
        commanded = self.session.commanded.get("hand", Placed((0.0, 0.0, 0.0), UPRIGHT))
        height = commanded.position[2] if z is None else z
        half = turn / 2.0
        pose = Placed((away, 0.0, height), (length * math.sin(half), 0.0, 0.0, length * math.cos(half)))
        self.session.guard.take_pose("hand", self.now, self.now.ros_s - late, frame, pose)
        self.session.guard.take_wrench("pad", self.now, self.now.ros_s - late, *wrench)

    def start(self) -> Bench:
        self.feed()
        assert self.session.execute(self.now) == ""
        return self

    def run(self, seconds: float) -> Bench:
        """Control periods in which all is well."""
        for _ in range(round(seconds / PERIOD_S)):
            self.at_s += PERIOD_S
            self.feed()
            self.session.tick(self.now)
        return self


@pytest.mark.parametrize(
    ("good", "bad", "said"),
    [
        ({"away": 0.0049}, {"away": 0.0051}, "hand is 0.0051 m away from its commanded pose, at most 0.005 m"),
        ({"turn": 0.099}, {"turn": 0.101}, "turned by 0.101 rad against its commanded pose, at most 0.1 rad"),
        ({"z": 0.0009}, {"z": 0.0011}, "left the workspace: z is 0.0011 m, above 0.001 m"),
        ({"wrench": ((3.6, 0, 4.7), (0, 0, 0))}, {"wrench": ((3.6, 0, 4.9), (0, 0, 0))}, "on pad is 6.08 N, at most 6"),
        ({"wrench": ((0, 0, 0), (0, 0.3, 0.4))}, {"wrench": ((0, 0, 0), (0, 0.4, 0.4))}, "torque on pad is 0.5657 N m"),
        ({}, {"wrench": ((math.nan, 0, 0), (0, 0, 0))}, "The wrench pad is not finite"),
        ({}, {"z": math.inf}, "The pose of hand is not finite"),
        ({"length": 1.0009}, {"length": 1.0011}, "orientation of length 1.001"),
        ({}, {"frame": "world"}, "in the frame 'world', and the trajectory is in 'base_link'"),
    ],
)
def test_a_reading_beyond_a_limit_ends_the_replay_before_the_next_command(
    good: dict[str, Any], bad: dict[str, Any], said: str
) -> None:
    for reading, state in ((good, "running"), (bad, "aborted")):
        bench = Bench(with_limits(max_torque_nm=0.51)).start().run(0.05)
        bench.at_s += 0.001
        bench.feed(**reading)
        bench.at_s += 0.001
        command = bench.session.tick(bench.now)
        assert bench.session.state == state, bench.session.reason
        assert command is not None
        assert said in bench.session.reason or state == "running"


@pytest.mark.parametrize(
    ("change", "good", "bad", "said"),
    [
        ({"wrench_timeout_s": 0.04}, 0.039, 0.041, "The last reading of the wrench pad came 0.041 s ago"),
        ({"pose_timeout_s": 0.04}, 0.039, 0.041, "The control loop stood still for 0.041 s"),
    ],
)
def test_silence_ends_the_replay(change: dict[str, Any], good: float, bad: float, said: str) -> None:
    for gap, state in ((good, "running"), (bad, "aborted")):
        bench = Bench(replace(SETTINGS, **change)).start().run(0.05)
        bench.at_s += gap
        bench.session.tick(bench.now)
        assert bench.session.state == state, bench.session.reason
        assert said in bench.session.reason or state == "running"


@pytest.mark.parametrize(("sign", "said"), [(1, "0.061 s old"), (-1, "0.061 s in the future")])
def test_stamps_may_be_off_by_the_time_out_and_no_more(sign: int, said: str) -> None:
    bench, late = Bench().start(), 0
    while bench.session.report().message == "running":
        late += 1
        bench.at_s += PERIOD_S
        bench.feed(late=1e-3 * sign * late)
        bench.session.tick(bench.now)
    assert late == 61
    assert f"The stamp of the pose of hand is {said}, at most 0.06 s" in bench.session.reason


def test_a_reading_that_was_late_already_and_then_nothing_is_told_as_silence() -> None:
    bench = Bench().start().run(0.05)
    bench.at_s += 0.001
    bench.feed(late=0.0009)
    for _ in range(6):
        bench.at_s += PERIOD_S
        bench.session.tick(bench.now)
    assert bench.session.reason == (
        "The last reading of the pose of hand is from 0.061 s ago, at most 0.06 s is allowed."
    )


@pytest.mark.parametrize("jump", [-0.2, -0.051, -0.049, 0.049, 0.051, 0.2, 1e6])
def test_a_jump_of_the_clock_ends_the_replay(jump: float) -> None:
    bench = Bench().start().run(0.05)
    bench.jump_s = jump
    bench.at_s += PERIOD_S
    bench.session.tick(bench.now)
    assert (bench.session.state == "aborted") is (abs(jump) > 0.05)
    if abs(jump) > 0.05:
        assert f"The ROS clock jumped by {jump:.3f} s" in bench.session.reason


def test_a_clock_that_drifts_slowly_is_found_too() -> None:
    bench = Bench().start()
    while bench.session.state == "running" and bench.at_s < 0.9:
        bench.jump_s += 0.001
        bench.run(PERIOD_S)
    assert "jumped by 0.051 s" in bench.session.reason


def test_simulated_time_may_be_slow_but_not_go_back() -> None:
    """A tenth of real time: the trajectory goes on with it, and readings may be ten times as far apart by the wall."""
    slow = replace(SETTINGS, simulated_time=True)
    bench = Bench(slow).start()
    for count in range(200):
        bench.at_s += PERIOD_S
        bench.jump_s -= 0.9 * PERIOD_S
        if count % 20 == 0:
            bench.feed()
        bench.session.tick(bench.now)
    assert bench.session.state == "running", bench.session.reason
    assert bench.session.time_s == pytest.approx(0.2, rel=1e-6)
    bench.jump_s -= 0.02
    bench.session.tick(bench.now)
    assert "The ROS clock jumped by -0.020 s" in bench.session.reason


def test_simulated_time_that_stands_still_is_silence() -> None:
    bench = Bench(replace(SETTINGS, simulated_time=True)).start()
    for _ in range(250):
        bench.at_s += PERIOD_S
        bench.jump_s -= PERIOD_S
        bench.session.tick(bench.now)
    assert bench.session.time_s == 0.0
    assert "came 2.0" in bench.session.reason


def test_it_does_not_begin_from_elsewhere_or_blind() -> None:
    bench = Bench()
    assert "No reading of the pose of hand has come" in bench.session.execute(bench.now)
    bench.feed(away=0.0021)
    assert "0.0021 m away from its first pose, at most 0.002 m" in bench.session.execute(bench.now)
    bench.feed(turn=0.021)
    assert "turned by 0.021 rad against its first pose" in bench.session.execute(bench.now)
    bench.feed(wrench=((0.0, 0.0, 7.0), (0.0, 0.0, 0.0)))
    assert "The force on pad is 7 N" in bench.session.execute(bench.now)
    bench.feed()
    bench.at_s += 0.061
    assert "The last reading of the pose of hand" in bench.session.execute(bench.now)
    assert bench.session.tick(bench.now) is None
    assert bench.session.state == "idle"
    bench.feed(away=0.0019)
    assert bench.session.execute(bench.now) == ""
    assert "A replay is running" in bench.session.execute(bench.now)


def test_a_reading_without_a_stamp_is_told_and_may_be_allowed() -> None:
    bench = Bench()
    bench.feed(late=bench.now.ros_s)
    assert "has no stamp" in bench.session.execute(bench.now)
    bench = Bench(replace(SETTINGS, check_stamps=False))
    bench.feed(late=bench.now.ros_s)
    assert bench.session.execute(bench.now) == ""


def test_a_replay_may_be_repeated_after_the_clock_went_back() -> None:
    bench = Bench().start().run(0.05)
    bench.jump_s = -10.0
    bench.run(PERIOD_S)
    assert bench.session.report().message == "aborted"
    bench.feed(z=0.0)
    assert bench.session.execute(bench.now) == ""
    bench.run(2.0)
    assert bench.session.report().message == "succeeded"


def test_it_holds_where_the_robot_is_unless_that_is_not_to_be_trusted() -> None:
    def held(after_s: float = 0.2, **reading: Any) -> tuple[Placed, Placed]:
        bench = Bench().start().run(after_s)
        commanded = bench.session.commanded["hand"]
        bench.at_s += 0.001
        bench.feed(**reading)
        bench.session.abort(bench.now, "told to")
        return bench.session.commanded["hand"], commanded

    pose, commanded = held(away=0.003)
    assert pose.position == (0.003, 0.0, commanded.position[2])
    for untrusted in ({"away": 0.006}, {"z": math.nan}, {"frame": "world"}, {"length": 2.0}):
        pose, commanded = held(**untrusted)
        assert pose == commanded, untrusted
    pose, commanded = held(0.02, z=0.0015)
    assert pose == commanded, "not where it is outside the workspace"


def test_what_is_held_is_repeated_for_a_while_and_nothing_after() -> None:
    bench = Bench().start().run(0.2)
    bench.session.abort(bench.now, "told to")
    held = bench.session.commanded
    assert not bench.session.abort(bench.now, "again")
    while bench.at_s < 0.2 + HOLD_S - PERIOD_S:
        bench.at_s += PERIOD_S
        assert bench.session.tick(bench.now) == held
    bench.at_s += 2.0 * PERIOD_S
    assert bench.session.tick(bench.now) is None
    assert bench.session.report().level == "error"
    assert bench.session.report().values["detail"] == "told to"


def test_a_dry_run_commands_without_anything_that_follows() -> None:
    bench = Bench(replace(SETTINGS, moves=False)).start()
    for _ in range(160):
        bench.at_s += PERIOD_S
        bench.feed(z=0.0)
        bench.session.tick(bench.now)
    assert bench.session.state == "succeeded", bench.session.reason
    assert bench.session.report().values["dry_run"] == "true"


@settings(max_examples=60, deadline=None)
@given(scale=st.floats(0.05, 1.0), gaps=st.lists(st.floats(0.001, 0.05), min_size=20, max_size=80))
def test_commands_stay_on_the_curve_and_no_late_period_makes_them_leap(scale: float, gaps: list[float]) -> None:
    bench = Bench(scale=scale).start()
    path = TRAJECTORY.poses()["hand"]
    before = bench.session.commanded["hand"].position[2]
    for gap in gaps:
        bench.at_s += gap
        bench.feed()
        bench.session.tick(bench.now)
        now = bench.session.commanded["hand"].position[2]
        assert abs(now - before) <= PEAK_M_S * scale * min(gap, CATCH_UP * PERIOD_S) * 1.001
        exact = path.at(min(bench.session.time_s, TRAJECTORY.duration_s))[0][2]
        assert now == pytest.approx(exact, abs=1e-6)
        before = now
    assert bench.session.time_s <= scale * sum(gaps) + 1e-9


readings = st.fixed_dictionaries(
    {},
    optional={
        "away": st.floats(-0.02, 0.02),
        "turn": st.floats(-0.3, 0.3),
        "z": st.floats(allow_nan=True, allow_infinity=True),
        "length": st.floats(0.0, 2.0),
        "frame": st.sampled_from(["base_link", "world"]),
        "wrench": st.tuples(*[st.tuples(*[st.floats(-10.0, 10.0)] * 3)] * 2),
        "late": st.floats(-0.2, 0.2),
    },
)


@settings(max_examples=150, deadline=None)
@given(events=st.lists(st.tuples(st.floats(0.0, 0.12), readings, st.floats(-0.1, 0.1)), max_size=40))
def test_whatever_comes_commands_stay_in_the_box_and_an_end_is_an_end(
    events: list[tuple[float, dict[str, Any], float]],
) -> None:
    bench = Bench().start()
    held = None
    for gap, reading, jump in events:
        bench.at_s += gap
        bench.jump_s += jump if abs(jump) > 0.08 else 0.0
        before = bench.session.commanded["hand"]
        bench.feed(**reading)
        command = bench.session.tick(bench.now)
        pose = bench.session.commanded["hand"]
        if held is not None:
            assert bench.session.state == "aborted"
            assert command in (None, held)
            assert pose == held["hand"]
        elif bench.session.state == "aborted":
            assert math.dist(pose.position, before.position) <= SETTINGS.tracking_tolerance_m
            assert turn_between(pose.quaternion, before.quaternion) <= SETTINGS.tracking_tolerance_rad
            assert bench.session.reason
            held = bench.session.commanded
        assert all(map(math.isfinite, (*pose.position, *pose.quaternion)))
        low, high = SETTINGS.limits.workspace_min_m, SETTINGS.limits.workspace_max_m
        assert low is not None
        assert high is not None
        assert all(a <= p <= b for a, p, b in zip(low, pose.position, high, strict=True))


def test_the_whole_trajectory_is_checked_with_the_stricter_limits() -> None:
    assert checked(TRAJECTORY, SETTINGS, 1.0) == check_trajectory(TRAJECTORY, SETTINGS.limits)
    with pytest.raises(ConfigError, match="The speed of hand is"):
        checked(TRAJECTORY, with_limits(max_speed_m_s=0.05), 1.0)
    checked(TRAJECTORY, with_limits(max_speed_m_s=0.05), 0.5)
    boxless = GuardSettings(Limits())
    with pytest.raises(ConfigError, match="There is no workspace box"):
        checked(TRAJECTORY, boxless, 1.0)
    checked(TRAJECTORY, replace(boxless, moves=False), 1.0)


def test_setpoints_are_the_curve_of_the_simulator() -> None:
    path = TRAJECTORY.poses()["hand"]
    setpoints = Bench().session.setpoints
    for time in np.linspace(-0.1, 1.1, 97):
        position, quaternion = path.at(float(np.clip(time, 0.0, 1.0)))
        found = setpoints.poses(float(time))["hand"]
        np.testing.assert_allclose(found.position, position, atol=2e-6)
        np.testing.assert_allclose(found.quaternion, quaternion, atol=1e-9)
