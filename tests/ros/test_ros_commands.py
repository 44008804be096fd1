"""Which targets are taken, how the end effector follows, and in which pace. Needs no ROS."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from thinshell_ros.pacing import SLACK_S, Pacer
from thinshell_ros.poses import Pose, PoseGate, towards

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


def test_a_fast_simulation_waits_for_the_wall_clock() -> None:
    pacer = Pacer()
    pacer.restart(100.0, 3.0)
    assert pacer.wait_s(100.004, 3.01) == pytest.approx(0.006)
    assert pacer.wait_s(100.01, 3.02) == pytest.approx(0.01)


def test_a_short_delay_is_caught_up() -> None:
    pacer = Pacer()
    pacer.restart(0.0, 0.0)
    assert pacer.wait_s(0.9 * SLACK_S, 0.01) == 0.0
    assert pacer.wait_s(0.9 * SLACK_S, SLACK_S) == pytest.approx(0.1 * SLACK_S)


def test_a_slow_simulation_slows_time_down_instead_of_catching_up() -> None:
    pacer = Pacer()
    pacer.restart(0.0, 0.0)
    for k in range(1, 101):
        assert pacer.wait_s(0.05 * k, 0.01 * k) == 0.0
    assert pacer.factor() == pytest.approx(0.2, rel=1e-6)
    fast = [pacer.wait_s(5.0, 1.0 + 0.01 * k) for k in range(1, 30)]
    assert fast.count(0.0) <= SLACK_S / 0.01 + 1, "what was lost beyond the slack is not made up for"


def test_the_factor_forgets_what_is_long_ago() -> None:
    pacer = Pacer()
    pacer.restart(0.0, 0.0)
    assert math.isnan(pacer.factor())
    pacer.wait_s(10.0, 0.1)
    for k in range(1, 301):
        pacer.wait_s(10.0 + 0.01 * k, 0.1 + 0.01 * k)
    assert pacer.factor() == pytest.approx(1.0)
