"""The guards of the replay one by one, each on both sides of its limit, without ROS."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from replay_bench import HELD_M, PEAK_M_S, Bench
from replay_plant import (
    LAG_S,
    NEAR_M,
    PERIOD_S,
    SETTINGS,
    TRAJECTORY,
    with_limits,
)

from sim_core.errors import ConfigError
from sim_core.trajectories import Limits, check_trajectory
from thinshell_ros.replay.guard import GuardSettings
from thinshell_ros.replay.session import CATCH_UP, HOLD_S, checked
from thinshell_ros.replay.tracking import Placed, turn_between


@pytest.mark.parametrize(
    ("good", "bad", "said"),
    [
        ({"turn": 0.0049}, {"turn": 0.0051}, "pose of hand jumped by 0.0051 rad within"),
        ({"away": 0.0019}, {"away": 0.0071}, "pose of hand jumped by 0.0071 m within 0.001 s"),
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


def test_a_robot_that_leaves_its_path_slowly_is_found_at_the_tolerance() -> None:
    bench = Bench().start().run(0.05)
    for away in (0.0005, 0.001, 0.0015, 0.0019, 0.0021):
        assert bench.session.state == "running", bench.session.reason
        bench.at_s += PERIOD_S
        bench.feed(away=away)
        bench.session.tick(bench.now)
    assert (
        "0.0021 m and 0 rad away from its path, where its commands were within the last 0.1 s" in bench.session.reason
    )
    assert "at most 0.002 m and 0.005 rad are allowed" in bench.session.reason


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


def test_a_reading_that_was_late_already_and_then_nothing_is_reported_as_silence() -> None:
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


def test_a_simulation_that_stands_still_makes_all_wait_however_long() -> None:
    """A step of physics that takes a minute of wall time: no reading is too old, nothing moves, no command repeats the
    one before under its stamp, and it goes on."""
    bench = Bench(replace(SETTINGS, simulated_time=True)).start().run(0.1)
    held, at = bench.session.commanded, bench.session.time_s
    bench.still_s = bench.now.ros_s
    for _ in range(6000):
        bench.at_s += PERIOD_S
        assert bench.session.tick(bench.now) is None
    assert bench.session.state == "running"
    assert bench.session.commanded == held
    assert bench.session.time_s == at
    assert bench.session.report().values["waiting_s"] == "60.0"
    bench.still_s, bench.jump_s = None, bench.jump_s - 60.0
    bench.run(2.0)
    assert bench.session.state == "succeeded", bench.session.reason


@pytest.mark.parametrize(("still_s", "leap_s"), [(0.3, 0.34), (0.3, 0.36), (0.0, 0.06)])
def test_simulated_time_may_catch_up_what_it_stood_still_and_not_more(still_s: float, leap_s: float) -> None:
    """Who publishes /clock is held up on a busy machine: then it leaps, and readings come after it."""
    bench = Bench(replace(SETTINGS, simulated_time=True)).start().run(0.1)
    at = bench.now
    for count in range(round(still_s / PERIOD_S)):
        bench.at_s += PERIOD_S
        bench.still_s = at.ros_s + (0.001 if count > 2 else 0.0)
        bench.session.tick(bench.now)
    held = bench.session.commanded
    bench.still_s, bench.at_s = at.ros_s + leap_s, bench.at_s + 0.1 * PERIOD_S
    commanded = bench.session.tick(bench.now)
    within = leap_s < still_s + 0.05
    assert (bench.session.state == "running") == within
    assert commanded is not None
    if within:
        most = CATCH_UP * PERIOD_S * PEAK_M_S
        assert abs(commanded["hand"].position[2] - held["hand"].position[2]) <= most
        bench.still_s, bench.jump_s = None, at.ros_s + leap_s - 1.7e9 - bench.at_s
        assert bench.run(2.0).session.state == "succeeded", bench.session.reason
    else:
        assert "The ROS clock jumped by 0." in bench.session.reason


@pytest.mark.parametrize("factor", [0.05, 0.4])
def test_a_robot_that_stops_is_found_in_slow_simulated_time_too(factor: float) -> None:
    """Readings every 10 ms of simulated time; the command has moved on by the tolerance within the lag."""
    bench = Bench(replace(SETTINGS, simulated_time=True)).start()
    while bench.session.state == "running" and bench.at_s < 20.0:
        bench.at_s += PERIOD_S
        bench.jump_s -= (1.0 - factor) * PERIOD_S
        bench.feed(z=max(bench.session.commanded["hand"].position[2], -0.004))
        bench.session.tick(bench.now)
    path = TRAJECTORY.poses()["hand"]
    fine = np.linspace(0.0, 0.4, 4001)
    passed = float(fine[int(np.argmax(path.sample(fine)[0][:, 2] < -0.004 - NEAR_M))])
    assert bench.session.time_s == pytest.approx(passed + LAG_S, abs=2.0 * PERIOD_S)
    assert "It does not follow".lower() in bench.session.reason or "late" in bench.session.reason


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


def test_a_reading_without_a_stamp_is_reported_and_may_be_allowed() -> None:
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
        bench.session.abort(bench.now, "on request")
        return bench.session.commanded["hand"], commanded

    pose, commanded = held(away=0.0015)
    assert pose.position == (0.0015, 0.0, commanded.position[2])
    for untrusted in ({"away": 0.006}, {"z": math.nan}, {"frame": "world"}, {"length": 2.0}):
        pose, commanded = held(**untrusted)
        assert pose == commanded, untrusted
    pose, commanded = held(0.02, z=0.0015)
    assert pose == commanded, "not where it is outside the workspace"


def test_what_is_held_is_repeated_for_a_while_and_nothing_after() -> None:
    bench = Bench().start().run(0.2)
    bench.session.abort(bench.now, "on request")
    held = bench.session.commanded
    assert not bench.session.abort(bench.now, "again")
    while bench.at_s < 0.2 + HOLD_S - PERIOD_S:
        bench.at_s += PERIOD_S
        assert bench.session.tick(bench.now) == held
    bench.at_s += 2.0 * PERIOD_S
    assert bench.session.tick(bench.now) is None
    assert bench.session.report().level == "error"
    assert bench.session.report().values["detail"] == "on request"


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
            assert math.dist(pose.position, before.position) <= HELD_M
            assert turn_between(pose.quaternion, before.quaternion) <= 0.005
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


# What is expected of sensors.
