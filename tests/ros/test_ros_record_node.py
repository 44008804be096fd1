"""The recorder as a process of its own, over loopback."""

import signal
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ros_live import RIG, WAIT_S, Client, NodeProcess
from rosbags.rosbag2 import Reader

from sim_core.rigs import load_rig
from sysid.observations.rig_topics import topics_of
from sysid.recording import read_recording
from thinshell_ros.bagfile import TYPESTORE

pytestmark = pytest.mark.ros


def skips(bag: Path) -> int:
    """How often stamps left out time in which the simulation did not keep up: on a busy machine it may not."""
    with Reader(bag) as reader:
        messages = [
            TYPESTORE.deserialize_cdr(raw, c.msgtype) for c, _, raw in reader.messages() if c.topic == "/events"
        ]
    return sum(status.name.endswith("skip") for message in messages for status in message.status)


def test_a_press_is_recorded_whole_and_reads_back(
    client: Client, record_press: Callable[[Path], dict[str, int]], tmp_path: Path
) -> None:
    heard = record_press(tmp_path / "press")
    counts = read_recording(tmp_path / "press").provenance.message_counts
    for topic, count in heard.items():
        if not topic.startswith("/"):
            assert counts[f"/{topic}"] >= count, topic
    assert counts["/tactile/left/markers_rest"] == 1, "latched messages come along"

    names, missing = topics_of(load_rig(RIG), counts)
    assert not missing
    recording = read_recording(tmp_path / "press", names)
    assert set(recording.poses) == {"probe"}
    assert set(recording.target_poses) == {"probe"}
    for _, name, stream in recording.streams():
        steps = np.diff(stream.t)
        if name not in recording.target_poses or stream.topic.endswith("current_pose"):
            odd = np.abs(steps - np.median(steps)) > 1e-6
            assert odd.sum() <= skips(tmp_path / "press"), stream.topic
    force = recording.wrenches["pad_wrench"].force
    assert force[:, 2].min() < -0.1
    assert abs(force[-1, 2]) < 0.02
    assert recording.markers["pad_markers"].position.shape[1:] == (16, 3)
    camera = recording.tracks["side"].camera_info
    assert camera is not None
    assert camera.K[0, 0] == 1400.0
    assert not [note for note in recording.warnings if "clock" in note.text]


def test_a_recorder_that_is_killed_leaves_what_it_had(client: Client, tmp_path: Path) -> None:
    bag = tmp_path / "killed"
    recorder = NodeProcess(
        "record_node", tmp_path / "output", topics="[current_pose, tactile/left/wrench, nobody]", uri=bag
    )
    try:
        status = client.diagnosis(
            "recorder: recording",
            lambda s: any(v.key == "/current_pose" and int(v.value) > 50 for v in s.values),
        )
        assert status.level == b"\x01"
        assert "nobody publishes /nobody" in status.message
        client.diagnosis("recorder: recording", lambda s: True)
        recorder.kill()
    finally:
        recorder.kill()
    recording = read_recording(bag)
    assert len(recording.poses["ee"]) > 50
    assert len(recording.wrenches["sensor"]) > 50
    assert any("cut short" in note.text for note in recording.warnings)


def test_a_bag_is_not_overwritten(ros: None, tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    recorder = NodeProcess("record_node", tmp_path / "output", rig=RIG, uri=tmp_path / "bag")
    try:
        assert recorder.process.wait(WAIT_S) == 2
        assert "exists already" in recorder.output
        assert "Traceback" not in recorder.output
    finally:
        recorder.kill()


def test_a_recorder_without_topics_is_refused(ros: None, tmp_path: Path) -> None:
    recorder = NodeProcess("record_node", tmp_path / "output")
    try:
        assert recorder.process.wait(WAIT_S) == 2
        assert "Set the parameter rig, topics, or both." in recorder.output
    finally:
        recorder.kill()


def test_without_messages_no_bag_is_kept(client: Client, tmp_path: Path) -> None:
    bag = tmp_path / "empty"
    recorder = NodeProcess("record_node", tmp_path / "output", topics="[nobody]", uri=bag)
    try:
        client.diagnosis("recorder: recording", lambda s: "/nobody" in s.message)
        assert bag.is_dir()
        assert recorder.stop(signal.SIGTERM) == 1
        assert "No message came" in recorder.output
        assert not bag.exists()
    finally:
        recorder.kill()
