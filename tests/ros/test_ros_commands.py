"""Which targets are taken, how the end effector follows, and in which pace. Needs no ROS."""

import math
import random

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thinshell_ros.pacing import MOST_LAG_S, SLACK_S, Pacer
from thinshell_ros.poses import Pose, PoseGate, towards, unstamped, velocity_fault

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
HERE = Pose(np.array([0.1, 0.0, 0.2]), np.array(UPRIGHT))
GATE = PoseGate("base_link", max_jump_m=0.02, max_jump_rad=0.3)


def about_x(angle: float) -> np.ndarray:
    return Rotation.from_rotvec([angle, 0.0, 0.0]).as_quat()


def test_a_near_target_is_taken_and_its_quaternion_normalised() -> None:
    taken = GATE.check("base_link", (0.11, 0.0, 0.2), (0.0, 0.0, 0.0, 1.0005), HERE)
    assert isinstance(taken, Pose)
    assert np.linalg.norm(taken.quaternion) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize(
    ("frame", "position", "quaternion", "reason"),
    [
        ("world", (0.1, 0.0, 0.2), UPRIGHT, "frame_id is 'world', expected 'base_link'"),
        ("", (0.1, 0.0, 0.2), UPRIGHT, "frame_id is ''"),
        ("base_link", (math.nan, 0.0, 0.2), UPRIGHT, "not finite"),
        ("base_link", (0.1, 0.0, 0.2), (0.0, 0.0, math.inf, 1.0), "not finite"),
        ("base_link", (0.1, 0.0, 0.2), (0.0, 0.0, 0.0, 1.01), "length 1.01"),
        ("base_link", (0.1, 0.0, 0.2), (0.0, 0.0, 0.0, 0.0), "length 0"),
        ("base_link", (0.1, 0.03, 0.2), UPRIGHT, "0.03 m away"),
        ("base_link", (100.0, 0.0, 200.0), UPRIGHT, "max_jump_m"),
        ("base_link", (0.1, 0.0, 0.2), tuple(about_x(0.4)), "0.4 rad away"),
    ],
)
def test_what_cannot_be_a_command_is_rejected_with_its_reason(
    frame: str, position: tuple[float, ...], quaternion: tuple[float, ...], reason: str
) -> None:
    rejection = GATE.check(frame, position, quaternion, HERE)
    assert isinstance(rejection, str)
    assert reason in rejection


def test_the_same_orientation_with_the_other_sign_is_no_jump() -> None:
    assert isinstance(GATE.check("base_link", (0.1, 0.0, 0.2), (0.0, 0.0, 0.0, -1.0), HERE), Pose)


def test_a_target_in_reach_is_reached_exactly() -> None:
    target = Pose(np.array([0.101, 0.0, 0.2]), about_x(0.01))
    there = towards(HERE, target, 0.002, 0.02)
    assert (there.array() == target.array()).all()


def test_a_target_out_of_reach_is_approached_at_full_speed_on_the_straight_way() -> None:
    target = Pose(np.array([0.1, 0.03, 0.24]), about_x(-0.5))
    there = towards(HERE, target, 0.01, 0.1)
    np.testing.assert_allclose(there.position, [0.1, 0.006, 0.208], atol=1e-15)
    np.testing.assert_allclose(there.quaternion, about_x(-0.1), atol=1e-15)


def test_the_quaternion_stays_in_its_half_space() -> None:
    target = Pose(HERE.position, -about_x(0.01))
    assert towards(HERE, target, 1.0, 1.0).quaternion @ HERE.quaternion > 0.0


def test_commands_may_run_ahead_of_an_end_effector_but_not_jump() -> None:
    """A commander at 0.8 m/s, and an end effector that has got nowhere yet."""
    last = None
    for k in range(1, 101):
        last = GATE.check("base_link", (0.1 + 0.008 * k, 0.0, 0.2), UPRIGHT, HERE, last)
        assert isinstance(last, Pose), last
    assert isinstance(last, Pose)
    rejection = GATE.check("base_link", (0.93, 0.0, 0.2), UPRIGHT, HERE, last)
    assert rejection == "0.03 m away from the last target, at most 0.02 m (max_jump_m)"
    assert isinstance(GATE.check("base_link", (0.11, 0.0, 0.2), UPRIGHT, HERE, last), Pose), "back to where it is"


@pytest.mark.parametrize(
    ("frame", "linear", "angular", "reason"),
    [
        ("base_link", (0.0, 0.3, 0.4), (1.0, 2.0, 2.0), ""),
        ("world", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "frame_id is 'world', expected 'base_link'"),
        ("base_link", (0.0, math.nan, 0.0), (0.0, 0.0, 0.0), "not finite"),
        ("base_link", (0.0, 0.3, 0.41), (0.0, 0.0, 0.0), "at most 0.5 m/s"),
        ("base_link", (0.0, 0.0, 0.0), (1.1, 2.0, 2.0), "at most 3 rad/s"),
    ],
)
def test_what_cannot_be_a_velocity_is_rejected_with_its_reason(
    frame: str, linear: tuple[float, ...], angular: tuple[float, ...], reason: str
) -> None:
    fault = velocity_fault((frame, "base_link"), linear, angular, (0.5, 3.0))
    assert reason in fault and bool(fault) == bool(reason)


def test_a_stamp_of_1970_is_none() -> None:
    assert unstamped(1.7e9) == ""
    assert "0 s after the beginning of 1970" in unstamped(0.0)
    assert "use_sim_time" in unstamped(17.3e6)


class Run:
    """A pacer, and simulated time in steps of 10 ms."""

    def __init__(self, factor: float = 1.0, catches_up: bool = True) -> None:
        self.pacer = Pacer(factor, catches_up)
        self.wall = self.simulated = 0.0
        self.pacer.start(0.0, 0.0)

    def step(self, cost: float) -> float:
        """One step; returns for how long it waited."""
        wait = self.pacer.wait_s(self.wall, self.simulated, 0.01)
        self.wall += wait + cost
        self.simulated += 0.01
        return wait

    @property
    def behind(self) -> float:
        """Stamps against the wall clock."""
        return self.wall - self.simulated - self.pacer.skipped_s


def test_a_step_is_made_when_its_end_is_due() -> None:
    run = Run()
    assert run.step(0.004) == pytest.approx(0.01)
    assert run.step(0.004) == pytest.approx(0.006)
    assert run.step(0.0) == pytest.approx(0.006)


@pytest.mark.parametrize("factor", [0.2, 1.0, 5.0])
def test_the_pace_is_as_wanted(factor: float) -> None:
    run = Run(factor)
    for _ in range(500):
        run.step(0.001)
    assert run.pacer.factor() == pytest.approx(factor, rel=0.02)
    assert Run(0.0).step(0.0) == 0.0


def test_a_short_delay_is_caught_up() -> None:
    run = Run()
    run.step(0.9 * SLACK_S)
    while run.step(0.0) == 0.0:
        assert run.simulated < 0.2
    assert run.pacer.skipped_s == 0.0


def test_a_slow_spell_leaves_no_lasting_lag() -> None:
    run = Run()
    for _ in range(40):
        run.step(0.05)
    assert run.pacer.lag_s == pytest.approx(1.6, abs=0.1), "what it has cost is known while it lasts"
    assert run.pacer.factor() == pytest.approx(0.2, rel=0.01)
    assert run.pacer.skipped_s == 0.0, "a simulation that is slow for a while does not jump"
    for _ in range(100):
        run.step(0.005)
    assert run.behind < 0.02
    assert run.pacer.skipped_s == pytest.approx(1.6, abs=0.6)
    assert run.pacer.lag_s < 0.01
    skipped = run.pacer.skipped_s
    for _ in range(1000):
        run.step(0.005)
    assert run.pacer.skipped_s == skipped


def test_a_simulation_that_is_always_too_slow_is_behind_by_a_bound() -> None:
    run = Run()
    for _ in range(1000):
        run.step(0.05)
        assert run.behind < MOST_LAG_S + 0.11, "and two steps"
    assert run.pacer.skipped_s == pytest.approx(40.0, abs=MOST_LAG_S + 0.1)
    assert run.pacer.factor() == pytest.approx(0.2, rel=0.01)


@pytest.mark.parametrize("factor", [0.2, 1.0])
def test_simulated_time_that_nothing_is_caught_up_of_never_runs_faster_than_wanted(factor: float) -> None:
    """From any step to any later one, whatever steps cost, but for two steps."""
    run, rng, ahead = Run(factor, catches_up=False), random.Random(2), []
    for _ in range(1000):
        run.step(rng.choice([0.0, 0.001, 0.05 / factor, 0.3]))
        ahead.append(run.simulated - factor * run.wall)
    least = np.minimum.accumulate(ahead)
    assert (np.array(ahead) - least).max() < 0.0201
    plain = Run(factor)
    for cost in (1.0, *[0.0] * 50):
        plain.step(cost)
    assert plain.simulated > 0.5, "what is caught up of, does"


def test_one_step_of_ten_seconds_leaves_no_lasting_lag() -> None:
    run = Run()
    run.step(10.0)
    for _ in range(200):
        run.step(0.005)
    assert run.behind < 0.02


def test_a_pause_and_a_reset_bring_stamps_back_to_the_wall_clock() -> None:
    run = Run()
    for _ in range(20):
        run.step(0.05)
    run.wall += 30.0
    run.pacer.start(run.wall, run.simulated)
    run.step(0.001)
    assert run.behind == pytest.approx(0.001, abs=0.05)
    for _ in range(20):
        run.step(0.05)
    run.pacer.start(run.wall, run.simulated)
    run.step(0.001)
    assert run.behind == pytest.approx(0.001, abs=0.05)


def test_the_factor_forgets_what_is_long_ago() -> None:
    run = Run()
    assert math.isnan(run.pacer.factor())
    run.step(8.0)
    for _ in range(400):
        run.step(0.005)
    assert run.pacer.factor() == pytest.approx(1.0, rel=0.01)
