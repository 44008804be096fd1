"""``tf_node``: where the end effectors of a rig are, as transforms on ``/tf``, from their measured poses.

The frames that are fixed to them are those of ``python -m thinshell_ros.frames RIG``, for ``robot_state_publisher``
(``launch/view.launch.py`` starts both). A robot whose own driver publishes the frames of its hands needs no such node.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseStamped, TransformStamped
from rclpy.node import Node

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig
from thinshell_ros.parameters import declare, warn_of_unknown
from thinshell_ros.poses import UNIT_TOLERANCE
from thinshell_ros.qos import READINGS, overridable
from thinshell_ros.runner import run

DEPTH = 100
"""Depth of /tf, as tf2 has it."""

LOG_S = 5.0
"""Shortest time [s] between two lines of the log of the same kind."""


class TfNode(Node):
    """``current_pose`` of each end effector in, ``/tf`` out; the child frame has the name of the end effector."""

    def __init__(self) -> None:
        super().__init__("frames")
        rig = load_rig(declare(self, "rig", "", "rig: a name or a YAML file"))
        warn_of_unknown(self)
        self._message = transform_message()
        self._publisher = self.create_publisher(self._message, "/tf", DEPTH)
        for name, effector in rig.end_effectors.items():
            take = partial(self._on_pose, name)
            self.create_subscription(PoseStamped, effector.topics.current_pose, callback=take, **overridable(READINGS))
        self.get_logger().info(f"Publishing the frames {', '.join(rig.end_effectors)}.")

    def _on_pose(self, name: str, message: PoseStamped) -> None:
        p, q = message.pose.position, message.pose.orientation
        length = sum(value**2 for value in (q.x, q.y, q.z, q.w)) ** 0.5
        if not abs(length - 1.0) <= UNIT_TOLERANCE or not abs(p.x + p.y + p.z) < float("inf"):
            words = f"A pose of {name} is not finite, or no unit quaternion: it is left out."
            self.get_logger().warning(words, throttle_duration_sec=LOG_S)
            return
        moved = TransformStamped(header=message.header, child_frame_id=name)
        moved.transform.translation.x, moved.transform.translation.y, moved.transform.translation.z = p.x, p.y, p.z
        moved.transform.rotation = q
        self._publisher.publish(self._message(transforms=[moved]))


def transform_message() -> Any:
    """The type of messages on ``/tf``.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        from tf2_msgs.msg import TFMessage
    except ImportError:
        raise ConfigError(
            "tf2_msgs is not installed, which the messages on /tf are from.",
            "It comes with a ROS distribution (ros-jazzy-tf2-msgs), and not with the wheels.",
        ) from None
    return TFMessage


def main(args: Sequence[str] | None = None) -> int:
    """Run the node."""
    return run(TfNode, args)


if __name__ == "__main__":
    sys.exit(main())
