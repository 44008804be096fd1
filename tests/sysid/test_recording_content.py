"""Faults inside the messages: times, frames, units, orientation, markers, cameras, images."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import RecordingError
from sysid.recording import EETopics, Recording, SensorTopic, TopicNames, read_recording

MS = 1_000_000
START = 1_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
CLOUD, INFO = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo"
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
KINDS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

Item = tuple[str, str, int, Any]  # topic, type, log time [ns], message


def make(msgtype: str, **values: Any) -> Any:
    return STORE.types[msgtype](**values)


def header(stamp_ns: int, frame: str) -> Any:
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    stamp = make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(stamp_ns: int, p=(0.0, 0.0, 0.1), q=(0.0, 0.0, 0.0, 1.0), frame: str = "base_link") -> Any:
    point = make("geometry_msgs/msg/Point", **dict(zip("xyz", map(float, p), strict=True)))
    turn = make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, q), strict=True)))
    body = make("geometry_msgs/msg/Pose", position=point, orientation=turn)
    return make(POSE, header=header(stamp_ns, frame), pose=body)


def wrench(stamp_ns: int, f=(0.0, 0.0, 1.0), m=(0.0, 0.0, 0.0), frame: str = "gel") -> Any:
    force, torque = (make("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, v), strict=True))) for v in (f, m))
    body = make("geometry_msgs/msg/Wrench", force=force, torque=torque)
    return make(WRENCH, header=header(stamp_ns, frame), wrench=body)


def cloud(
    stamp_ns: int,
    columns: dict[str, Any],
    *,
    kinds: dict[str, str] | None = None,
    order: str = "<",
    gap: int = 0,
    rows: int = 1,
    row_padding: int = 0,
) -> Any:
    """A PointCloud2 with ``gap`` unused bytes after every field, as several rows if wanted."""
    kinds = {name: "f4" for name in columns} | {"id": "u4"} | (kinds or {})
    formats = [order + kinds[name] for name in columns]
    sizes = [np.dtype(f).itemsize + gap for f in formats]
    offsets = np.concatenate(([0], np.cumsum(sizes)[:-1])).tolist()
    dtype = np.dtype({"names": list(columns), "formats": formats, "offsets": offsets, "itemsize": int(sum(sizes))})
    points = np.zeros(len(next(iter(columns.values()))), dtype=dtype)
    for name, values in columns.items():
        points[name] = values
    width = len(points) // rows
    raw = np.frombuffer(points.tobytes(), dtype=np.uint8).reshape(rows, width * dtype.itemsize)
    padded = np.pad(raw, ((0, 0), (0, row_padding)))
    return make(
        CLOUD,
        header=header(stamp_ns, "gel"),
        height=rows,
        width=width,
        fields=[
            make("sensor_msgs/msg/PointField", name=name, offset=int(at), datatype=KINDS[kinds[name]], count=1)
            for name, at in zip(columns, offsets, strict=True)
        ],
        is_bigendian=order == ">",
        point_step=dtype.itemsize,
        row_step=padded.shape[1],
        data=padded.reshape(-1),
        is_dense=False,
    )


def store(path: Path, items: list[Item]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        made: dict[str, Any] = {}
        for topic, msgtype, log_ns, message in items:
            if topic not in made:
                made[topic] = bag.add_connection(topic, msgtype, typestore=STORE)
            data = message if isinstance(message, bytes) else STORE.serialize_cdr(message, msgtype)
            bag.write(made[topic], log_ns, data)
    return path


def log_time(k: int) -> int:
    return START + 10 * MS * k


def poses(count: int = 20, **options: Any) -> list[Item]:
    return [
        ("/current_pose", POSE, log_time(k), pose(log_time(k), (1e-4 * k, 0, 0.1), **options)) for k in range(count)
    ]


def wrenches(count: int = 20, stamp: Callable[[int], int] = log_time, **options: Any) -> list[Item]:
    return [("/wrench", WRENCH, log_time(k), wrench(stamp(k), (0, 0, 0.1 * k), **options)) for k in range(count)]


def read(tmp_path: Path, items: list[Item], topics: TopicNames | None = None, **options: Any) -> Recording:
    return read_recording(store(tmp_path / "bag", items), topics, **options)


def notes(recording: Recording) -> str:
    return "\n".join(map(str, recording.notes))


# --- times -------------------------------------------------------------------------------------------


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
    with pytest.raises(RecordingError, match=r"/wrench: the stamps go back by .* at message 10 .*`time: log`"):
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


# --- what is needed ----------------------------------------------------------------------------------


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
    assert "/wrench: 2 messages dropped: the first cannot be read as geometry_msgs" in notes(recording)


def test_no_message_that_can_be_decoded(tmp_path: Path) -> None:
    items = [(*item[:3], b"\x00\x01\x00\x00\x01") for item in wrenches()]
    with pytest.raises(RecordingError, match="/wrench: none of 20 messages can be used"):
        read(tmp_path, poses() + items)


# --- frames ------------------------------------------------------------------------------------------


def test_mixed_frames_are_refused_unless_one_is_declared(tmp_path: Path) -> None:
    items = wrenches()
    items[3] = ("/wrench", WRENCH, log_time(3), wrench(log_time(3), frame="tool0"))
    path = store(tmp_path / "bag", poses() + items)
    with pytest.raises(RecordingError, match=r"more than one frame: 'gel' \(19 messages\), 'tool0'"):
        read_recording(path)
    recording = read_recording(path, TopicNames(wrench={"sensor": SensorTopic(frame_id="gel")}))
    assert len(recording.wrenches["sensor"]) == 19
    assert "messages of other frames than 'gel' dropped" in notes(recording)


def test_a_wrong_frame_is_refused(tmp_path: Path) -> None:
    topics = TopicNames(ee={"ee": EETopics(frame_id="world")})
    with pytest.raises(RecordingError, match=r"frame_id is 'base_link' .* declares 'world'"):
        read(tmp_path, poses() + wrenches(), topics)


def test_an_empty_frame_is_said(tmp_path: Path) -> None:
    assert "/wrench: frame_id is empty" in notes(read(tmp_path, poses() + wrenches(frame="")))


def test_measured_and_commanded_pose_in_different_frames(tmp_path: Path) -> None:
    items = [("/target_pose", POSE, t, pose(t, frame="world")) for t in map(log_time, range(20))]
    recording = read(tmp_path, poses() + items + wrenches())
    assert "/target_pose: in frame 'world' while /current_pose is in 'base_link'" in notes(recording)


# --- poses -------------------------------------------------------------------------------------------


def test_poses_with_nan_are_dropped(tmp_path: Path) -> None:
    items = poses()
    items[2] = ("/current_pose", POSE, log_time(2), pose(log_time(2), (np.nan, 0, 0)))
    items[3] = ("/current_pose", POSE, log_time(3), pose(log_time(3), q=(0, 0, 0, np.inf)))
    recording = read(tmp_path, items + wrenches())
    assert len(recording.poses["ee"]) == 18
    assert "/current_pose: 2 messages dropped: the first holds NaN or infinity" in notes(recording)


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


def test_a_zero_quaternion_is_refused(tmp_path: Path) -> None:
    items = poses()
    items[6] = ("/current_pose", POSE, log_time(6), pose(log_time(6), q=(0, 0, 0, 0)))
    with pytest.raises(RecordingError, match=r"1 orientation of 20 zero \(first at message 6"):
        read(tmp_path, items + wrenches())


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


# --- wrenches ----------------------------------------------------------------------------------------


def test_components_that_are_not_finite_are_masked(tmp_path: Path) -> None:
    items = wrenches(m=(np.nan, np.inf, 0.5))
    recording = read(tmp_path, poses() + items)
    stream = recording.wrenches["sensor"]
    np.testing.assert_array_equal(stream.mask, np.tile([True, True, True, False, False, True], (20, 1)))
    assert np.isnan(stream.torque[:, :2]).all() and (stream.torque[:, 2] == 0.5).all()
    assert "20 messages with NaN or infinite components, masked" in notes(recording)


def test_a_wrench_with_nothing_but_nan(tmp_path: Path) -> None:
    nan = (np.nan,) * 3
    items = [("/wrench", WRENCH, t, wrench(t, nan, nan)) for t in map(log_time, range(5))]
    with pytest.raises(RecordingError, match="every wrench holds only NaN"):
        read(tmp_path, poses() + items)


def test_torques_in_newton_millimetres_can_be_declared(tmp_path: Path) -> None:
    topics = TopicNames(wrench={"sensor": SensorTopic(length_unit="mm")})
    recording = read(tmp_path, poses() + wrenches(m=(5.0, 0, 0)), topics)
    np.testing.assert_allclose(recording.wrenches["sensor"].torque[:, 0], 0.005)
    np.testing.assert_allclose(recording.wrenches["sensor"].force[1, 2], 0.1)


def test_forces_of_another_unit_are_said(tmp_path: Path) -> None:
    items = [("/wrench", WRENCH, t, wrench(t, (0, 0, 2e4))) for t in map(log_time, range(5))]
    assert "looks like another unit than newton" in notes(read(tmp_path, poses() + items))


# --- markers and tracks ------------------------------------------------------------------------------

XYZ = {
    "x": np.array([0.0, 0.001, 0.002]),
    "y": np.array([0.0, 0.0, 0.001]),
    "z": np.array([0.003, 0.0, 0.0]),
}
IDS = np.array([4, 9, 2])


def markers(columns: Callable[[int], dict[str, Any]], count: int = 6, **options: Any) -> list[Item]:
    return [("/markers", CLOUD, t, cloud(t, columns(k), **options)) for k, t in enumerate(map(log_time, range(count)))]


def assert_markers(recording: Recording) -> None:
    stream = recording.markers["sensor"]
    np.testing.assert_array_equal(stream.ids, [2, 4, 9])
    expected = np.stack([XYZ[axis] for axis in "xyz"], axis=-1)[[2, 0, 1]]
    np.testing.assert_allclose(stream.position, np.tile(expected, (6, 1, 1)), rtol=1e-6)


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"order": ">"},
        {"gap": 3},
        {"rows": 3, "row_padding": 5},
        {"kinds": {"x": "f8", "y": "f8", "z": "f8", "id": "i2"}},
        {"kinds": {"id": "f4"}},
    ],
)
def test_layouts_of_a_cloud(tmp_path: Path, options: dict[str, Any]) -> None:
    recording = read(tmp_path, poses(6) + markers(lambda k: {**XYZ, "id": IDS}, **options))
    assert_markers(recording)
    assert recording.markers["sensor"].displacement is None
    assert recording.markers["sensor"].rest is None
    assert recording.notes == ()


def test_missing_rows_nan_and_doubled_ids(tmp_path: Path) -> None:
    def columns(k: int) -> dict[str, Any]:
        full = {**XYZ, "id": IDS.copy()}
        if k == 1:
            return {name: values[:2] for name, values in full.items()}
        if k == 2:
            full["y"] = np.array([0.0, np.nan, 0.001])
        if k == 3:
            full["id"][2] = 4
        return full

    recording = read(tmp_path, poses(6) + markers(columns))
    stream = recording.markers["sensor"]
    seen = np.isfinite(stream.position).all(axis=2)
    expected = np.ones((6, 3), dtype=bool)
    expected[1, 0] = expected[2, 2] = expected[3, 0] = False  # columns: ids 2, 4, 9
    np.testing.assert_array_equal(seen, expected)
    np.testing.assert_allclose(stream.position[3, 1], [0.0, 0.0, 0.003], rtol=1e-6)  # the first of two
    assert "1 point with NaN taken as missing markers" in notes(recording)
    assert "1 point with an id already used in its message dropped" in notes(recording)


def test_no_ids(tmp_path: Path) -> None:
    recording = read(tmp_path, poses(6) + markers(lambda k: XYZ))
    np.testing.assert_array_equal(recording.markers["sensor"].ids, [0, 1, 2])
    assert "markers are told apart by their row" in notes(recording)


def test_no_ids_and_a_varying_number_of_rows(tmp_path: Path) -> None:
    items = markers(lambda k: {name: v[: 3 - (k == 2)] for name, v in XYZ.items()})
    with pytest.raises(RecordingError, match="no field id, and from 2 to 3 rows"):
        read(tmp_path, poses(6) + items)


def test_ids_that_are_not_stable(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="18 different ids, but 3 markers a message"):
        read(tmp_path, poses(6) + markers(lambda k: {**XYZ, "id": IDS + 100 * k}))


def test_ids_that_are_not_whole(tmp_path: Path) -> None:
    items = markers(lambda k: {**XYZ, "id": IDS + 0.5}, kinds={"id": "f4"})
    with pytest.raises(RecordingError, match="not whole"):
        read(tmp_path, poses(6) + items)


def test_missing_fields(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"has no field z \(it has x, y, id\)"):
        read(tmp_path, poses(6) + markers(lambda k: {"x": XYZ["x"], "y": XYZ["y"], "id": IDS}))


def test_a_cloud_shorter_than_it_states(tmp_path: Path) -> None:
    items = markers(lambda k: {**XYZ, "id": IDS})
    items[2][3].data = items[2][3].data[:-8]
    recording = read(tmp_path, poses(6) + items)
    assert len(recording.markers["sensor"]) == 5
    assert "1 message dropped: the first holds 40 bytes where 1 x 3 points of 16" in notes(recording)


def test_markers_that_are_never_finite(tmp_path: Path) -> None:
    nan = {axis: np.full(3, np.nan) for axis in "xyz"}
    with pytest.raises(RecordingError, match="no message holds a finite marker"):
        read(tmp_path, poses(6) + markers(lambda k: {**nan, "id": IDS}))


def test_markers_in_millimetres_are_refused_and_can_be_declared(tmp_path: Path) -> None:
    in_mm = {axis: 1e3 * values for axis, values in XYZ.items()}
    path = store(tmp_path / "bag", poses(6) + markers(lambda k: {**in_mm, "id": IDS}))
    with pytest.raises(RecordingError, match=r"/markers: .*look like millimetres"):
        read_recording(path)
    topics = TopicNames(markers={"sensor": SensorTopic(length_unit="mm")})
    assert_markers(read_recording(path, topics))


def test_displacements_in_millimetres_are_refused(tmp_path: Path) -> None:
    moved = {"dx": np.zeros(3), "dy": np.zeros(3), "dz": np.array([0.0, 2.0, 0.0])}
    with pytest.raises(RecordingError, match="move by up to 2 m"):
        read(tmp_path, poses(6) + markers(lambda k: {**XYZ, **moved, "id": IDS}))


def tracks(columns: dict[str, Any], count: int = 6) -> list[Item]:
    return [("/marker_tracks", CLOUD, t, cloud(t, columns)) for t in map(log_time, range(count))]


UV = {"u": np.array([1.0, 20.0, 30.5]), "v": np.array([4.0, 5.0, 6.0])}


def test_tracks_without_confidence(tmp_path: Path) -> None:
    recording = read(tmp_path, poses(6) + tracks({**UV, "id": IDS}))
    stream = recording.tracks["camera"]
    np.testing.assert_array_equal(stream.confidence, 1.0)
    np.testing.assert_array_equal(stream.uv[0], [[30.5, 6.0], [1.0, 4.0], [20.0, 5.0]])
    assert stream.camera_info is None
    assert "no confidence given: taken as 1" in notes(recording)
    assert "no camera_info for camera 'camera'" in notes(recording)


def test_confidence_outside_its_range(tmp_path: Path) -> None:
    recording = read(tmp_path, poses(6) + tracks({**UV, "id": IDS, "confidence": np.array([-1.0, 0.5, 100.0])}))
    np.testing.assert_array_equal(recording.tracks["camera"].confidence[0], [1.0, 0.0, 0.5])
    assert "confidence from -1 to 100 limited to 0..1" in notes(recording)


def test_tracks_with_other_field_names(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"has no field u, v \(it has x, y, id\)"):
        read(tmp_path, poses(6) + tracks({"x": UV["u"], "y": UV["v"], "id": IDS}))


# --- cameras and images ------------------------------------------------------------------------------


def info(stamp_ns: int, focal: float = 300.0, model: str = "plumb_bob", d: Any = (0.0,) * 5) -> Any:
    k = np.array([focal, 0, 16, 0, focal, 12, 0, 0, 1.0]) if focal else np.zeros(9)
    return make(
        INFO,
        header=header(stamp_ns, "optical"),
        height=24,
        width=32,
        distortion_model=model,
        d=np.array(d, dtype=np.float64),
        k=k,
        r=np.zeros(9),
        p=np.zeros(12),
        binning_x=0,
        binning_y=0,
        roi=make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )


def with_info(*messages: Any) -> list[Item]:
    found = [("/camera_info", INFO, log_time(k), message) for k, message in enumerate(messages)]
    return poses(6) + tracks({**UV, "id": IDS, "confidence": np.ones(3)}) + found


def test_fisheye_calibration(tmp_path: Path) -> None:
    recording = read(tmp_path, with_info(info(START, model="equidistant", d=(0.1, 0, 0, 0))))
    camera = recording.tracks["camera"].camera_info
    assert camera is not None and camera.model == "equidistant"
    np.testing.assert_array_equal(camera.K, [[300, 0, 16], [0, 300, 12], [0, 0, 1]])
    assert (camera.width, camera.height, camera.frame_id) == (32, 24, "optical")
    assert recording.notes == ()


def test_a_camera_that_is_not_calibrated(tmp_path: Path) -> None:
    recording = read(tmp_path, with_info(info(START, focal=0.0, model="", d=())))
    assert recording.tracks["camera"].camera_info is None
    assert "K is zero: the camera is not calibrated" in notes(recording)


@pytest.mark.parametrize(
    ("messages", "fault"),
    [
        ([info(START), info(START + 1, focal=310.0)], "calibration changes"),
        ([info(START, model="pinhole")], "model 'pinhole' is not known"),
        ([info(START, model="equidistant")], "5 distortion coefficients for equidistant"),
        ([info(START, focal=-300.0)], "focal lengths -300"),
    ],
)
def test_calibrations_that_cannot_be_used(tmp_path: Path, messages: list[Any], fault: str) -> None:
    with pytest.raises(RecordingError, match=fault):
        read(tmp_path, with_info(*messages))


GREY = np.arange(24 * 32, dtype=np.uint32).reshape(24, 32).astype(np.uint8)
COLOUR = np.stack([GREY, GREY // 2, 255 - GREY], axis=-1)


def raw_image(stamp_ns: int, pixels: Any, encoding: str, padding: int = 0) -> Any:
    rows = np.pad(pixels.reshape(len(pixels), -1), ((0, 0), (0, padding)))
    return make(
        IMAGE,
        header=header(stamp_ns, "optical"),
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows.shape[1],
        data=rows.reshape(-1),
    )


def images(make_one: Callable[[int], Any], topic: str = "/image", msgtype: str = IMAGE) -> list[Item]:
    return [(topic, msgtype, t, make_one(t)) for t in map(log_time, range(3))]


@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [("mono8", GREY, GREY), ("rgb8", COLOUR, COLOUR), ("bgr8", COLOUR[..., ::-1], COLOUR)],
)
@pytest.mark.parametrize("padding", [0, 7])
def test_raw_images(tmp_path: Path, encoding: str, pixels: Any, expected: Any, padding: int) -> None:
    recording = read(tmp_path, poses() + images(lambda t: raw_image(t, pixels, encoding, padding)))
    found = list(recording.images["camera"])
    assert len(found) == 3
    for _, image in found:
        np.testing.assert_array_equal(image, expected)


def compressed(stamp_ns: int, data: bytes, fmt: str) -> Any:
    return make(COMPRESSED, header=header(stamp_ns, "optical"), format=fmt, data=np.frombuffer(data, dtype=np.uint8))


def test_raw_images_are_preferred_to_their_compressed_twins(tmp_path: Path) -> None:
    png = cv2.imencode(".png", GREY)[1].tobytes()
    items = images(lambda t: compressed(t, png, "png"), "/image/compressed", COMPRESSED)
    recording = read(tmp_path, poses() + items + images(lambda t: raw_image(t, GREY, "mono8")))
    assert recording.images["camera"].topic == "/image"
    assert "/image/compressed: not used: the raw image is in the recording" in notes(recording)


def test_images_are_read_on_demand_in_order_of_time(tmp_path: Path) -> None:
    stamps = {0: 0, 1: 2, 2: 1}
    items = [
        ("/image", IMAGE, log_time(k), raw_image(log_time(j), np.full((2, 2), k, np.uint8), "mono8"))
        for k, j in stamps.items()
    ]
    stream = read(tmp_path, poses() + items).images["camera"]
    assert [int(image[0, 0]) for _, image in stream] == [0, 2, 1]
    assert int(stream.image(1)[0, 0]) == 2


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (lambda t: raw_image(t, GREY, "bayer_rggb8"), "encoding 'bayer_rggb8'"),
        (lambda t: raw_image(t, GREY[:, :8], "rgb8"), "has 192 bytes where 24 rows of 8 bytes"),
    ],
)
def test_raw_images_that_cannot_be_used(tmp_path: Path, message: Any, fault: str) -> None:
    with pytest.raises(RecordingError, match=fault):
        read(tmp_path, poses() + images(message))


@pytest.mark.parametrize("data", [b"", b"no image at all", cv2.imencode(".png", GREY)[1].tobytes()[:20]])
def test_compressed_images_that_cannot_be_used(tmp_path: Path, data: bytes) -> None:
    items = images(lambda t: compressed(t, data, "png"), "/image/compressed", COMPRESSED)
    with pytest.raises(RecordingError, match="cannot be decoded"):
        read(tmp_path, poses() + items)


def test_sixteen_bit_images_are_refused(tmp_path: Path) -> None:
    png = cv2.imencode(".png", GREY.astype(np.uint16))[1].tobytes()
    items = images(lambda t: compressed(t, png, "png"), "/image/compressed", COMPRESSED)
    with pytest.raises(RecordingError, match="uint16 pixels"):
        read(tmp_path, poses() + items)
