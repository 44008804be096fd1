"""``tf_node`` as a process of its own, with the messages of tf2: hands on /tf and the URDF make one tree."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest
from ros_live import RIG, Client, NodeProcess

from sim_core.rigs import load_rig

pytestmark = pytest.mark.ros


def test_hands_on_tf_and_the_urdf_make_one_tree(ros: None, tmp_path: Path) -> None:
    tf2_msgs = pytest.importorskip("tf2_msgs.msg", reason="tf2_msgs comes with a ROS distribution")
    from geometry_msgs.msg import PoseStamped

    from thinshell_ros.frames import urdf

    node, client = NodeProcess("tf_node", tmp_path / "output", rig=RIG), Client("robot")
    try:
        heard = client.listen(tf2_msgs.TFMessage, "/tf")
        robot = client.node.create_publisher(PoseStamped, "current_pose", 1)
        pose = PoseStamped()
        pose.header.frame_id, pose.pose.position.z, pose.pose.orientation.w = "base_link", 0.0123, 1.0

        def published() -> bool:
            robot.publish(pose)
            return bool(heard)

        client.wait(published, f"nothing on /tf: {node.output}")
        (moved,) = heard[-1].transforms
        assert (moved.header.frame_id, moved.child_frame_id) == ("base_link", "probe")
        assert moved.transform.translation.z == 0.0123
        joints = {
            str(joint.find("child").get("link")): joint  # type: ignore[union-attr]
            for joint in ElementTree.fromstring(urdf(load_rig(RIG))).iter("joint")
        }
        assert joints["probe"].get("type") == "floating", "robot_state_publisher leaves it to tf_node"
        assert {"tactile_left_gel", "side_optical_frame"} <= joints.keys()
        assert all(joint.get("type") == "fixed" for name, joint in joints.items() if name != "probe")
        assert node.stop() == 0, node.output
    finally:
        client.node.destroy_node()
        node.kill()
