"""Trajectories to and from MultiDOFJointTrajectory, against the curve that they stand for. Needs no graph."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs.trajectory import minimum_jerk
from sim_core.rigs.yamlfile import validate
from sim_core.trajectories import Trajectory

pytestmark = pytest.mark.ros
pytest.importorskip("trajectory_msgs", reason="ROS message packages are not installed: pip install '.[ros]'")

TIME_S = 1.5
TURN = np.array([0.3, -0.2, 0.5])


def two_hands(**frames: str) -> Trajectory:
    """Two end effectors: one moves and turns, one moves the other way."""
    times = np.arange(151) / 100.0
    share = minimum_jerk(times / TIME_S)
    turns = (Rotation.from_rotvec(np.outer(share, TURN)) * Rotation.from_euler("x", 1.0)).as_quat()
    hands = {
        name: {
            "frame_id": frames.get(name, "base_link"),
            "positions_m": np.outer(share, way),
            "quaternions_xyzw": turns,
            "target_topic": f"{name}/target_pose",
            "current_topic": f"{name}/current_pose",
        }
        for name, way in (("left", [0.0, 0.1, 0.0]), ("tool_B", [0.0, -0.1, 0.05]))
    }
    return validate(Trajectory, {"times_s": times, "end_effectors": hands}, "made")


def test_a_message_carries_the_poses_there_and_back() -> None:
    from thinshell_ros.replay.messages import from_message, to_message

    given = two_hands()
    message = to_message(given)
    assert message.joint_names == ["left", "tool_B"]
    assert message.header.frame_id == "base_link"
    found = from_message(message)
    np.testing.assert_allclose(found.times_s, given.times_s, atol=1e-9)
    for name, path in given.end_effectors.items():
        other = found.end_effectors[name]
        np.testing.assert_allclose(other.positions_m, path.positions_m, atol=1e-15)
        turn = Rotation.from_quat(other.quaternions_xyzw).inv() * Rotation.from_quat(path.quaternions_xyzw)
        assert turn.magnitude().max() < 1e-12
        assert (other.target_topic, other.current_topic) == (path.target_topic, path.current_topic)
    assert found.rig is None


def test_velocities_are_those_of_the_motion() -> None:
    """Minimum jerk in its middle: 15/8 of the mean velocity; turns about a fixed axis of the base frame."""
    from thinshell_ros.replay.messages import to_message

    message = to_message(two_hands())
    middle, first = message.points[75], message.points[0]
    assert middle.time_from_start.nanosec == 750_000_000
    peak = 1.875 / TIME_S
    for column, way in enumerate(([0.0, 0.1, 0.0], [0.0, -0.1, 0.05])):
        twist = middle.velocities[column]
        linear = [twist.linear.x, twist.linear.y, twist.linear.z]
        angular = [twist.angular.x, twist.angular.y, twist.angular.z]
        np.testing.assert_allclose(linear, peak * np.array(way), rtol=1e-3, atol=1e-9)
        np.testing.assert_allclose(angular, peak * TURN, rtol=1e-3)
        assert abs(first.velocities[column].linear.y) < 1e-3


def broken(change: Any) -> Any:
    from thinshell_ros.replay.messages import to_message

    message = to_message(two_hands())
    change(message)
    return message


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda m: m.points.clear(), "times_s"),
        (lambda m: m.points[3].transforms.pop(), "Point 3 of the message has 1 transforms for 2 joints"),
        (lambda m: setattr(m, "joint_names", ["left", "left"]), "names a joint twice"),
        (lambda m: setattr(m, "joint_names", []), "Point 0 of the message has 2 transforms for 0 joints"),
        (lambda m: setattr(m.points[0].time_from_start, "sec", 1), "does not begin with 0"),
        (lambda m: setattr(m.points[2].transforms[0].rotation, "w", 3.0), "an orientation has length 1"),
        (lambda m: setattr(m.points[2].transforms[0].translation, "x", float("nan")), "not finite in row 2"),
        (lambda m: setattr(m.header, "frame_id", ""), "frame_id"),
    ],
)
def test_a_message_that_is_no_trajectory_is_refused(change: Any, said: str) -> None:
    from thinshell_ros.replay.messages import from_message

    with pytest.raises(ConfigError, match=said):
        from_message(broken(change))


def test_two_base_frames_do_not_fit_into_one_message() -> None:
    from thinshell_ros.replay.messages import to_message

    with pytest.raises(ConfigError, match="base frames base_link, world"):
        to_message(two_hands(left="world"))
