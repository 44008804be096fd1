"""Frames of rigs, their URDF, and ``tf_node``."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from sim_core.errors import ConfigError
from sim_core.rigs import MarkerSensor, load_rig, rig_to_yaml
from sim_core.rigs.load import names_in, parse_rig
from sim_core.scene.scene import build_scene
from sim_core.simulate import Simulation
from thinshell_ros import frames

STRIP = Path(__file__).parents[2] / "examples" / "closed_loop" / "strip.yaml"


def places(text: str) -> dict[str, tuple[np.ndarray, Rotation]]:
    """Where each link of a URDF is in the root, its joints at 0."""
    robot = ElementTree.fromstring(text)
    above = {j.find("child").get("link"): j for j in robot.iter("joint")}  # type: ignore[union-attr]
    links = [link.get("name") for link in robot.iter("link")]
    assert len(links) == len(set(links)) == len(above) + 1

    def at(link: str) -> tuple[np.ndarray, Rotation]:
        if link not in above:
            return np.zeros(3), Rotation.identity()
        joint = above[link]
        origin = joint.find("origin")
        xyz, rpy = (np.array(origin.get(key).split(), dtype=float) for key in ("xyz", "rpy"))  # type: ignore[union-attr]
        p, r = at(joint.find("parent").get("link"))  # type: ignore[union-attr, arg-type]
        return p + r.apply(xyz), r * Rotation.from_euler("xyz", rpy)

    return {str(link): at(str(link)) for link in links}


@pytest.mark.parametrize("name", names_in("rigs"))
def test_every_rig_has_one_tree_of_frames(name: str) -> None:
    rig = load_rig(name)
    found = places(frames.urdf(rig))
    carried = {s.frame_id or n for n, s in rig.sensors.items()} | {c.frame_id or n for n, c in rig.cameras.items()}
    assert carried | set(rig.end_effectors) <= set(found)


def test_markers_are_in_their_frame_where_the_simulation_has_them() -> None:
    rig = load_rig(str(STRIP))
    simulation = Simulation(build_scene(rig))
    origin, rotation = places(frames.urdf(rig))["gel"]
    sensor = rig.sensors["markers_gel"]
    assert isinstance(sensor, MarkerSensor)
    there = origin + rotation.apply(simulation.read()["markers_gel"])
    nodes = simulation.state.x[simulation.scene.bodies["gel"].nodes]
    # By less than 1e-7 m the gel is pressed at the start, its corners a little more than the dots within its face.
    assert there[:, 2] == pytest.approx(nodes[:, 2].min(), abs=1e-7), "the dots are on the face that looks down"
    assert there[:, :2].mean(axis=0) == pytest.approx(nodes[:, :2].mean(axis=0), abs=1e-7)
    side = places(frames.urdf(rig))["side"]
    ahead = (nodes.mean(axis=0) - side[0]) @ side[1].as_matrix()
    assert ahead[2] == pytest.approx(0.2, rel=0.1), "the camera looks along z of its optical frame"


def test_a_sensor_frame_is_placed_in_the_frame_of_its_body() -> None:
    data = yaml.safe_load(rig_to_yaml(load_rig(str(STRIP))))
    data["sensors"]["wrench_gel"] |= {"frame_id": "cell", "pose": {"position_m": [0.0, 0.001, 0.0005]}}
    found = places(frames.urdf(parse_rig(data, "made")))
    away = found["cell"][0] - found["gel"][0]
    assert away == pytest.approx([0.0, -0.001, -0.0005], abs=1e-9), "the gel is upside down"


def test_two_frames_with_one_name_at_two_places_are_refused() -> None:
    text = rig_to_yaml(load_rig(str(STRIP))).replace("frame_id: side", "frame_id: gel")
    with pytest.raises(ConfigError, match="two frames 'gel'"):
        frames.urdf(parse_rig(yaml.safe_load(text), "made"))


def test_the_command_prints_the_urdf_or_says_what_is_wrong(capsys: pytest.CaptureFixture[str]) -> None:
    assert frames.main([str(STRIP)]) == 0
    assert capsys.readouterr().out == frames.urdf(load_rig(str(STRIP)))
    assert frames.main([]) == 2
    assert "python -m thinshell_ros.frames RIG" in capsys.readouterr().err


class TfMessage:
    """Stands in for the message of tf2_msgs, which does not come with the wheels."""

    def __init__(self, transforms: list[Any]) -> None:
        self.transforms = transforms


@pytest.mark.ros
def test_measured_poses_become_transforms(ros: None, monkeypatch: pytest.MonkeyPatch) -> None:
    import rclpy
    from geometry_msgs.msg import PoseStamped
    from rclpy.parameter import Parameter

    from thinshell_ros import tf_node

    messages = ModuleType("tf2_msgs.msg")
    messages.TFMessage = TfMessage  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "tf2_msgs", ModuleType("tf2_msgs"))
    monkeypatch.setitem(sys.modules, "tf2_msgs.msg", messages)
    sent: list[TfMessage] = []
    made = tf_node.TfNode.create_publisher

    def publisher(self: Any, kind: Any, topic: str, *rest: Any, **more: Any) -> Any:
        return SimpleNamespace(publish=sent.append) if topic == "/tf" else made(self, kind, topic, *rest, **more)

    monkeypatch.setattr(tf_node.TfNode, "create_publisher", publisher)
    declared = tf_node.TfNode.declare_parameter
    monkeypatch.setattr(
        tf_node.TfNode, "declare_parameter",
        lambda self, name, *rest: Parameter(name, value=str(STRIP)) if name == "rig" else declared(self, name, *rest),
    )  # fmt: skip
    node = tf_node.TfNode()
    try:
        pose = PoseStamped()
        pose.header.frame_id, pose.header.stamp.sec = "base_link", 7
        pose.pose.position.x, pose.pose.orientation.w, pose.pose.orientation.z = 0.25, 0.6, 0.8
        (subscription,) = [s for s in node.subscriptions if s.topic_name == "/current_pose"]
        subscription.callback(pose)
        pose.pose.orientation.z = 0.9
        subscription.callback(pose)
    finally:
        node.destroy_node()
    assert rclpy.ok()
    (transform,) = (t for message in sent for t in message.transforms)
    assert (transform.header.frame_id, transform.child_frame_id, transform.header.stamp.sec) == (
        "base_link",
        "finger",
        7,
    )
    assert transform.transform.translation.x == 0.25
    assert (transform.transform.rotation.w, transform.transform.rotation.z) == (0.6, 0.9)


def test_without_tf2_msgs_the_node_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy")
    from thinshell_ros.tf_node import transform_message

    monkeypatch.setitem(sys.modules, "tf2_msgs", None)
    with pytest.raises(ConfigError, match="ros-jazzy-tf2-msgs"):
        transform_message()
