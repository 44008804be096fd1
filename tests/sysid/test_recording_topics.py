"""Which topic plays which role."""

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import RecordingError
from sysid.recording import EETopics, RecordingWriter, SensorTopic, TopicNames, read_recording

STORE = get_typestore(Stores.ROS2_JAZZY)
REST = np.array([[0.0, 0.0, 0.0], [0.001, 0.0, 0.0]])


def write(path: Path, **topics: list[str]) -> Path:
    with RecordingWriter(path) as bag:
        for k in range(5):
            for topic in topics.get("pose", ["current_pose"]):
                bag.pose(topic, k, (0, 0, 0), (0, 0, 0, 1), "base_link")
            for topic in topics.get("wrench", []):
                bag.wrench(topic, k, (0, 0, 1), (0, 0, 0), "gel")
            for topic in topics.get("markers", []):
                bag.markers(topic, k, REST, REST, [0, 1], "gel")
            for topic in topics.get("tracks", []):
                bag.tracks(topic, k, REST[:, :2], [0, 1], [1, 1], "optical")
        for topic in topics.get("info", []):
            focal = 100.0 + len(topic)
            bag.camera_info(topic, 0, np.diag([focal, focal, 1.0]), [], "plumb_bob", 8, 8, topic)
    return path


def notes(recording) -> str:
    return "\n".join(map(str, recording.notes))


def test_contract_names_are_found_in_any_namespace(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", pose=["arm/current_pose"], wrench=["a/b/wrench"], markers=["tactile/left/markers"])
    recording = read_recording(path)
    assert recording.poses["ee"].topic == "/arm/current_pose"
    assert recording.wrenches["sensor"].topic == "/a/b/wrench"
    assert recording.markers["sensor"].topic == "/tactile/left/markers"


def test_rest_markers_are_not_taken_for_markers(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", markers=["left/markers_rest", "left/markers"])
    recording = read_recording(path)
    assert recording.markers["sensor"].topic == "/left/markers"
    assert "1 topic not used: /left/markers_rest" in notes(recording)
    with pytest.raises(RecordingError, match="holds no measurement"):
        read_recording(write(tmp_path / "rest", markers=["left/markers_rest", "my_markers"]))


def test_an_ambiguous_choice_lists_the_candidates(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", markers=["left/markers", "right/markers"])
    with pytest.raises(RecordingError, match=r"any of: /left/markers, /right/markers\. Name the topic"):
        read_recording(path)
    path = write(tmp_path / "two", pose=["a/current_pose", "b/current_pose"], wrench=["wrench"])
    with pytest.raises(RecordingError, match=r"e\.g\. ee: \{ee: \{current_pose: /a/current_pose\}\}"):
        read_recording(path)


def test_names_of_the_rig_are_found_in_namespaces(tmp_path: Path) -> None:
    path = write(
        tmp_path / "bag",
        pose=["left/current_pose", "right/current_pose"],
        markers=["tactile/left/markers", "tactile/right/markers"],
    )
    topics = TopicNames(
        ee={"left": EETopics(), "right": EETopics()}, markers={"left": None, "right": None, "third": None}
    )
    recording = read_recording(path, topics)
    assert {n: s.topic for n, s in recording.poses.items()} == {
        "left": "/left/current_pose",
        "right": "/right/current_pose",
    }
    assert {n: s.topic for n, s in recording.markers.items()} == {
        "left": "/tactile/left/markers",
        "right": "/tactile/right/markers",
    }


def test_a_topic_that_no_name_of_the_rig_matches_is_said(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", wrench=["left/wrench", "middle/wrench"])
    recording = read_recording(path, TopicNames(wrench={"left": None, "right": None}))
    assert list(recording.wrenches) == ["left"]
    assert "no name of the rig matches /middle/wrench" in notes(recording)


def test_exact_names(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", pose=["robot/tcp"], markers=["a/dots", "b/dots"])
    topics = TopicNames(ee={"arm": EETopics(current_pose="/robot/tcp")}, markers={"gel": "b/dots"})
    recording = read_recording(path, topics)
    assert recording.poses["arm"].topic == "/robot/tcp"
    assert recording.markers["gel"].topic == "/b/dots"


def test_a_relative_name_matches_under_a_namespace(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", markers=["cell_3/left/dots"])
    recording = read_recording(path, TopicNames(markers={"gel": SensorTopic(topic="left/dots")}))
    assert recording.markers["gel"].topic == "/cell_3/left/dots"
    assert "/cell_3/left/dots: taken for left/dots" in notes(recording)
    path = write(tmp_path / "two", markers=["a/left/dots", "b/left/dots"])
    with pytest.raises(RecordingError, match="more than one namespace: /a/left/dots, /b/left/dots"):
        read_recording(path, TopicNames(markers={"gel": "left/dots"}))


def test_an_absent_topic_names_the_nearest(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", wrench=["ft/wrench"])
    with pytest.raises(RecordingError) as error:
        read_recording(path, TopicNames(wrench={"gel": "ft/wrnch"}))
    assert "Did you mean '/ft/wrench'?" in str(error.value)
    assert "/current_pose, /ft/wrench" in str(error.value)


def test_a_named_topic_of_a_wrong_type(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", wrench=["wrench"])
    with pytest.raises(RecordingError, match=r"/wrench is of type .*WrenchStamped where markers needs .*Cloud2"):
        read_recording(path, TopicNames(markers={"gel": "/wrench"}))


def test_a_found_topic_of_a_wrong_type_is_not_used(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", pose=["current_pose", "x/wrench"], wrench=["ft/wrench"])
    recording = read_recording(path)
    assert recording.wrenches["sensor"].topic == "/ft/wrench"
    assert "/x/wrench: not used for wrench: it is of type geometry_msgs/msg/PoseStamped" in notes(recording)


def test_unknown_types_are_ignored_and_said(tmp_path: Path) -> None:
    source = write(tmp_path / "bag", wrench=["wrench"])
    content = (source / "bag.mcap").read_bytes()
    with (tmp_path / "more.mcap").open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="test")
        ids = {}
        for schema, channel, message in make_reader(BytesIO(content)).iter_messages():
            assert schema is not None
            if channel.topic not in ids:
                # the older way of naming types, without 'msg'
                name = schema.name.replace("/msg/", "/")
                schema_id = writer.register_schema(name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id)
            writer.add_message(ids[channel.topic], message.log_time, message.data, message.log_time)
        odd = writer.register_schema("control_msgs/msg/Odd", "ros2msg", b"int32 x")
        writer.add_message(writer.register_channel("/odd", "cdr", odd), 3, bytes(8), 3)
        foxglove = writer.register_schema("foxglove.Log", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/x/wrench", "json", foxglove), 3, json.dumps({}).encode(), 3)
        writer.finish()
    recording = read_recording(tmp_path / "more.mcap")
    assert len(recording.wrenches["sensor"]) == len(recording.poses["ee"]) == 5
    assert "2 topics not used: /odd (control_msgs/msg/Odd), /x/wrench (foxglove.Log)" in notes(recording)


def test_a_known_type_in_another_encoding(tmp_path: Path) -> None:
    buffer = BytesIO()
    writer = McapWriter(buffer)
    writer.start(profile="ros2", library="test")
    schema = writer.register_schema("geometry_msgs/msg/WrenchStamped", "ros1msg", b"")
    writer.add_message(writer.register_channel("/wrench", "ros1", schema), 3, bytes(8), 3)
    writer.finish()
    (tmp_path / "x.mcap").write_bytes(buffer.getvalue())
    with pytest.raises(RecordingError, match="encoded as ros1 with ros1msg schema"):
        read_recording(tmp_path / "x.mcap", TopicNames(wrench={"gel": "/wrench"}))


def test_a_topic_without_messages(tmp_path: Path) -> None:
    source = write(tmp_path / "bag", wrench=["wrench"])
    with (
        Reader(source) as old,
        Writer(tmp_path / "new", version=9, storage_plugin=StoragePlugin.MCAP) as new,
    ):
        new.add_connection("/left/markers", "sensor_msgs/msg/PointCloud2", typestore=STORE)
        made = {c.topic: new.add_connection(c.topic, c.msgtype, typestore=STORE) for c in old.connections}
        for connection, stamp, raw in old.messages():
            new.write(made[connection.topic], stamp, raw)
    assert read_recording(tmp_path / "new").markers == {}
    with pytest.raises(RecordingError, match=r"/left/markers .* has no messages"):
        read_recording(tmp_path / "new", TopicNames(markers={"gel": "left/markers"}))


def test_calibrations_belong_to_the_camera_in_their_namespace(tmp_path: Path) -> None:
    path = write(
        tmp_path / "bag",
        tracks=["inside/marker_tracks", "above/marker_tracks", "odd/marker_tracks"],
        info=["inside/camera_info", "above/camera_info"],
    )
    recording = read_recording(path, TopicNames(tracks={"inside": None, "above": None, "odd": None}))
    frames = {name: s.camera_info and s.camera_info.frame_id for name, s in recording.tracks.items()}
    assert frames == {"inside": "inside/camera_info", "above": "above/camera_info", "odd": None}
    named = TopicNames(tracks={"c": "odd/marker_tracks"}, camera_info={"c": "above/camera_info"})
    camera = read_recording(path, named).tracks["c"].camera_info
    assert camera is not None and camera.frame_id == "above/camera_info"


def test_a_topic_map_from_plain_data() -> None:
    topics = TopicNames.from_dict(
        {
            "ee": {
                "arm": {"current_pose": "/tcp", "length_unit": "mm", "quaternion_order": "wxyz"},
                "b": None,
            },
            "wrench": {"gel": {"topic": "/ft", "frame_id": "tool0"}},
            "markers": {"gel": "/dots", "other": None},
            "tracks": {"cam": "/cam/dots"},
            "time": "log",
        }
    )
    assert topics == TopicNames(
        ee={
            "arm": EETopics(current_pose="/tcp", length_unit="mm", quaternion_order="wxyz"),
            "b": EETopics(),
        },
        wrench={"gel": SensorTopic(topic="/ft", frame_id="tool0")},
        markers={"gel": "/dots", "other": None},
        tracks={"cam": "/cam/dots"},
        time="log",
    )


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ({"marker": {}}, "no entry 'marker'. Did you mean 'markers'"),
        ({"markers": "/dots"}, "topics.markers is '/dots'"),
        ({"markers": {"gel": 3}}, "topics.markers.gel is 3"),
        ({"tracks": {"cam": {"topic": "/x"}}}, "topics.tracks.cam is"),
        ({"ee": {"arm": "/tcp"}}, "topics.ee.arm is '/tcp'"),
        ({"ee": {"arm": {"curent_pose": "/tcp"}}}, "Did you mean 'current_pose'"),
        ({"ee": {"arm": {"length_unit": "cm"}}}, "topics.ee.arm.length_unit is 'cm'. Use one of: m, mm"),
        ({"ee": {"arm": {"quaternion_order": "wzyx"}}}, "Use one of: xyzw, wxyz"),
        ({"wrench": {"gel": {"frame_id": 1}}}, "topics.wrench.gel.frame_id is 1"),
        ({"time": "wall"}, "Use one of: header, log"),
    ],
)
def test_a_topic_map_with_mistakes(data, message: str) -> None:
    with pytest.raises(RecordingError, match=message.replace(".", r"\.")):
        TopicNames.from_dict(data)
