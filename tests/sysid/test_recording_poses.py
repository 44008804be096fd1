"""Frames, units and orientation of recorded poses."""

from pathlib import Path

import numpy as np
import pytest
from recording_messages import POSE, WRENCH, log_time, notes, pose, poses, read, store, wrench, wrenches

from sim_core.errors import RecordingError
from sysid.recording import EETopics, SensorTopic, TopicNames, read_recording


def test_mixed_frames_are_refused_unless_one_is_declared(tmp_path: Path) -> None:
    items = wrenches()
    for k in (3, 9):
        items[k] = ("/wrench", WRENCH, log_time(k), wrench(log_time(k), frame="tool0"))
    path = store(tmp_path / "bag", poses() + items)
    with pytest.raises(RecordingError, match=r"more than one frame: 'gel' \(18 messages\), 'tool0'"):
        read_recording(path)
    recording = read_recording(path, TopicNames(wrench={"sensor": SensorTopic(frame_id="gel")}))
    assert len(recording.wrenches["sensor"]) == 18
    assert "messages of other frames than 'gel' dropped" in notes(recording)


def test_one_message_of_another_frame_is_damaged(tmp_path: Path) -> None:
    items = wrenches()
    items[3] = ("/wrench", WRENCH, log_time(3), wrench(log_time(3), frame="tool0"))
    recording = read_recording(store(tmp_path / "bag", poses() + items))
    assert len(recording.wrenches["sensor"]) == 19
    assert "1 message of another frame dropped: the first, recorded 0.030 s after" in notes(recording)


def test_a_wrong_frame_is_refused(tmp_path: Path) -> None:
    topics = TopicNames(ee={"ee": EETopics(frame_id="world")})
    with pytest.raises(RecordingError, match=r"frame_id is 'base_link' .* where 'world' is declared"):
        read(tmp_path, poses() + wrenches(), topics)


def test_an_empty_frame_is_said(tmp_path: Path) -> None:
    assert "/wrench: frame_id is empty" in notes(read(tmp_path, poses() + wrenches(frame="")))


def test_measured_and_commanded_pose_in_different_frames(tmp_path: Path) -> None:
    items = [("/target_pose", POSE, t, pose(t, frame="world")) for t in map(log_time, range(20))]
    recording = read(tmp_path, poses() + items + wrenches())
    assert "/target_pose: in frame 'world' while /current_pose is in 'base_link'" in notes(recording)


def test_poses_with_nan_are_dropped(tmp_path: Path) -> None:
    items = poses()
    items[2] = ("/current_pose", POSE, log_time(2), pose(log_time(2), (np.nan, 0, 0)))
    items[3] = ("/current_pose", POSE, log_time(3), pose(log_time(3), q=(0, 0, 0, np.inf)))
    recording = read(tmp_path, items + wrenches())
    assert len(recording.poses["ee"]) == 18
    assert "s after the first of this topic, holds NaN or infinity" in notes(recording)


def test_poses_with_nothing_but_nan(tmp_path: Path) -> None:
    items = [("/current_pose", POSE, log_time(k), pose(log_time(k), (np.nan, 0, 0))) for k in range(5)]
    with pytest.raises(RecordingError, match="none of 5 messages can be used: the first holds NaN"):
        read(tmp_path, items + wrenches())


@pytest.mark.parametrize("offset", [0.0, 400.0])
def test_millimetres_are_refused_and_can_be_declared(tmp_path: Path, offset: float) -> None:
    path_mm = offset + np.linspace(0.0, 5.0, 20)  # a press of 5 mm, written as 5
    items = [("/current_pose", POSE, log_time(k), pose(log_time(k), (0, 0, path_mm[k]))) for k in range(20)]
    path = store(tmp_path / "bag", items + wrenches())
    with pytest.raises(RecordingError, match=r"look like millimetres.*`length_unit: mm`"):
        read_recording(path)
    recording = read_recording(path, TopicNames(ee={"ee": EETopics(length_unit="mm")}))
    np.testing.assert_allclose(recording.poses["ee"].position[:, 2], 1e-3 * path_mm)
    assert "positions scaled from mm to m, as declared" in notes(recording)
    metres = read_recording(path, TopicNames(ee={"ee": EETopics(length_unit="m")}))
    np.testing.assert_array_equal(metres.poses["ee"].position[:, 2], path_mm)


def test_millimetres_within_a_small_range_are_said(tmp_path: Path) -> None:
    items = [("/current_pose", POSE, log_time(k), pose(log_time(k), (0, 0, 0.1 * k))) for k in range(20)]
    assert "usual speed 10 m/s: looks like millimetres" in notes(read(tmp_path, items + wrenches()))


def test_a_single_wild_position_is_a_jump(tmp_path: Path) -> None:
    items = poses()
    items[8] = ("/current_pose", POSE, log_time(8), pose(log_time(8), (50.0, 0, 0.1)))
    recording = read(tmp_path, items + wrenches())
    assert recording.poses["ee"].position[8, 0] == 50.0
    assert "2 jumps of the position, the largest 50 m within 0.01 s at t=0.07 s" in notes(recording)


def test_quaternions_are_normalised(tmp_path: Path) -> None:
    recording = read(tmp_path, poses(q=(0, 0, 0.6, 1.7)) + wrenches())
    quaternion = recording.poses["ee"].quaternion
    np.testing.assert_allclose(quaternion[0], np.array([0, 0, 0.6, 1.7]) / np.hypot(0.6, 1.7))
    assert "quaternions normalised (norms from 1.80278 to 1.80278)" in notes(recording)


def test_a_zero_quaternion_costs_its_message_and_no_other(tmp_path: Path) -> None:
    items = poses()
    items[6] = ("/current_pose", POSE, log_time(6), pose(log_time(6), q=(0, 0, 0, 0)))
    recording = read(tmp_path, items + wrenches())
    assert len(recording.poses["ee"]) == 19
    assert "recorded 0.060 s after the first of this topic, has an orientation of zero" in notes(recording)


def test_poses_without_any_orientation_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"none of 20 messages can be used: .* zero \(the identity is x=0"):
        read(tmp_path, poses(q=(0, 0, 0, 0)) + wrenches())


def test_a_w_first_identity_is_refused_and_can_be_declared(tmp_path: Path) -> None:
    path = store(tmp_path / "bag", poses(q=(1, 0, 0, 0)) + wrenches())
    with pytest.raises(RecordingError, match=r"half turn about x.*`quaternion_order: wxyz`"):
        read_recording(path)
    recording = read_recording(path, TopicNames(ee={"ee": EETopics(quaternion_order="wxyz")}))
    np.testing.assert_array_equal(recording.poses["ee"].quaternion[0], [0, 0, 0, 1])
    assert "reordered from w x y z, as declared" in notes(recording)
    tool_down = read_recording(path, TopicNames(ee={"ee": EETopics(quaternion_order="xyzw")}))
    np.testing.assert_array_equal(tool_down.poses["ee"].quaternion[0], [1, 0, 0, 0])
    assert tool_down.notes == ()


def test_w_first_order_is_declared_in_full(tmp_path: Path) -> None:
    w, x, y, z = 0.5, 0.1, 0.7, np.sqrt(1 - 0.25 - 0.01 - 0.49)
    topics = TopicNames(ee={"ee": EETopics(quaternion_order="wxyz")})
    recording = read(tmp_path, poses(q=(w, x, y, z)) + wrenches(), topics)
    np.testing.assert_allclose(recording.poses["ee"].quaternion[0], [x, y, z, w])


def test_a_start_near_a_half_turn_about_x_is_said(tmp_path: Path) -> None:
    q = np.array([1.0, 0.02, -0.01, 0.015])
    recording = read(tmp_path, poses(q=q / np.linalg.norm(q)) + wrenches())
    assert "starts near a half turn about x" in notes(recording)


@pytest.mark.parametrize("wrong", ["/current_pose", "/target_pose"])
def test_one_of_two_pose_topics_w_first_is_refused(tmp_path: Path, wrong: str) -> None:
    right = np.array([0.3, 0.5, -0.2, 0.0])
    right[3] = np.sqrt(1.0 - right @ right)
    items = [
        (topic, POSE, t, pose(t, q=np.roll(right, 1) if topic == wrong else right))
        for t in map(log_time, range(20))
        for topic in ("/current_pose", "/target_pose")
    ]
    with pytest.raises(RecordingError, match=f"{wrong}: .* only when read as w x y z"):
        read(tmp_path, items + wrenches())


def test_sign_flips_are_removed(tmp_path: Path) -> None:
    items = [
        ("/current_pose", POSE, log_time(k), pose(log_time(k), q=(0, 0, 0, -1 if 5 <= k < 9 else 1))) for k in range(20)
    ]
    recording = read(tmp_path, items + wrenches())
    np.testing.assert_array_equal(recording.poses["ee"].quaternion[:, 3], 1.0)
    assert "2 sign flips of the quaternion removed" in notes(recording)
