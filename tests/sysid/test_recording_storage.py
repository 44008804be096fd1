"""Recordings as files: storages, splits, compression."""

import hashlib
import os
import shutil
import sqlite3
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import yaml
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from recording_files import COUNT, STORE, assert_whole, edit_metadata, notes, repack, rewrite, write
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionMode, Reader, StoragePlugin, Writer

from sim_core.errors import RecordingError
from sysid.recording import read_recording


def test_directory_file_and_metadata_path_read_alike(bag: Path) -> None:
    for path in (bag, bag / "press.mcap", bag / "metadata.yaml", str(bag)):
        recording = read_recording(path)
        assert_whole(recording)
        assert recording.notes == ()


def test_quality_of_service_in_the_metadata_loses_no_messages(bag: Path, tmp_path: Path) -> None:
    """A metadata.yaml that disagrees with the storage on QoS makes a directory reader skip the topics."""
    forever = QosTime(9223372036, 854775807)
    qos = Qos(
        QosHistory.KEEP_LAST, 5, QosReliability.RELIABLE, QosDurability.VOLATILE,
        forever, forever, QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip
    with Writer(tmp_path / "qos", version=9, storage_plugin=StoragePlugin.MCAP) as new, Reader(bag) as old:
        made = {
            c.topic: new.add_connection(c.topic, c.msgtype, typestore=STORE, offered_qos_profiles=[qos])
            for c in old.connections
        }
        for connection, stamp, raw in old.messages():
            new.write(made[connection.topic], stamp, raw)

    def empty(information: dict) -> None:
        for topic in information["topics_with_message_count"]:
            topic["topic_metadata"]["offered_qos_profiles"] = []

    edit_metadata(tmp_path / "qos", empty)
    with Reader(tmp_path / "qos") as trap:
        assert (sum(1 for _ in trap.messages()), trap.message_count) == (0, 2 * COUNT)
    recording = read_recording(tmp_path / "qos")
    assert_whole(recording)
    assert recording.notes == ()


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (plugin, mode)
        for plugin in StoragePlugin
        for mode in CompressionMode
        if (plugin, mode) != (StoragePlugin.SQLITE3, CompressionMode.STORAGE)
    ],
)
def test_storages_and_compressions(bag: Path, tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode) -> None:
    made = rewrite(bag, tmp_path / "made", plugin, mode)
    recording = read_recording(made)
    assert_whole(recording)
    assert recording.notes == ()
    assert recording.provenance.storage == plugin.name.lower()
    words = {"NONE": "", "STORAGE": "zstd", "FILE": "zstd file", "MESSAGE": "zstd message"}
    assert recording.provenance.compression == words[mode.name]
    (file,) = recording.provenance.files
    assert file.sha256 == hashlib.sha256((made / file.name).read_bytes()).hexdigest()
    assert_whole(read_recording(made / file.name))


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_of_another_mcap_writer(bag: Path, tmp_path: Path, compression: CompressionType) -> None:
    recording = read_recording(
        repack(bag / "press.mcap", tmp_path / "x.mcap", compression=compression, chunk_size=5000)
    )
    assert_whole(recording)
    assert recording.notes == ()


def test_unchunked_mcap(bag: Path, tmp_path: Path) -> None:
    recording = read_recording(repack(bag / "press.mcap", tmp_path / "x.mcap", use_chunking=False))
    assert_whole(recording)
    assert recording.notes == ()


def splits(folder: Path, suffix: str = "") -> Path:
    """A recording in twelve splits, so that part 10 sorts before part 2 by letters."""
    folder.mkdir()
    bounds = np.linspace(0, COUNT, 13).astype(int)
    names = [f"press_{k}.mcap" for k in range(12)]
    for name, a, b in zip(names, bounds[:-1], bounds[1:], strict=True):
        part = write(folder / "part", int(a), int(b))
        (part / "part.mcap").rename(folder / name)
        (part / "metadata.yaml").rename(folder / "metadata.yaml")
        part.rmdir()

    def whole(information: dict) -> None:
        information["relative_file_paths"] = names
        for topic in information["topics_with_message_count"]:
            topic["message_count"] = COUNT

    edit_metadata(folder, whole)
    return folder


def test_several_splits(tmp_path: Path) -> None:
    recording = read_recording(splits(tmp_path / "press"))
    assert_whole(recording)
    assert [file.name for file in recording.provenance.files] == [f"press_{k}.mcap" for k in range(12)]
    assert recording.notes == ()


def test_splits_without_metadata_are_read_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    folder = splits(tmp_path / "press")
    (folder / "metadata.yaml").unlink()
    recording = read_recording(folder)
    assert_whole(recording)
    assert [file.name for file in recording.provenance.files] == [f"press_{k}.mcap" for k in range(12)]
    assert "warning: metadata.yaml: missing or unusable; 12 storage files" in notes(recording)


def test_a_missing_split_is_said(tmp_path: Path) -> None:
    folder = splits(tmp_path / "press")
    (folder / "press_3.mcap").unlink()
    recording = read_recording(folder)
    assert "1 split of 12 missing: press_3.mcap" in notes(recording)
    assert "messages found where metadata.yaml counts 400" in notes(recording)
    assert "gap of" in notes(recording)


def test_all_splits_missing(bag: Path) -> None:
    (bag / "press.mcap").unlink()
    with pytest.raises(RecordingError, match=r"lists press\.mcap, of which none exists"):
        read_recording(bag)


def test_an_unlisted_file_is_said(bag: Path) -> None:
    shutil.copy(bag / "press.mcap", bag / "older.mcap")
    recording = read_recording(bag)
    assert_whole(recording)
    assert "files that it does not list are not read: older.mcap" in notes(recording)


@pytest.mark.parametrize("text", ["{[", "other: 1", "rosbag2_bagfile_information: {relative_file_paths: 3}", ""])
def test_unusable_metadata_falls_back_to_the_files(bag: Path, text: str) -> None:
    (bag / "metadata.yaml").write_text(text)
    recording = read_recording(bag)
    assert_whole(recording)
    assert "cannot be used" in notes(recording)


def test_missing_metadata(bag: Path) -> None:
    (bag / "metadata.yaml").unlink()
    recording = read_recording(bag)
    assert_whole(recording)
    assert "missing or unusable" in notes(recording)


def test_fewer_messages_than_the_metadata_counts_is_said(bag: Path) -> None:
    edit_metadata(bag, lambda i: i["topics_with_message_count"][0].update(message_count=COUNT + 5))
    assert "400 messages found where metadata.yaml counts 405" in notes(read_recording(bag))


def test_fewer_messages_than_the_summary_counts_is_said(bag: Path, tmp_path: Path) -> None:
    path = repack(bag / "press.mcap", tmp_path / "x.mcap", compression=CompressionType.NONE, use_chunking=False)
    content = path.read_bytes()
    # Overwrite the opcode of the last message by one that readers must skip (metadata).
    at = content.rfind(bytes([5]) + (22 + 84).to_bytes(8, "little"))
    assert at > 0
    path.write_bytes(content[:at] + bytes([12]) + content[at + 1 :])
    assert "799 messages found where the summary counts 800" in notes(read_recording(path))


def test_an_empty_file(bag: Path) -> None:
    (bag / "press.mcap").write_bytes(b"")
    with pytest.raises(RecordingError, match=r"press\.mcap is empty \(0 bytes\)"):
        read_recording(bag)


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_recording_without_messages(tmp_path: Path, plugin: StoragePlugin) -> None:
    with Writer(tmp_path / "bag", version=9, storage_plugin=plugin) as new:
        new.add_connection("/wrench", "geometry_msgs/msg/WrenchStamped", typestore=STORE)
    with pytest.raises(RecordingError, match="holds no messages"):
        read_recording(tmp_path / "bag")


def test_not_a_recording(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello, this is no bag")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with pytest.raises(RecordingError, match="no header line and readings"):
        read_recording(tmp_path / "notes.txt")
    (tmp_path / "notes.bin").write_bytes(b"\x00\x01 this is no bag")
    with pytest.raises(RecordingError, match="not an MCAP file"):
        read_recording(tmp_path / "notes.bin")
    with pytest.raises(RecordingError, match=r"ROS 1 bag.*rosbags-convert"):
        read_recording(tmp_path / "old" / "old.bag")
    with pytest.raises(RecordingError, match=r"is a folder of 1 recording, not a recording\. Give .*old\."):
        read_recording(tmp_path)
    shutil.rmtree(tmp_path / "old")
    with pytest.raises(RecordingError, match="it holds no metadata"):
        read_recording(tmp_path)
    (tmp_path / "metadata.yaml").write_text("nothing: of a bag\n")
    with pytest.raises(RecordingError, match=r"it holds a metadata\.yaml that lists nothing"):
        read_recording(tmp_path)


def test_a_ros1_profile_is_refused(tmp_path: Path) -> None:
    buffer = BytesIO()
    writer = McapWriter(buffer)
    writer.start(profile="ros1", library="test")
    writer.finish()
    (tmp_path / "x.mcap").write_bytes(buffer.getvalue())
    with pytest.raises(RecordingError, match="holds ROS 1 messages"):
        read_recording(tmp_path / "x.mcap")


def test_a_folder_of_recordings(bag: Path) -> None:
    with pytest.raises(RecordingError, match=r"folder of 1 recording.*press"):
        read_recording(bag.parent)


def test_a_path_that_does_not_exist(bag: Path) -> None:
    with pytest.raises(RecordingError, match="Did you mean 'press'"):
        read_recording(bag.parent / "pres")
    with pytest.raises(RecordingError, match="does not exist either"):
        read_recording(bag.parent / "nowhere" / "press")


def test_permission_denied(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    original = Path.open

    def refuse(self: Path, *args, **kwargs):
        if self.suffix == ".mcap":
            raise PermissionError(13, "Permission denied", str(self))
        return original(self, *args, **kwargs)

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(RecordingError, match=r"press\.mcap cannot be opened: permission denied.*chmod"):
        read_recording(bag)


def test_permission_denied_on_the_folder(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: Path):
        raise PermissionError(13, "Permission denied", str(self))

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(RecordingError, match="press cannot be opened: permission denied"):
        read_recording(bag)


def test_a_database_that_is_no_recording(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "x.db3") as db:
        db.execute("CREATE TABLE people (name TEXT)")
    with pytest.raises(RecordingError, match="no such table: topics"):
        read_recording(tmp_path / "x.db3")


def test_messages_left_in_a_database_journal_are_said(bag: Path, tmp_path: Path) -> None:
    made = rewrite(bag, tmp_path / "made", StoragePlugin.SQLITE3, CompressionMode.NONE)
    (made / "made.db3-wal").write_bytes(b"x" * 100)
    assert "made.db3-wal next to it holds messages" in notes(read_recording(made))


def test_an_old_database_without_quality_of_service(bag: Path, tmp_path: Path) -> None:
    """Bags of the first ROS 2 releases have four columns of topics and no further tables."""
    made = rewrite(bag, tmp_path / "made", StoragePlugin.SQLITE3, CompressionMode.NONE)
    db = sqlite3.connect(tmp_path / "old.db3")
    db.execute("ATTACH DATABASE ? AS new", (str(made / "made.db3"),))
    db.execute("CREATE TABLE topics AS SELECT id, name, type, serialization_format FROM new.topics")
    db.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
    db.execute("INSERT INTO messages SELECT * FROM new.messages")
    db.commit()
    db.close()
    assert_whole(read_recording(tmp_path / "old.db3"))


def test_reading_changes_nothing(bag: Path) -> None:
    before = {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in bag.iterdir()}
    read_recording(bag)
    assert {p.name: (p.read_bytes(), p.stat().st_mtime_ns) for p in bag.iterdir()} == before


@pytest.mark.parametrize("listed", ["C:\\data\\run\\press.mcap", "/home/me/bags/press.mcap"])
def test_metadata_may_list_paths_of_another_machine(bag: Path, listed: str) -> None:
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    content["rosbag2_bagfile_information"]["relative_file_paths"] = [listed]
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
    assert len(read_recording(bag).poses["ee"]) == COUNT


def test_metadata_may_list_a_file_before_it_was_compressed(bag: Path) -> None:
    plain = bag / "press.mcap"
    (bag / "press.mcap.zstd").write_bytes(zstandard.ZstdCompressor().compress(plain.read_bytes()))
    plain.unlink()
    recording = read_recording(bag)
    assert len(recording.poses["ee"]) == COUNT and "missing" not in " ".join(map(str, recording.notes))


@pytest.mark.parametrize("what", ["device", "pipe"])
def test_what_is_no_file_is_refused_at_once(tmp_path: Path, what: str) -> None:
    path = Path("/dev/null")
    if what == "pipe":
        path = tmp_path / "pipe"
        os.mkfifo(path)
    with pytest.raises(RecordingError, match="is neither a file nor a folder"):
        read_recording(path)
