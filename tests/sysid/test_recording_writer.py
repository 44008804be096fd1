"""Writing a recording and reading it back."""

import hashlib
import pickle
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import RecordingError
from sysid.recording import RecordingWriter, read_recording

MS = 1_000_000
START = 5_000_000_000
K = np.array([[300.0, 0.0, 16.0], [0.0, 310.0, 12.0], [0.0, 0.0, 1.0]])


def unit_quaternions(count: int) -> np.ndarray:
    half = np.linspace(0.0, 0.4, count)
    return np.stack([0.0 * half, np.sin(half), 0.0 * half, np.cos(half)], axis=1)


def make_data(count: int = 7, markers: int = 5) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    rest = (0.001 * np.arange(3 * markers).reshape(markers, 3)).astype(np.float32).astype(np.float64)
    moved = (rest + 1e-4 * rng.standard_normal((count, markers, 3))).astype(np.float32).astype(np.float64)
    moved[2, 3] = np.nan
    uv = (100.0 * rng.random((count, markers, 2))).astype(np.float32).astype(np.float64)
    uv[4, 0] = np.nan
    image = rng.integers(0, 256, (count, 24, 32, 3), dtype=np.uint8)
    return {
        "position": 1e-3 * rng.standard_normal((count, 3)),
        "quaternion": unit_quaternions(count),
        "force": rng.standard_normal((count, 3)),
        "torque": 0.01 * rng.standard_normal((count, 3)),
        "rest": rest,
        "moved": moved,
        "nodal": rng.standard_normal((count, markers, 3)).astype(np.float32).astype(np.float64),
        "uv": uv,
        "image": image,
    }


def write(path: Path, data: dict[str, np.ndarray], *, backwards: bool = False) -> Path:
    count, ids = len(data["position"]), np.array([2, 3, 5, 7, 11])
    order = range(count - 1, -1, -1) if backwards else range(count)
    with RecordingWriter(path) as bag:
        bag.camera_info("cam/camera_info", START, K, [0.1, 0, 0, 0, 0], "plumb_bob", 32, 24, "optical")
        for k in order:
            t = START + 10 * MS * k
            bag.pose("current_pose", t, data["position"][k], data["quaternion"][k], "base_link")
            bag.pose("target_pose", t + MS, data["position"][k] + 1e-3, data["quaternion"][k], "base_link")
            bag.wrench("tactile/left/wrench", t, data["force"][k], data["torque"][k], "gel")
            bag.markers("tactile/left/markers", t, data["moved"][k], data["rest"], ids, "gel", forces=data["nodal"][k])
            bag.tracks("cam/marker_tracks", t, data["uv"][k], ids, np.full(5, 0.5), "optical")
            bag.image_compressed("cam/image/compressed", t, data["image"][k], "optical")
    return path


def test_round_trip_is_exact(tmp_path: Path) -> None:
    data = make_data()
    recording = read_recording(write(tmp_path / "bag", data))
    t = 0.01 * np.arange(7)
    assert recording.t0_ns == START
    np.testing.assert_array_equal(
        START + np.round(recording.poses["ee"].t * 1e9).astype(np.int64), START + 10 * MS * np.arange(7)
    )
    np.testing.assert_array_equal(recording.poses["ee"].position, data["position"])
    np.testing.assert_array_equal(recording.poses["ee"].quaternion, data["quaternion"])
    assert recording.poses["ee"].topic == "/current_pose"
    assert recording.poses["ee"].frame_id == "base_link"
    np.testing.assert_array_equal(recording.target_poses["ee"].position, data["position"] + 1e-3)
    np.testing.assert_allclose(recording.target_poses["ee"].t, t + 1e-3, rtol=0, atol=1e-15)
    wrench = recording.wrenches["sensor"]
    np.testing.assert_array_equal(wrench.force, data["force"])
    np.testing.assert_array_equal(wrench.torque, data["torque"])
    assert wrench.mask.shape == (7, 6) and wrench.mask.all()
    markers = recording.markers["sensor"]
    np.testing.assert_array_equal(markers.ids, [2, 3, 5, 7, 11])
    np.testing.assert_array_equal(markers.position, data["moved"])
    assert markers.force is not None and markers.rest is not None
    seen = np.isfinite(data["moved"][:, :, 0])
    np.testing.assert_array_equal(markers.force[seen], data["nodal"][seen])
    assert np.isnan(markers.force[~seen]).all()
    np.testing.assert_allclose(markers.rest, data["rest"], rtol=0, atol=1e-9)
    tracks = recording.tracks["camera"]
    np.testing.assert_array_equal(tracks.uv, data["uv"])
    np.testing.assert_array_equal(tracks.confidence, np.where(np.isfinite(data["uv"][:, :, 0]), 0.5, 0.0))
    assert tracks.camera_info is not None
    np.testing.assert_array_equal(tracks.camera_info.K, K)
    np.testing.assert_array_equal(tracks.camera_info.D, [0.1, 0, 0, 0, 0])
    assert (tracks.camera_info.model, tracks.camera_info.width, tracks.camera_info.height) == (
        "plumb_bob",
        32,
        24,
    )
    images = recording.images["camera"]
    assert [t for t, _ in images] == images.t.tolist()
    np.testing.assert_array_equal(np.stack([image for _, image in images]), data["image"])
    np.testing.assert_array_equal(images.image(5), data["image"][5])
    assert recording.notes == ()
    assert recording.duration == pytest.approx(0.061)


def test_provenance_names_files_counts_and_checksums(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", make_data())
    source = read_recording(path).provenance
    content = (path / "bag.mcap").read_bytes()
    (file,) = source.files
    assert (file.name, file.sha256, file.size) == (
        "bag.mcap",
        hashlib.sha256(content).hexdigest(),
        len(content),
    )
    assert source.message_counts["/current_pose"] == 7
    assert source.message_counts["/cam/camera_info"] == 1
    assert source.topic_types["/tactile/left/markers"] == "sensor_msgs/msg/PointCloud2"
    assert (source.storage, source.compression, source.path) == ("mcap", "", str(path))


def test_same_calls_give_the_same_bytes(tmp_path: Path) -> None:
    data = make_data()
    first, second = write(tmp_path / "a" / "bag", data), write(tmp_path / "b" / "bag", data)
    names = sorted(file.name for file in first.iterdir())
    assert names == ["bag.mcap", "metadata.yaml"]
    for name in names:
        assert (first / name).read_bytes() == (second / name).read_bytes()


def test_messages_are_stored_in_order_of_time(tmp_path: Path) -> None:
    data = make_data()
    path = write(tmp_path / "bag", data, backwards=True)
    with Reader(path) as bag:
        per_file = [stamp for _, stamp, _ in bag.messages()]
    assert per_file == sorted(per_file)
    with (path / "bag.mcap").open("rb") as file:
        stored = [m.log_time for _, _, m in make_reader(file).iter_messages(log_time_order=False)]
    assert stored == sorted(stored)
    np.testing.assert_array_equal(read_recording(path).poses["ee"].position, data["position"])


def test_marker_cloud_has_the_layout_of_the_contract(tmp_path: Path) -> None:
    path = write(tmp_path / "bag", make_data())
    store = get_typestore(Stores.ROS2_JAZZY)
    clouds = {}
    with Reader(path) as bag:
        for connection, _, raw in bag.messages():
            if connection.topic == "/tactile/left/markers":
                clouds[len(clouds)] = store.deserialize_cdr(raw, connection.msgtype)
    cloud = clouds[0]
    assert [(f.name, f.offset, f.datatype) for f in cloud.fields] == [
        *((name, 4 * k, 7) for k, name in enumerate(["x", "y", "z", "dx", "dy", "dz", "fx", "fy", "fz"])),
        ("id", 36, 6),
    ]
    assert (cloud.point_step, cloud.height, cloud.width, cloud.row_step) == (40, 1, 5, 200)
    assert cloud.is_dense and not cloud.is_bigendian
    assert clouds[2].width == 4  # the lost marker is a missing row


def test_cloud_without_forces_is_not_dense(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "bag") as bag:
        for k in range(2):
            bag.pose("target_pose", k, (0, 0, 0), (0, 0, 0, 1), "base_link")
            bag.markers("markers", k, np.ones((2, 3)), np.ones((2, 3)), [0, 1], "gel")
    recording = read_recording(tmp_path / "bag")
    assert recording.markers["sensor"].force is None
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(tmp_path / "bag") as bag:
        (first, *_) = [store.deserialize_cdr(raw, c.msgtype) for c, _, raw in bag.messages() if c.topic == "/markers"]
    assert not first.is_dense


def test_an_existing_path_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(RecordingError, match="exists already"):
        RecordingWriter(tmp_path / "bag")


def test_a_path_taken_meanwhile_is_not_overwritten(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="exists already"):
        with RecordingWriter(tmp_path / "bag") as bag:
            bag.pose("target_pose", 0, (0, 0, 0), (0, 0, 0, 1), "base_link")
            (tmp_path / "bag").mkdir()
    assert list((tmp_path / "bag").iterdir()) == []
    assert [p.name for p in tmp_path.iterdir()] == ["bag"]


def test_an_exception_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        with RecordingWriter(tmp_path / "bag") as bag:
            bag.pose("target_pose", 0, (0, 0, 0), (0, 0, 0, 1), "base_link")
            raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_nothing_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="nothing was written"):
        with RecordingWriter(tmp_path / "bag"):
            pass
    assert list(tmp_path.iterdir()) == []


def test_writing_outside_the_block_is_an_error(tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "bag")
    with pytest.raises(RecordingError, match="not open"):
        writer.pose("target_pose", 0, (0, 0, 0), (0, 0, 0, 1), "base_link")


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda b: b.pose("p", 0, (0, 0, np.nan), (0, 0, 0, 1), "f"), "finite position"),
        (lambda b: b.pose("p", 0, (0, 0, 0), (0, 0, 0, 2), "f"), "unit quaternion"),
        (lambda b: b.pose("p", 0, (0, 0), (0, 0, 0, 1), "f"), "position has the shape"),
        (lambda b: b.pose("p", -1, (0, 0, 0), (0, 0, 0, 1), "f"), "stamp -1 ns"),
        (lambda b: b.wrench("p", 0, (0, 0, 0), (0, 0, 0), "f"), "already holds"),
        (lambda b: b.markers("m", 0, np.ones((2, 3)), np.ones((1, 3)), [0, 1], "f"), "1 rest positions"),
        (lambda b: b.markers("m", 0, np.ones((2, 3)), np.ones((2, 3)), [1, 1], "f"), "each once"),
        (lambda b: b.tracks("t", 0, np.ones((1, 2)), [0], [1.5], "f"), "confidence from 1.5"),
        (lambda b: b.tracks("t", 0, np.ones((1, 2)), [-1], [1.0], "f"), "whole numbers"),
        (lambda b: b.camera_info("c", 0, np.eye(4)[:, :3], [], "plumb_bob", 1, 1, "f"), "3 x 3"),
        (lambda b: b.image_compressed("i", 0, np.ones((2, 2)), "f"), "uint8"),
        (lambda b: b.image_compressed("i", 0, b"x", "f", fmt="bmp"), "'bmp'"),
    ],
)
def test_input_outside_the_contract_is_refused(tmp_path: Path, call, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        with RecordingWriter(tmp_path / "bag") as bag:
            bag.pose("p", 0, (0, 0, 0), (0, 0, 0, 1), "base_link")
            call(bag)
    assert list(tmp_path.iterdir()) == []


def test_slice_keeps_the_zero_and_cuts_every_stream(tmp_path: Path) -> None:
    data = make_data()
    recording = read_recording(write(tmp_path / "bag", data))
    part = recording.slice(0.02, 0.04)
    np.testing.assert_allclose(part.poses["ee"].t, [0.02, 0.03])
    np.testing.assert_array_equal(part.markers["sensor"].position, data["moved"][2:4])
    np.testing.assert_array_equal(part.wrenches["sensor"].mask, np.ones((2, 6), dtype=bool))
    np.testing.assert_array_equal(part.images["camera"].image(1), data["image"][3])
    assert part.t0_ns == recording.t0_ns
    with pytest.raises(RecordingError, match="no sample"):
        recording.slice(10.0, 11.0)
    with pytest.raises(RecordingError, match="empty"):
        recording.slice(1.0, 1.0)


def test_summary_lists_streams_and_notes(tmp_path: Path) -> None:
    data = make_data()
    data["force"][1, 2] = np.nan
    text = read_recording(write(tmp_path / "bag", data)).summary()
    for word in ("mcap", "/current_pose", "target pose", "/tactile/left/wrench", "100", "warning: "):
        assert word in text


def test_a_recording_can_be_sent_to_another_process(tmp_path: Path) -> None:
    data = make_data()
    recording = pickle.loads(pickle.dumps(read_recording(write(tmp_path / "bag", data))))
    np.testing.assert_array_equal(recording.images["camera"].image(6), data["image"][6])


def test_jpeg_and_ready_made_bytes(tmp_path: Path) -> None:
    grey = np.tile(np.arange(32, dtype=np.uint8) * 8, (24, 1))
    with RecordingWriter(tmp_path / "bag") as bag:
        for k in range(2):
            bag.pose("target_pose", k, (0, 0, 0), (0, 0, 0, 1), "base_link")
            bag.image_compressed("image/compressed", k, grey, "optical", fmt="jpeg")
    image = read_recording(tmp_path / "bag").images["camera"].image(0)
    assert image.shape == (24, 32)
    assert np.abs(image.astype(int) - grey).max() <= 8


def test_other_tools_open_what_is_written_under_its_name(tmp_path: Path) -> None:
    data = make_data()
    folder, file = write(tmp_path / "run", data), write(tmp_path / "run.mcap", data)
    assert file.is_file()
    for path in (folder, file):
        with AnyReader([path]) as reader:
            assert reader.message_count == sum(read_recording(path).provenance.message_counts.values()) > 0
    for name in ("run.bag", "run.db3"):
        with pytest.raises(RecordingError, match=r"Name a folder, .*run, or a single file, .*run\.mcap"):
            RecordingWriter(tmp_path / name)
