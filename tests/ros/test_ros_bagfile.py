"""The recorder's bag file. Needs no ROS."""

import shutil
import zlib
from pathlib import Path

import pytest
import yaml
import zstandard
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader

from sim_core.errors import RecordingError
from sysid.recording import read_recording
from thinshell_ros.bagfile import TYPESTORE, BagFile
from thinshell_ros.losses import Losses

POSE = "geometry_msgs/msg/PoseStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"


def pose(t_ns: int) -> bytes:
    kinds = TYPESTORE.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    message = kinds[POSE](
        header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link"),
        pose=kinds["geometry_msgs/msg/Pose"](
            position=kinds["geometry_msgs/msg/Point"](x=0.0, y=0.0, z=1e-12 * t_ns),
            orientation=kinds["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        ),
    )
    return bytes(TYPESTORE.serialize_cdr(message, POSE))


def wrench(t_ns: int) -> bytes:
    kinds = TYPESTORE.types
    stamp = kinds["builtin_interfaces/msg/Time"](sec=t_ns // 10**9, nanosec=t_ns % 10**9)
    three = kinds["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=-1.0)
    message = kinds[WRENCH](
        header=kinds["std_msgs/msg/Header"](stamp=stamp, frame_id="cell"),
        wrench=kinds["geometry_msgs/msg/Wrench"](force=three, torque=three),
    )
    return bytes(TYPESTORE.serialize_cdr(message, WRENCH))


def fill(bag: BagFile, start: int, count: int) -> None:
    for k in range(start, start + count):
        t = 10**9 + 10_000_000 * k
        bag.write("/current_pose", t, pose(t))
        bag.write("/wrench", t, wrench(t))


def begin(path: Path) -> BagFile:
    bag = BagFile(path, {"rig": "name: test"})
    bag.add("/current_pose", POSE)
    bag.add("/wrench", WRENCH)
    return bag


def test_a_finished_bag_reads_back(tmp_path: Path) -> None:
    bag = begin(tmp_path / "bag")
    for k in range(5):
        fill(bag, 20 * k, 20)
        bag.flush()
        bag.flush()
    assert bag.close()
    assert bag.close(), "closing twice is closing once"
    recording = read_recording(tmp_path / "bag")
    assert recording.provenance.message_counts == {"/current_pose": 100, "/wrench": 100} == bag.counts
    assert not recording.warnings
    assert "name: test" in (tmp_path / "bag" / "metadata.yaml").read_text()


def test_what_was_flushed_before_a_crash_reads_back(tmp_path: Path) -> None:
    bag = begin(tmp_path / "bag")
    fill(bag, 0, 30)
    bag.flush()
    fill(bag, 30, 10)
    shutil.copytree(tmp_path / "bag", tmp_path / "crashed")
    bag.close()
    recording = read_recording(tmp_path / "crashed")
    assert recording.provenance.message_counts == {"/current_pose": 30, "/wrench": 30}
    assert any("cut short" in note.text for note in recording.warnings)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(RecordingError, match="exists already"):
        BagFile(tmp_path / "bag")


def test_a_bag_without_messages_is_not_kept(tmp_path: Path) -> None:
    bag = begin(tmp_path / "bag")
    assert not bag.close()
    assert not (tmp_path / "bag").exists()


def test_a_folder_that_cannot_be_created_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordingError, match="cannot be created"):
        BagFile(tmp_path / "file" / "bag")


def test_a_type_that_is_not_known_is_refused(tmp_path: Path) -> None:
    bag = begin(tmp_path / "bag")
    with pytest.raises(RecordingError, match="odd_msgs/msg/Odd"):
        bag.add("/odd", "odd_msgs/msg/Odd")
    bag.close()


def test_a_full_disk_is_an_error_and_keeps_what_came_before(tmp_path: Path) -> None:
    bag = begin(tmp_path / "bag")
    fill(bag, 0, 10)
    bag.flush()
    fill(bag, 10, 10)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    assert bag._bag.storage is not None
    bag._bag.storage.close_chunk = full  # type: ignore[attr-defined]
    with pytest.raises(RecordingError, match="No space left"):
        bag.flush()
    assert bag.close()
    assert read_recording(tmp_path / "bag").provenance.message_counts["/wrench"] == 10


def test_chunks_are_compressed_and_have_their_checksum(tmp_path: Path) -> None:
    bag = begin(tmp_path / "bag")
    fill(bag, 0, 30)
    bag.flush()
    fill(bag, 30, 30)
    bag.close()
    (file,) = (tmp_path / "bag").glob("*.mcap")
    with file.open("rb") as stream:
        chunks = [record for record in StreamReader(stream, emit_chunks=True).records if isinstance(record, Chunk)]
    assert [chunk.compression for chunk in chunks] == ["zstd"] * 2
    for chunk in chunks:
        assert (
            chunk.uncompressed_crc
            == zlib.crc32(zstandard.ZstdDecompressor().decompressobj().decompress(chunk.data))
            != 0
        )


def test_splits_are_files_of_one_bag(tmp_path: Path) -> None:
    bag = BagFile(tmp_path / "bag", max_size=3000)
    bag.add("/current_pose", POSE)
    bag.add("/wrench", WRENCH)
    for k in range(6):
        fill(bag, 40 * k, 40)
        bag.flush()
    bag.close()
    files = sorted(file.name for file in (tmp_path / "bag").glob("*.mcap"))
    assert len(files) > 2
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert information["relative_file_paths"] == files
    assert sum(file["message_count"] for file in information["files"]) == information["message_count"] == 480
    recording = read_recording(tmp_path / "bag")
    assert recording.provenance.message_counts == {"/current_pose": 240, "/wrench": 240}
    assert len(recording.poses["ee"]) == 240
    with Reader(tmp_path / "bag") as reader:
        assert sum(1 for _ in reader.messages()) == 480


def test_lost_messages_are_counted_by_the_numbers_of_their_publisher() -> None:
    losses = Losses()
    for number in (5, 6, 9, 10, 1, 2, 4):
        losses.take("/wrench", number)
    losses.take("/pose", None)
    assert losses.counts == {"/wrench": 3}, "7, 8, and 3 of a publisher that was started again"
    losses.publishers("/wrench", 2)
    losses.take("/wrench", 100)
    assert losses.counts == {}, "with two publishers it is not known"
