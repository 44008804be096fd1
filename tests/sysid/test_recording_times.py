"""Stamps of a recording, and what has to be in it."""

from pathlib import Path

import numpy as np
import pytest
from recording_messages import MS, POSE, START, WRENCH, log_time, notes, pose, poses, read, store, wrench, wrenches

from sim_core.errors import RecordingError
from sysid.recording import TopicNames, read_recording


def test_zero_stamps_fall_back_to_log_time(tmp_path: Path) -> None:
    recording = read(tmp_path, poses() + wrenches(stamp=lambda k: 0))
    np.testing.assert_allclose(recording.wrenches["sensor"].t, 0.01 * np.arange(20), atol=1e-12)
    assert "warning: /wrench: all header stamps are zero: log time is used" in notes(recording)
    assert "/current_pose" not in notes(recording)


def test_messages_without_a_stamp_among_stamped_ones_are_dropped(tmp_path: Path) -> None:
    recording = read(tmp_path, poses() + wrenches(stamp=lambda k: 0 if k < 3 else log_time(k)))
    np.testing.assert_allclose(recording.wrenches["sensor"].force[:, 2], 0.1 * np.arange(3, 20))
    assert "3 messages without a stamp dropped" in notes(recording)


def test_a_single_unset_first_stamp_is_dropped(tmp_path: Path) -> None:
    recording = read(tmp_path, poses() + wrenches(stamp=lambda k: 0 if k == 0 else log_time(k)))
    assert len(recording.wrenches["sensor"]) == 19
    assert "1 message without a stamp dropped" in notes(recording)


def test_a_clock_that_starts_at_zero_keeps_its_first_message(tmp_path: Path) -> None:
    items = [("/current_pose", POSE, log_time(k), pose(10 * MS * k, (1e-4 * k, 0, 0))) for k in range(20)] + wrenches(
        stamp=lambda k: 10 * MS * k
    )
    recording = read(tmp_path, items)
    assert len(recording.wrenches["sensor"]) == len(recording.poses["ee"]) == 20
    assert recording.t0_ns == 0 and recording.notes == ()


def test_duplicate_stamps(tmp_path: Path) -> None:
    recording = read(tmp_path, poses() + wrenches(stamp=lambda k: log_time(k - (k in (4, 9, 15)))))
    kept = [k for k in range(20) if k not in (4, 9, 15)]
    np.testing.assert_allclose(recording.wrenches["sensor"].force[:, 2], 0.1 * np.array(kept))
    assert "3 duplicate stamps dropped" in notes(recording)


def test_late_messages_are_put_in_order(tmp_path: Path) -> None:
    swap = {5: 6, 6: 5, 11: 13, 12: 11, 13: 12}
    recording = read(tmp_path, poses() + wrenches(stamp=lambda k: log_time(swap.get(k, k))))
    assert (np.diff(recording.wrenches["sensor"].t) > 0).all()
    expected = 0.1 * np.arange(20)
    for k, j in swap.items():
        expected[j] = 0.1 * k
    np.testing.assert_allclose(recording.wrenches["sensor"].force[:, 2], expected)
    assert "3 messages with a backward stamp put in order" in notes(recording)


@pytest.mark.parametrize("step_ms", [50, 3_600_000])
def test_a_clock_set_back_is_refused(tmp_path: Path, step_ms: int) -> None:
    base = 10_000_000_000_000
    items = poses() + wrenches(stamp=lambda k: base + log_time(k) - (step_ms * MS if k >= 10 else 0))
    path = store(tmp_path / "bag", items)
    with pytest.raises(RecordingError, match=r"/wrench: the stamps go back by .* message 10 .*`recording_clock: log`"):
        read_recording(path)
    recording = read_recording(path, TopicNames(time="log"))
    np.testing.assert_allclose(recording.wrenches["sensor"].t, 0.01 * np.arange(20), atol=1e-12)
    assert "log time is used in place of the header stamps, as declared" in notes(recording)


def test_a_single_stamp_in_the_future_is_dropped(tmp_path: Path) -> None:
    recording = read(tmp_path, poses() + wrenches(stamp=lambda k: log_time(k) + (90_000 * MS if k == 7 else 0)))
    kept = [k for k in range(20) if k != 7]
    np.testing.assert_allclose(recording.wrenches["sensor"].force[:, 2], 0.1 * np.array(kept))
    assert "1 message stamped up to 89.99 s in the future dropped" in notes(recording)


def test_a_gap_is_said(tmp_path: Path) -> None:
    recording = read(tmp_path, poses() + wrenches(stamp=lambda k: log_time(k) + (1200 * MS if k >= 10 else 0)))
    assert "warning: /wrench: gap of 1.21 s at t=0.09 s (usual interval 0.01 s)" in notes(recording)


def test_clocks_that_never_overlap_are_said(tmp_path: Path) -> None:
    recording = read(tmp_path, poses() + wrenches(stamp=lambda k: log_time(k) + 500_000 * MS))
    assert recording.wrenches["sensor"].t[0] == pytest.approx(500.0)
    assert "/wrench: starts 500 s after /current_pose and never overlaps it" in notes(recording)


@pytest.mark.parametrize("period_ms", [1, 1000])
def test_rates_from_1_hz_to_1_khz(tmp_path: Path, period_ms: int) -> None:
    items = []
    for k in range(50):
        t = START + period_ms * MS * k
        items += [("/current_pose", POSE, t, pose(t, (1e-5 * k, 0, 0))), ("/wrench", WRENCH, t, wrench(t))]
    recording = read(tmp_path, items)
    np.testing.assert_allclose(recording.poses["ee"].t, 1e-3 * period_ms * np.arange(50), atol=1e-12)
    assert recording.notes == ()


def test_latched_messages_only(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"single message of each topic \(/current_pose, /wrench\)"):
        read(tmp_path, poses(1) + wrenches(1))


def test_one_latched_stream_is_said(tmp_path: Path) -> None:
    recording = read(tmp_path, poses(1) + wrenches())
    assert "/current_pose: a single message (latched?)" in notes(recording)


def test_no_measurement(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"holds no measurement.*/current_pose \(geometry_msgs"):
        read(tmp_path, poses())


def test_no_pose(tmp_path: Path) -> None:
    path = store(tmp_path / "bag", wrenches())
    with pytest.raises(RecordingError, match=r"holds no pose.*/wrench \(geometry_msgs"):
        read_recording(path)
    assert read_recording(path, need_pose=False).poses == {}


def test_only_a_commanded_pose(tmp_path: Path) -> None:
    items = [("/target_pose", *item[1:]) for item in poses()]
    recording = read(tmp_path, items + wrenches())
    assert recording.poses["ee"].topic == recording.target_poses["ee"].topic == "/target_pose"
    assert "no measured pose: the commanded pose is the input" in notes(recording)


def test_a_message_that_cannot_be_decoded_is_dropped(tmp_path: Path) -> None:
    items = wrenches()
    items[4] = (*items[4][:3], b"\x00\x01\x00\x00\x01")
    items[5] = (*items[5][:3], b"\xff\xff\xff\xff\x01")
    recording = read(tmp_path, poses() + items)
    assert len(recording.wrenches["sensor"]) == 18
    assert "s after the first of this topic, cannot be read as geometry_msgs" in notes(recording)


def test_no_message_that_can_be_decoded(tmp_path: Path) -> None:
    items = [(*item[:3], b"\x00\x01\x00\x00\x01") for item in wrenches()]
    with pytest.raises(RecordingError, match="/wrench: none of 20 messages can be used"):
        read(tmp_path, poses() + items)
