"""Rates, latency, noise, tare and cloud layout of what a simulated rig reads. Needs no ROS."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import load_rig
from sim_core.rigs.schema import JointPoses
from thinshell_ros.clouds import MARKER_POINT, TRACK_POINT, marker_points, track_points
from thinshell_ros.sampling import Sampler
from thinshell_ros.streams import Channel, channels_of, topics_to_record
from thinshell_ros.tare import Tare

RIG = Path(__file__).parent / "data" / "press_gel.yaml"
WRENCH = Channel("cell", "wrench", "wrench", "cell", rate_hz=40.0)


def ramp(time: float) -> np.ndarray:
    return time * np.arange(1.0, 7.0)


def sample(channel: Channel, times: np.ndarray, seed: int | None = None) -> list[tuple[float, np.ndarray]]:
    sampler = Sampler({"cell": channel}, seed)
    sampler.restart(0.0, {"cell": ramp(0.0)})
    return [(r.stamp_s, r.values) for t in times for r in sampler.advance(float(t), {"cell": ramp(t)})]


def test_readings_come_at_their_own_rate_whatever_the_steps() -> None:
    for dt in (0.01, 0.004, 0.1):
        readings = sample(WRENCH, np.arange(1, round(1.0 / dt) + 1) * dt)
        np.testing.assert_allclose([t for t, _ in readings], np.arange(1, 41) / 40.0, atol=1e-12)
        np.testing.assert_allclose([v for _, v in readings], [ramp(t) for t, _ in readings], atol=1e-12)


def test_latency_shifts_the_stamp_and_holds_the_reading_back() -> None:
    late = replace(WRENCH, latency_s=0.03)
    readings = sample(late, np.arange(1, 101) * 0.01)
    np.testing.assert_allclose([t for t, _ in readings], np.arange(1, 39) / 40.0 + 0.03, atol=1e-12)
    np.testing.assert_allclose([v for _, v in readings], [ramp(t - 0.03) for t, _ in readings], atol=1e-12)


@pytest.mark.parametrize(("rate", "dt"), [(60.0, 0.01), (30.0, 0.02), (100.0, 0.02), (100.0, 1.0), (50.0, 0.02)])
def test_readings_are_given_out_evenly_and_not_before_they_are_known(rate: float, dt: float) -> None:
    sampler = Sampler({"cell": replace(WRENCH, rate_hz=rate)}, None, step_s=dt)
    sampler.restart(0.0, {"cell": ramp(0.0)})
    times = np.arange(1, round(3.0 / dt) + 1) * dt
    known, released = [], []
    for t in times:
        for reading in sampler.advance(float(t), {"cell": ramp(float(t))}):
            known.append(t)
            released.append(reading.release_s)
    np.testing.assert_allclose(np.diff(released), 1.0 / rate, atol=1e-9)
    wait = np.array(released) - known
    assert wait.min() == pytest.approx(0.0, abs=1e-6), "none waits for longer than it must"
    assert wait.max() <= dt


def test_noise_has_the_stated_size_and_is_the_same_for_the_same_seed() -> None:
    noisy = replace(WRENCH, rate_hz=1000.0, noise=np.array([0.1] * 3 + [0.0] * 3))
    times = np.arange(1, 2001) * 0.001
    first, again, other = (sample(noisy, times, seed) for seed in (1, 1, 2))
    errors = np.array([v - ramp(t) for t, v in first])
    assert errors[:, :3].std() == pytest.approx(0.1, rel=0.05)
    assert np.abs(errors[:, 3:]).max() < 1e-12
    assert all((a == b).all() for (_, a), (_, b) in zip(first, again, strict=True))
    assert any((a != b).any() for (_, a), (_, b) in zip(first, other, strict=True))


def test_what_sensors_do_comes_before_the_noise() -> None:
    sampler = Sampler({"cell": WRENCH}, None, lambda channel, stamp, values: values + stamp)
    sampler.restart(0.0, {"cell": np.zeros(6)})
    (reading,) = sampler.advance(0.03, {"cell": np.zeros(6)})
    np.testing.assert_allclose(reading.values, 0.025)


def test_poses_are_interpolated_as_unit_quaternions() -> None:
    pose = Channel("ee", "pose", "current_pose", "base_link", rate_hz=100.0)
    sampler = Sampler({"ee": pose}, 0)
    start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    end = np.array([0.2, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    sampler.restart(0.0, {"ee": start})
    (half, whole) = sampler.advance(0.02, {"ee": end})
    np.testing.assert_allclose(half.values, [0.1, 0.0, 0.0, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)])
    np.testing.assert_allclose(whole.values, end)


def test_the_channels_of_a_rig() -> None:
    channels = channels_of(load_rig(RIG), 50.0)
    assert [(c.name, c.kind, c.topic, c.frame_id) for c in channels.values()] == [
        ("probe", "pose", "current_pose", "base_link"),
        ("pad_wrench", "wrench", "tactile/left/wrench", "tactile_left_gel"),
        ("pad_markers", "markers", "tactile/left/markers", "tactile_left_gel"),
        ("side", "tracks", "side/marker_tracks", "side_optical_frame"),
    ]
    assert channels["probe"].rate_hz == 50.0
    assert channels_of(load_rig(RIG), 50.0, "table")["probe"].frame_id == "table"


def test_a_rig_with_other_units_is_refused(tmp_path: Path) -> None:
    text = RIG.read_text().replace("topics: {target_pose", "topics: {length_unit: mm, target_pose")
    (tmp_path / "mm.yaml").write_text(text)
    with pytest.raises(ConfigError, match="length_unit"):
        channels_of(load_rig(tmp_path / "mm.yaml"), 50.0)


def test_the_topics_to_record() -> None:
    topics = {topic.name: topic.expected for topic in topics_to_record(load_rig(RIG))}
    assert topics == {
        "target_pose": True,
        "current_pose": True,
        "tactile/left/wrench": True,
        "tactile/left/markers": True,
        "tactile/left/markers_rest": False,
        "side/marker_tracks": True,
        "side/camera_info": True,
        "side/image/compressed": False,
        "events": False,
    }


@pytest.mark.parametrize("urdf", [None, "robot.urdf"])
def test_joints_are_recorded_in_place_of_a_pose(urdf: str | None) -> None:
    """With the URDF, unless the rig names a file."""
    rig = load_rig(RIG)
    ((name, hand),) = rig.end_effectors.items()
    joints = JointPoses(tip="tool0", urdf=urdf)
    hand = hand.model_copy(update={"topics": hand.topics.model_copy(update={"joints": joints})})
    topics = topics_to_record(rig.model_copy(update={"end_effectors": {name: hand}}))
    expected = {topic.name: topic.expected for topic in topics}
    assert (expected["joint_states"], expected["current_pose"]) == (True, False)
    assert expected["robot_description"] == (urdf is None)


def test_a_tare_averages_the_last_readings_and_a_restart_takes_it_back() -> None:
    markers = Channel("pad", "markers", "markers", "pad", rate_hz=60.0)
    tare = Tare({"cell": WRENCH, "pad": markers})
    rest = np.arange(6.0).reshape(2, 3)
    tare.restart({"cell": ramp(1.0), "pad": rest})
    assert (tare.offset("cell") == 0.0).all(), "a wrench is relative to nothing until it is zeroed"
    assert (tare.offset("pad") == rest).all()
    assert tare.zero(0.0) == ["cell", "pad"]
    for k in range(30):
        tare.take("cell", ramp(float(k)))
        tare.take("pad", rest + k)
        tare.take("unknown", rest)
    assert tare.zero(5.0) == []
    np.testing.assert_allclose(tare.offset("cell"), ramp(24.5))
    assert (tare.offset("cell", 5.0) == 0.0).all(), "readings from before are as they were"
    assert (tare.offset("cell", 5.1) == tare.offset("cell")).all()
    np.testing.assert_allclose(tare.offset("pad"), rest + 24.5)
    tare.restart({"cell": ramp(1.0), "pad": rest})
    assert (tare.offset("cell") == 0.0).all()
    assert (tare.offset("pad") == rest).all()


def test_marker_points_follow_the_layout_and_leave_lost_ones_out() -> None:
    assert MARKER_POINT.itemsize == 40
    assert MARKER_POINT.fields is not None
    assert {name: MARKER_POINT.fields[name][1] for name in ("x", "dx", "fx", "id")} == {
        "x": 0, "dx": 12, "fx": 24, "id": 36,
    }  # fmt: skip
    rest = np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0], [6.0, 7.0, 8.0]])
    moved = rest + [0.5, 0.25, -0.5]
    moved[1, 2] = np.nan
    points = marker_points(moved, rest, np.array([7, 8, 2**32 - 1]))
    assert points["id"].tolist() == [7, 2**32 - 1]
    assert points["x"].tolist() == [0.5, 6.5]
    assert points["dz"].tolist() == [-0.5, -0.5]
    assert np.isnan(points["fy"]).all()


def test_track_points_follow_the_layout_and_leave_lost_ones_out() -> None:
    assert TRACK_POINT.itemsize == 16
    points = track_points(np.array([[1.0, 2.0], [np.nan, np.nan], [3.0, 4.0]]), np.array([0, 1, 2]))
    assert points["u"].tolist() == [1.0, 3.0]
    assert points["v"].tolist() == [2.0, 4.0]
    assert points["id"].tolist() == [0, 2]
    assert (points["confidence"] == 1.0).all()
