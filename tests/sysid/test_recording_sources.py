"""Other sources of poses and wrenches: message types, transforms, ROS 1 bags, CSV tables."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recording_messages import (
    MS,
    POSE,
    START,
    Item,
    cloud,
    header,
    log_time,
    make,
    notes,
    pose,
    poses,
    read,
    store,
    wrench,
    wrenches,
)
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from sim_core.errors import RecordingError
from sim_core.rigs import load_rig, parse_rig
from sysid.model.load import load_run
from sysid.recording import EETopics, TopicNames, read_recording

GEOMETRY = "geometry_msgs/msg/"
FAULT = (
    Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "faults" / "tf_elsewhere"
)
TF = "tf2_msgs/msg/TFMessage"


def transform(stamp_ns: int, parent: str, child: str, p: Any, q: Any = (0.0, 0.0, 0.0, 1.0)) -> Any:
    vector = make(f"{GEOMETRY}Vector3", **dict(zip("xyz", map(float, p), strict=True)))
    turn = make(f"{GEOMETRY}Quaternion", **dict(zip("xyzw", map(float, q), strict=True)))
    body = make(f"{GEOMETRY}Transform", translation=vector, rotation=turn)
    return make(f"{GEOMETRY}TransformStamped", header=header(stamp_ns, parent), child_frame_id=child, transform=body)


def as_type(msgtype: str, k: int) -> Any:
    stamp = log_time(k)
    p = (1e-4 * k, 0.0, 0.1)
    stamped = pose(stamp, p)
    if msgtype.endswith("TransformStamped"):
        return transform(stamp, "base_link", "tool0", p)
    if msgtype.endswith("PoseWithCovarianceStamped"):
        body = make(f"{GEOMETRY}PoseWithCovariance", pose=stamped.pose, covariance=np.zeros(36))
        return make(f"{GEOMETRY}PoseWithCovarianceStamped", header=stamped.header, pose=body)
    return stamped.pose


@pytest.mark.parametrize("name", ["TransformStamped", "PoseWithCovarianceStamped", "Pose"])
def test_poses_of_other_types(tmp_path: Path, name: str) -> None:
    kind = GEOMETRY + name
    items = [("/current_pose", kind, log_time(k), as_type(kind, k)) for k in range(20)]
    stream = read(tmp_path, items + wrenches()).poses["ee"]
    np.testing.assert_allclose(stream.position, [[1e-4 * k, 0.0, 0.1] for k in range(20)], atol=1e-12)
    np.testing.assert_allclose(stream.t, 0.01 * np.arange(20), atol=1e-9)
    assert stream.frame_id == ("" if name == "Pose" else "base_link")


def test_a_wrench_without_a_stamp_has_the_time_of_recording(tmp_path: Path) -> None:
    items = [
        ("/wrench", f"{GEOMETRY}Wrench", log_time(k) + 2 * MS, wrench(0, (0.0, 0.0, 0.1 * k)).wrench) for k in range(20)
    ]
    recording = read(tmp_path, poses() + items)
    stream = recording.wrenches["sensor"]
    np.testing.assert_allclose(stream.t, 0.002 + 0.01 * np.arange(20), atol=1e-9)
    np.testing.assert_allclose(stream.force[:, 2], 0.1 * np.arange(20))
    assert "log time is used" in notes(recording)


def arm(count: int = 30) -> list[Item]:
    """A base that stands turned in the world, a link that turns, a tool on it, each published by itself."""
    items: list[Item] = []
    quarter = Rotation.from_euler("z", 90.0, degrees=True).as_quat()
    static = make(
        TF,
        transforms=[
            transform(START, "world", "base", (1.0, 0.0, 0.0), quarter),
            transform(START, "link", "tool", (0.2, 0.0, 0.0)),
        ],
    )
    items.append(("/tf_static", TF, START, static))
    for k in range(count):
        turn = Rotation.from_euler("z", 0.01 * k).as_quat()
        items.append(
            ("/tf", TF, log_time(k), make(TF, transforms=[transform(log_time(k), "base", "link", (0, 0, 0.3), turn)]))
        )
    return items


def test_a_frame_pair_of_transforms_along_a_chain(tmp_path: Path) -> None:
    names = TopicNames(ee={"ee": EETopics(tf=("base", "tool"))})
    recording = read(tmp_path, arm() + wrenches(30), names)
    stream = recording.poses["ee"]
    angle = 0.01 * np.arange(30)
    expected = np.column_stack([0.2 * np.cos(angle), 0.2 * np.sin(angle), np.full(30, 0.3)])
    np.testing.assert_allclose(stream.position, expected, atol=1e-9)
    assert stream.frame_id == "base" and len(stream.t) == 30
    assert "not used: /tf" not in notes(recording)


def test_a_frame_pair_against_the_tree(tmp_path: Path) -> None:
    """The base seen from the tool: the inverse of the above."""
    recording = read(tmp_path, arm() + wrenches(30), TopicNames(ee={"ee": EETopics(tf=("tool", "world"))}))
    stream = recording.poses["ee"]
    turns = Rotation.from_quat(stream.quaternion)
    tool_in_world = (turns.inv()).apply(-stream.position)
    angle = 0.01 * np.arange(30)
    expected = np.column_stack([1.0 - 0.2 * np.sin(angle), 0.2 * np.cos(angle), np.full(30, 0.3)])
    np.testing.assert_allclose(tool_in_world, expected, atol=1e-9)


def test_frames_without_a_chain_are_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"from 'base' to 'tol': 'tol' is in none.* Did you mean 'tool'"):
        read(tmp_path, arm() + wrenches(30), TopicNames(ee={"ee": EETopics(tf=("base", "tol"))}))


def also(k: int, *transforms: Any) -> Item:
    return ("/tf", TF, log_time(k), make(TF, transforms=list(transforms)))


def test_only_what_the_chain_needs_is_judged(tmp_path: Path) -> None:
    """A frame with two parents, and transforms that are none, elsewhere in the tree."""
    odd = [transform(START, frame, "camera", (0, 0, 1.0)) for frame in ("base", "odom", "link")]
    bad = transform(START, "base", "table", (0, 0, 1.0), (0.0, 0.0, 0.0, 0.0))
    names = TopicNames(ee={"ee": EETopics(tf=("base", "tool"))})
    recording = read(tmp_path, [*arm(), also(1, *odd), also(2, bad), *wrenches(30)], names)
    assert len(recording.poses["ee"]) == 30
    assert "/tf" not in notes(recording)


def test_a_second_parent_on_the_chain_that_leads_nowhere_is_said(tmp_path: Path) -> None:
    names = TopicNames(ee={"ee": EETopics(tf=("base", "tool"))})
    recording = read(tmp_path, [*arm(), also(1, transform(START, "mocap", "tool", (9, 9, 9))), *wrenches(30)], names)
    np.testing.assert_allclose(recording.poses["ee"].position[0], [0.2, 0.0, 0.3], atol=1e-9)
    assert "'tool' has the parent 'mocap' and also 'link': the chain base - link - tool is used" in notes(recording)


def test_two_chains_are_refused_by_their_names(tmp_path: Path) -> None:
    names = TopicNames(ee={"ee": EETopics(tf=("base", "tool"))})
    items = [
        *arm(),
        also(1, transform(START, "mocap", "tool", (9, 9, 9)), transform(START, "base", "mocap", (0, 0, 0))),
    ]
    with pytest.raises(
        RecordingError, match=r"two chains .* base - (link|mocap) - tool and base - (link|mocap) - tool"
    ):
        read(tmp_path, items + wrenches(30), names)


@pytest.mark.skipif(not FAULT.is_dir(), reason="the shared inputs are not here")
def test_two_parents_elsewhere_do_not_stop_a_recording() -> None:
    run = load_run(load_rig(str(FAULT / "rig.yaml")), FAULT / "tf_two_parents_elsewhere")
    assert all(len(pose.times) > 100 for pose in run.poses.values())


def test_a_rig_names_the_frame_pair(tmp_path: Path) -> None:
    rig = parse_rig(
        {
            "name": "held",
            "bodies": {
                "card": {
                    "type": "sheet",
                    "shape": {"type": "rectangle", "length_m": 0.08, "width_m": 0.03, "cells": [4, 1]},
                    "material": {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 3.0e-4, "density_kg_m3": 400.0},
                }
            },
            "clamps": [{"name": "grip", "body": "card", "region": {"x_m": [-0.04, -0.02]}, "mount": "hand"}],
            "end_effectors": {"hand": {"base_frame": "base", "start": {"position_m": [0.2, 0.0, 0.3]},
                                       "topics": {"tf": ["base", "tool"]}}},
            "sensors": {"wrench": {"type": "wrench", "on": "hand"}},
        },
        "rig",
    )  # fmt: skip
    run = load_run(rig, store(tmp_path / "bag", arm() + wrenches(30)))
    np.testing.assert_allclose(run.poses["hand"].positions[0], [0.2, 0.0, 0.3], atol=1e-9)


def ros1(path: Path) -> Path:
    """A ROS 1 bag with a pose, a cloud and a camera_info."""
    old = get_typestore(Stores.ROS1_NOETIC)
    stamp = old.types["builtin_interfaces/msg/Time"](sec=1, nanosec=0)

    def head(k: int, frame: str) -> Any:
        stamp = old.types["builtin_interfaces/msg/Time"](sec=1, nanosec=10_000_000 * k)
        return old.types["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id=frame)

    del stamp
    with Writer1(path) as bag:
        made = {
            topic: bag.add_connection(topic, kind, typestore=old)
            for topic, kind in (
                ("/current_pose", POSE),
                ("/marker_tracks", "sensor_msgs/msg/PointCloud2"),
                ("/camera_info", "sensor_msgs/msg/CameraInfo"),
                ("/chatter", "std_msgs/msg/String"),
            )
        }
        for k in range(20):
            new = pose(0, (1e-4 * k, 0.0, 0.1))
            message = old.types[POSE](header=head(k, "base_link"), pose=new.pose)
            bag.write(made["/current_pose"], log_time(k), old.serialize_ros1(message, POSE))
            points = cloud(0, {"u": [1.0 + k, 9.0], "v": [2.0, 3.0], "id": [4, 5]})
            kind = "sensor_msgs/msg/PointCloud2"
            values = {
                name: getattr(points, name)
                for name in points.__dataclass_fields__
                if name not in ("header", "__msgtype__")
            }
            message = old.types[kind](header=head(k, "camera"), **values)
            bag.write(made["/marker_tracks"], log_time(k), old.serialize_ros1(message, kind))
            text = old.types["std_msgs/msg/String"](data="hello")
            bag.write(made["/chatter"], log_time(k), old.serialize_ros1(text, "std_msgs/msg/String"))
        kind = "sensor_msgs/msg/CameraInfo"
        roi = old.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
        info = old.types[kind](
            header=head(0, "camera"), height=480, width=640, distortion_model="plumb_bob", D=np.zeros(5),
            K=np.array([500.0, 0, 320, 0, 500, 240, 0, 0, 1]), R=np.zeros(9), P=np.zeros(12), binning_x=0, binning_y=0,
            roi=roi,
        )  # fmt: skip
        bag.write(made["/camera_info"], log_time(0), old.serialize_ros1(info, kind))
    return path


def test_a_ros1_bag_is_read(tmp_path: Path) -> None:
    recording = read_recording(ros1(tmp_path / "press.bag"))
    np.testing.assert_allclose(recording.poses["ee"].position[:, 0], 1e-4 * np.arange(20), atol=1e-12)
    tracks = recording.tracks["camera"]
    assert tracks.ids.tolist() == [4, 5] and tracks.uv[3, 0].tolist() == [4.0, 2.0]
    assert tracks.camera_info is not None and tracks.camera_info.K[0, 2] == 320.0
    assert recording.provenance.storage == "rosbag1" and "/chatter" in recording.provenance.message_counts


def test_a_damaged_ros1_bag_is_one_sentence(tmp_path: Path) -> None:
    path = ros1(tmp_path / "press.bag")
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(RecordingError, match=r"is a ROS 1 bag that cannot be read: .* `rosbag reindex`"):
        read_recording(path)


TABLE = """\
# pulled on 3 May
time [ms],x [mm],yaw [deg],force_z [gf],torque_x [N mm]
0,0.0,0,0,1
10,1.0,90,102,2
20,2.0,90,,3
30,3.0,90,204,4
"""


def test_a_table_with_units(tmp_path: Path) -> None:
    (tmp_path / "pull.csv").write_text(TABLE)
    recording = read_recording(tmp_path / "pull.csv")
    pose, wrench = recording.poses["ee"], recording.wrenches["sensor"]
    np.testing.assert_allclose(pose.t, [0.0, 0.01, 0.02, 0.03], atol=1e-9)
    np.testing.assert_allclose(pose.position, [[1e-3 * k, 0.0, 0.0] for k in range(4)], atol=1e-12)
    np.testing.assert_allclose(pose.quaternion[1], [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)
    np.testing.assert_allclose(wrench.force[:, 2], [0.0, 1.0002783, np.nan, 2.0005566], rtol=1e-6)
    np.testing.assert_allclose(wrench.torque[:, 0], [1e-3, 2e-3, 3e-3, 4e-3])
    assert "y, z not in the table, taken as 0" in notes(recording)


def test_tables_of_one_folder_share_a_clock_and_may_have_decimal_commas(tmp_path: Path) -> None:
    (tmp_path / "pose.csv").write_text("t [s];current_pose.x [m]\n0,5;0,001\n0,6;0,002\n", encoding="utf-8-sig")
    (tmp_path / "video.csv").write_text("t [s]\tmarker_tracks.7.u [px]\tmarker_tracks.7.v [px]\n1\t10\t20\n2\t11\t\n")
    recording = read_recording(tmp_path)
    assert recording.poses["ee"].position[:, 0].tolist() == [0.001, 0.002]
    tracks = recording.tracks["camera"]
    np.testing.assert_allclose(tracks.t, [0.5], atol=1e-9)
    assert tracks.ids.tolist() == [7] and tracks.uv[0, 0].tolist() == [10.0, 20.0]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("time [s],x\n0,1\n1,2\n", r"the column 'x' has no unit\. Write one of these in brackets .*m, cm, mm"),
        ("time [s],x [furlong]\n0,1\n1,2\n", r"the column 'x \[furlong\]' has the unit 'furlong'"),
        ("x [m]\n0\n1\n", r"has no column of times among x \[m\]"),
        ("time [s],strain [1]\n0,1\n", r"the column 'strain \[1\]' is not known"),
        ("time [s],x [m]\n0,one\n", r"line 2 has 'one' for 'x \[m\]'"),
        ("time [s],x [m],x [mm]\n0,1,2\n", r"has current_pose\.x twice"),
        ("time [s],x [m]\n0,1,2\n", r"line 2 has 3 cells, the header 2"),
        ("time [s],x [m]\n,1\n", r"line 2 has no time"),
        ("time [s],x [m]\n1e30,1\n", r"the times go from 1e\+30"),
        ("", r"has no header line and readings"),
    ],
)
def test_a_table_that_cannot_be_read_says_where(tmp_path: Path, text: str, fault: str) -> None:
    (tmp_path / "pull.csv").write_text(text)
    with pytest.raises(RecordingError, match=fault):
        read_recording(tmp_path / "pull.csv")
