"""Joint states and a URDF become poses of the hand: against closed forms, and what is wrong said in sentences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from recording_messages import START, Item, header, log_time, make, notes, read, store, wrenches
from rosbags.rosbag2 import Reader
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from sim_core.errors import RecordingError
from sim_core.rigs import load_rig, rig_to_yaml
from sysid.cli.app import app
from sysid.model.load import load_run
from sysid.recording import EETopics, TopicNames
from sysid.recording.joints import JointTopics
from sysid.recording.message_types import TYPESTORE
from sysid.recording.urdf import chain_of

STATE, TEXT = "sensor_msgs/msg/JointState", "std_msgs/msg/String"
COUNT = 30
UPPER, FORE = 0.3, 0.2


def joint(
    name: str, kind: str, parent: str, child: str, xyz: str, axis: str, more: str = "", rpy: str = "0 0 0"
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{more}</joint>'
    )


def robot(*joints: str, links: str = "base_link upper fore tool0") -> str:
    return f'<robot name="arm">{"".join(f"<link name={name!r}/>" for name in links.split())}{"".join(joints)}</robot>'


LIMITS = '<limit lower="-3" upper="3" effort="1" velocity="1"/>'
SHOULDER = joint("shoulder", "revolute", "base_link", "upper", "0 0 0.1", "0 0 2", LIMITS)
ELBOW = joint("elbow", "continuous", "upper", "fore", f"{UPPER} 0 0", "0 0 1")
FLANGE = joint("flange", "fixed", "fore", "tool0", f"{FORE} 0 0", "1 0 0")
ARM = robot(SHOULDER, ELBOW, FLANGE)
ANGLES = {"shoulder": 0.2 + 0.01 * np.arange(COUNT), "elbow": 0.5 - 0.02 * np.arange(COUNT)}


def arm_positions(shoulder: np.ndarray, elbow: np.ndarray) -> np.ndarray:
    both = shoulder + elbow
    return np.column_stack(
        [
            UPPER * np.cos(shoulder) + FORE * np.cos(both),
            UPPER * np.sin(shoulder) + FORE * np.sin(both),
            np.full(len(both), 0.1),
        ]
    )


def state(stamp_ns: int, positions: dict[str, float]) -> Any:
    values, none = np.array(list(positions.values()), dtype=float), np.zeros(0)
    return make(STATE, header=header(stamp_ns, ""), name=list(positions), position=values, velocity=none, effort=none)


def states(**angles: np.ndarray) -> list[Item]:
    return [
        ("/joint_states", STATE, log_time(k), state(log_time(k), {n: float(q[k]) for n, q in angles.items()}))
        for k in range(len(next(iter(angles.values()))))
    ]


def described(text: str = ARM, topic: str = "/robot_description") -> list[Item]:
    return [(topic, TEXT, START, make(TEXT, data=text))]


def named(**changes: Any) -> TopicNames:
    joints = JointTopics(**{"topic": "joint_states", "base": "base_link", "tip": "tool0", **changes})
    return TopicNames(ee={"hand": EETopics(joints=joints)})


def test_the_pose_of_a_two_link_arm_is_the_closed_form(tmp_path: Path) -> None:
    recording = read(tmp_path, described() + states(**ANGLES) + wrenches(COUNT), named())
    stream = recording.poses["hand"]
    np.testing.assert_allclose(stream.position, arm_positions(**ANGLES), atol=1e-12)
    turned = Rotation.from_quat(stream.quaternion).as_rotvec()
    np.testing.assert_allclose(turned[:, 2], ANGLES["shoulder"] + ANGLES["elbow"], atol=1e-12)
    np.testing.assert_allclose(stream.t, 0.01 * np.arange(COUNT), atol=1e-9)
    assert stream.frame_id == "base_link"
    assert "poses of 'tool0' in 'base_link' from shoulder, elbow" in notes(recording)
    assert "not used" not in notes(recording)


def test_joints_of_separate_messages_are_taken_at_one_instant(tmp_path: Path) -> None:
    items = states(shoulder=ANGLES["shoulder"])
    items += [
        ("/joint_states", STATE, log_time(k) + 4_000_000, state(log_time(k) + 4_000_000, {"elbow": q}))
        for k, q in list(enumerate(ANGLES["elbow"].tolist()))[::2]
    ]
    stream = read(tmp_path, described() + items + wrenches(COUNT), named()).poses["hand"]
    k = stream.t / 0.01
    elbow = ANGLES["elbow"][0] - 0.02 * (k - 0.4)
    np.testing.assert_allclose(stream.position, arm_positions(ANGLES["shoulder"][0] + 0.01 * k, elbow), atol=1e-9)
    assert len(stream.t) == 28, "before the first and after the last position of the elbow there is no pose"


def test_a_joint_that_pauses_leaves_a_gap(tmp_path: Path) -> None:
    items = states(shoulder=ANGLES["shoulder"])
    items += [i for k, i in enumerate(states(elbow=ANGLES["elbow"])) if not 10 <= k < 20]
    recording = read(tmp_path, described() + items + wrenches(COUNT), named(max_gap_s=0.05))
    assert np.diff(recording.poses["hand"].t).max() == pytest.approx(0.11)
    assert "10 poses left out: a joint of the chain has no position within 0.05 s (max_gap_s)" in notes(recording)


def test_a_continuous_joint_may_be_written_between_half_turns(tmp_path: Path) -> None:
    elbow = 3.0 + 0.02 * np.arange(COUNT)
    wrapped = (elbow + np.pi) % (2 * np.pi) - np.pi
    items = states(shoulder=ANGLES["shoulder"])
    items += [(t, kind, at + 5_000_000, state(at + 5_000_000, {"elbow": q}))
              for (t, kind, at, _), q in zip(states(elbow=elbow), wrapped.tolist(), strict=True)]  # fmt: skip
    stream = read(tmp_path, described() + items + wrenches(COUNT), named()).poses["hand"]
    k = stream.t / 0.01
    np.testing.assert_allclose(
        stream.position, arm_positions(ANGLES["shoulder"][0] + 0.01 * k, 3.0 + 0.02 * (k - 0.5)), atol=1e-9
    )


def test_a_mimic_joint_follows_its_leader() -> None:
    second = joint("elbow", "revolute", "upper", "fore", f"{UPPER} 0 0", "0 0 1",
                   '<mimic joint="shoulder" multiplier="-2" offset="0.1"/>')  # fmt: skip
    chain = chain_of(robot(SHOULDER, second, FLANGE), "base_link", "tool0", "arm.urdf")
    assert chain.leaders == ("shoulder",)
    place, _ = chain.poses({"shoulder": ANGLES["shoulder"]})
    np.testing.assert_allclose(place, arm_positions(ANGLES["shoulder"], 0.1 - 2.0 * ANGLES["shoulder"]), atol=1e-12)


def test_a_chain_may_go_up_and_down_and_slide_along_turned_axes() -> None:
    up = joint("lift", "prismatic", "base_link", "upper", "0 0 0", "0 0 1")
    out = joint("out", "prismatic", "base_link", "fore", "1 0 0", "1 0 0", rpy=f"0 0 {np.pi / 2}")
    chain = chain_of(robot(up, out, links="base_link upper fore"), "upper", "fore", "arm.urdf")
    place, turn = chain.poses({"lift": np.array([0.2]), "out": np.array([0.3])})
    np.testing.assert_allclose(place, [[1.0, 0.3, -0.2]], atol=1e-15)
    np.testing.assert_allclose(turn.as_rotvec(), [[0.0, 0.0, np.pi / 2]], atol=1e-15)


@pytest.mark.parametrize(
    ("text", "changes", "angles", "words"),
    [
        (ARM, {"tip": "tool1"}, ANGLES, "has no link 'tool1', which `topics.joints.tip` of the rig names.*tool0"),
        (ARM, {"base": "tool0"}, ANGLES, "as base and as tip"),
        (ARM, {}, {"shoulder": ANGLES["shoulder"], "elbo": ANGLES["elbow"]}, "no position of the joint 'elbow'.*elbo"),
        (ARM, {}, {n: np.degrees(q) for n, q in ANGLES.items()}, "'shoulder' reach from .* in deg they would fit"),
        (ARM.replace("continuous", "floating"), {}, ANGLES, "'elbow' .* is of type 'floating'"),
        (ARM.replace("0 0 2", "0 0 0"), {}, ANGLES, "'shoulder' has an axis of length 0"),
        (ARM.replace("0 0 0.1", "0 0 up"), {}, ANGLES, "'shoulder' has xyz='0 0 up'"),
        (ARM[:-5], {}, ANGLES, "is no XML"),
        ("<launch/>", {}, ANGLES, "its root is <launch>"),
        ("<robot><xacro:include/></robot>", {}, ANGLES, "is a xacro file"),
        (robot(FLANGE), {"base": "fore"}, ANGLES, "are fixed: the pose never changes"),
        (robot(SHOULDER, FLANGE), {}, ANGLES, "no chain from the link 'base_link' to the link 'tool0'"),
        (ARM.replace("</joint><joint name=\"flange\"", '<mimic joint="elbows"/></joint><joint name="flange"'), {},
         ANGLES, "mimics 'elbows', which is no joint that moves by itself"),
        (ARM, {"urdf": "nowhere.urdf"}, ANGLES, "nowhere.urdf cannot be read: No such file"),
        (ARM, {"description": "arm/description"}, ANGLES, "has no URDF: no message of arm/description"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_with_what_to_do(
    tmp_path: Path, text: str, changes: dict[str, Any], angles: dict[str, np.ndarray], words: str
) -> None:
    with pytest.raises(RecordingError, match=words) as caught:
        read(tmp_path, described(text) + states(**angles) + wrenches(COUNT), named(**changes))
    assert caught.value.remedy


def test_degrees_that_are_declared_are_angles(tmp_path: Path) -> None:
    degrees = {name: np.degrees(q) for name, q in ANGLES.items()}
    recording = read(tmp_path, described() + states(**degrees) + wrenches(COUNT), named(angle_unit="deg"))
    np.testing.assert_allclose(recording.poses["hand"].position, arm_positions(**ANGLES), atol=1e-12)


def test_two_urdfs_in_a_recording_are_refused(tmp_path: Path) -> None:
    items = described() + described(ARM.replace("0.1", "0.2"), "/twin/robot_description")
    with pytest.raises(RecordingError, match="2 different URDFs on /robot_description, /twin/robot_description"):
        read(tmp_path, items + states(**ANGLES) + wrenches(COUNT), named())


def test_messages_without_positions_are_dropped(tmp_path: Path) -> None:
    items = states(**ANGLES)
    items[3][3].position = np.zeros(1)
    items[5][3].position = np.array([np.nan, 0.0])
    recording = read(tmp_path, described() + items + wrenches(COUNT), named())
    assert "has 1 positions of 2 joints" in notes(recording)
    assert "1 position of 'shoulder' that are not finite left out" in notes(recording)
    kept = np.arange(COUNT) != 3  # the shoulder of the sixth is between its neighbours
    expected = arm_positions(ANGLES["shoulder"][kept], np.where(np.arange(COUNT) == 5, 0.0, ANGLES["elbow"])[kept])
    np.testing.assert_allclose(recording.poses["hand"].position, expected, atol=1e-9)


def test_without_a_rig_the_error_says_how_joints_are_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"topics\.joints") as caught:
        read(tmp_path, described() + states(**ANGLES) + wrenches(COUNT))
    assert "joint_states" in str(caught.value)


GANTRY = robot(
    joint("x", "prismatic", "base_link", "a", "0 0 0", "1 0 0"),
    joint("y", "prismatic", "a", "b", "0 0 0", "0 1 0"),
    joint("z", "prismatic", "b", "c", "0 0 0.05", "0 0 1"),
    joint("yaw", "revolute", "c", "d", "0 0 0", "0 0 1"),
    joint("pitch", "revolute", "d", "e", "0 0 0", "0 1 0"),
    joint("roll", "revolute", "e", "hand", "0 0 0", "1 0 0"),
    links="base_link a b c d e hand",
)


def as_joint_states(bag: Path, out: Path) -> Path:
    """The recording with the measured poses as joint states of a gantry with a wrist, whose inverse is closed."""
    items: list[Item] = described(GANTRY)
    with Reader(bag) as reader:
        for connection, log_ns, raw in reader.messages():
            topic = connection.topic
            if topic.endswith("target_pose"):
                continue
            if not topic.endswith("current_pose"):
                items.append((topic, connection.msgtype, log_ns, bytes(raw)))
                continue
            message = TYPESTORE.deserialize_cdr(raw, connection.msgtype)
            p, q = message.pose.position, message.pose.orientation
            yaw, pitch, roll = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_euler("ZYX")
            joints = {"x": p.x, "y": p.y, "z": p.z - 0.05, "yaw": yaw, "pitch": pitch, "roll": roll}
            stamp = message.header.stamp
            items.append(("/joint_states", STATE, log_ns, state(stamp.sec * 10**9 + stamp.nanosec, joints)))
    return store(out, items)


def test_a_recording_of_joint_states_is_inspected_and_fitted_as_one_of_poses(tmp_path: Path) -> None:
    bag = Path(__file__).parents[2] / "bags" / "press_post"
    rig = yaml.safe_load(rig_to_yaml(load_rig("card_press")))
    (hand,) = rig["end_effectors"]
    rig["end_effectors"][hand]["topics"]["joints"] = {"tip": "hand"}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    joints = as_joint_states(bag, tmp_path / "joints")

    poses = load_run(load_rig("card_press"), bag).poses[hand]
    found = load_run(load_rig(str(tmp_path / "rig.yaml")), joints).poses[hand]
    np.testing.assert_allclose(found.positions, poses.positions, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.sum(found.quaternions * poses.quaternions, axis=1)), 1.0, atol=1e-12)

    shown = CliRunner().invoke(app, ["inspect", str(joints), "--rig", str(tmp_path / "rig.yaml")])
    assert shown.exit_code == 0, shown.output
    assert "/joint_states (base_link to hand)" in shown.output
    assert "missing: " not in shown.output.replace("missing: target_pose", "")
