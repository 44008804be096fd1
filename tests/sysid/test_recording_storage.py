"""Recordings as files: storages, splits, compression, damage."""

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
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import RecordingError
from sysid.recording import Recording, RecordingWriter, read_recording

COUNT = 400
MS = 1_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)


def write(path: Path, start: int = 0, stop: int = COUNT) -> Path:
    with RecordingWriter(path) as bag:
        for k in range(start, stop):
            t = 10 * MS * (k + 1)
            bag.pose("current_pose", t, (1e-5 * k, 0, 0.1), (0, 0, 0, 1), "base_link")
            bag.wrench("wrench", t, (0, 0, 0.01 * k), (0, 0, 0), "gel")
    return path


@pytest.fixture(scope="module")
def healthy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("bags") / "press")


@pytest.fixture
def bag(healthy: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(healthy, tmp_path / "press"))


def rewrite(source: Path, target: Path, plugin: StoragePlugin, mode: CompressionMode) -> Path:
    """Write a recording again with another storage or compression."""
    writer = Writer(target, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with Reader(source) as old, writer as new:
        made = {c.topic: new.add_connection(c.topic, c.msgtype, typestore=STORE) for c in old.connections}
        for connection, stamp, raw in old.messages():
            new.write(made[connection.topic], stamp, raw)
    return target


def repack(source: Path, target: Path, **options) -> Path:
    """Write an .mcap file again with the mcap library."""
    with source.open("rb") as old, target.open("wb") as new:
        writer = McapWriter(new, **options)
        writer.start(profile="ros2", library="test")
        ids: dict[str, int] = {}
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            if channel.topic not in ids:
                ids[channel.topic] = writer.register_channel(
                    channel.topic, "cdr", writer.register_schema(schema.name, schema.encoding, schema.data)
                )
            writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    return target


def assert_whole(recording: Recording) -> None:
    np.testing.assert_array_equal(recording.poses["ee"].position[:, 0], 1e-5 * np.arange(COUNT))
    np.testing.assert_array_equal(recording.wrenches["sensor"].force[:, 2], 0.01 * np.arange(COUNT))


def notes(recording: Recording) -> str:
    return "\n".join(map(str, recording.notes))


def edit_metadata(bag: Path, change) -> None:
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    change(content["rosbag2_bagfile_information"])
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))


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
    assert "files beside the listed ones are not read: older.mcap" in notes(recording)


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


@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.STORAGE])
@pytest.mark.parametrize("part", [0.3, 0.5, 0.7])
def test_a_truncated_file_is_read_up_to_the_cut(bag: Path, tmp_path: Path, mode: CompressionMode, part: float) -> None:
    """The plain recording is a single chunk: nothing would be left without reading inside a cut one."""
    path = rewrite(bag, tmp_path / "made", StoragePlugin.MCAP, mode) / "made.mcap"
    content = path.read_bytes()
    if mode == CompressionMode.STORAGE:
        path = repack(path, tmp_path / "x.mcap", compression=CompressionType.ZSTD, chunk_size=20_000)
        content = path.read_bytes()
    cut = content[: int(part * len(content))]
    path.write_bytes(cut)
    with pytest.raises(Exception, match="magic"):
        Reader(path).open()
    recording = read_recording(path)
    count = len(recording.poses["ee"])
    assert 0.1 * COUNT < count < COUNT
    np.testing.assert_array_equal(recording.poses["ee"].position[:, 0], 1e-5 * np.arange(count))
    assert "cut short" in notes(recording) and "recovered" in notes(recording)
    assert path.read_bytes() == cut


def test_a_missing_last_byte_costs_nothing(bag: Path) -> None:
    path = bag / "press.mcap"
    path.write_bytes(path.read_bytes()[:-9])
    recording = read_recording(bag)
    assert_whole(recording)
    assert "cut short" in notes(recording)


def test_a_truncated_compressed_file(bag: Path, tmp_path: Path) -> None:
    made = rewrite(bag, tmp_path / "made", StoragePlugin.MCAP, CompressionMode.NONE)
    plain = (made / "made.mcap").read_bytes()
    packed = b"".join(zstandard.ZstdCompressor().compress(plain[k : k + 20_000]) for k in range(0, len(plain), 20_000))
    (tmp_path / "cut.mcap.zstd").write_bytes(packed[: len(packed) // 2])
    recording = read_recording(tmp_path / "cut.mcap.zstd")
    assert 20 < len(recording.poses["ee"]) < COUNT
    assert "the compressed file is cut short" in notes(recording)


def test_nothing_left_to_recover(bag: Path) -> None:
    path = bag / "press.mcap"
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(RecordingError, match="no messages that can be read: the file is cut short"):
        read_recording(bag)


def test_a_damaged_chunk_is_left_out(bag: Path, tmp_path: Path) -> None:
    path = repack(bag / "press.mcap", tmp_path / "x.mcap", compression=CompressionType.NONE, chunk_size=20_000)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    recording = read_recording(path)
    assert 0.5 * COUNT < len(recording.poses["ee"]) < COUNT
    assert "damaged and left out (chunk checksum does not agree)" in notes(recording)
    assert "messages found where the summary counts 800" in notes(recording)


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
    with pytest.raises(RecordingError, match="not an MCAP file"):
        read_recording(tmp_path / "notes.txt")
    with pytest.raises(RecordingError, match=r"ROS 1 bag.*rosbags-convert"):
        read_recording(tmp_path / "old" / "old.bag")
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


def test_a_truncated_database(bag: Path, tmp_path: Path) -> None:
    made = rewrite(bag, tmp_path / "made", StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = made / "made.db3"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(RecordingError, match=r"not a readable rosbag2 database.*\.recover"):
        read_recording(made)


def test_a_database_that_is_no_recording(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "x.db3") as db:
        db.execute("CREATE TABLE people (name TEXT)")
    with pytest.raises(RecordingError, match="no such table: topics"):
        read_recording(tmp_path / "x.db3")


def test_messages_left_in_a_database_journal_are_said(bag: Path, tmp_path: Path) -> None:
    made = rewrite(bag, tmp_path / "made", StoragePlugin.SQLITE3, CompressionMode.NONE)
    (made / "made.db3-wal").write_bytes(b"x" * 100)
    assert "made.db3-wal beside it holds messages" in notes(read_recording(made))


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


ROOT = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SHARED = ROOT / "faults" / "damaged_records"


def unchunked(source: Path, target: Path) -> Path:
    """The records of an .mcap file one by one, without chunks."""
    return repack(source, target, use_chunking=False)


def records(path: Path, opcode: int) -> list[tuple[int, int]]:
    """Where the contents of records of a kind begin and end."""
    data, at, found = path.read_bytes(), 8, []
    while at + 9 <= len(data):
        kind, length = data[at], int.from_bytes(data[at + 1 : at + 9], "little")
        if kind == opcode:
            found.append((at + 9, at + 9 + length))
        at += 9 + length
    return found


MESSAGE, SCHEMA, CHANNEL, STATISTICS, HEADER = 5, 3, 4, 11, 1


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (SCHEMA, "the schema record at byte"),
        (CHANNEL, "the channel record at byte"),
        (STATISTICS, "the statistics record at byte"),
        (HEADER, "the header record is damaged"),
    ],
)
def test_one_damaged_record_loses_itself_alone(bag: Path, tmp_path: Path, kind: int, said: str) -> None:
    """Its first text or list says that it is longer than the record. Schemas and channels stand in the summary too."""
    path = unchunked(bag / "press.mcap", tmp_path / "press.mcap")
    data = bytearray(path.read_bytes())
    at = records(path, kind)[0][0] + {SCHEMA: 2, CHANNEL: 4, STATISTICS: 42, HEADER: 0}[kind]
    data[at : at + 4] = (2**31).to_bytes(4, "little")
    path.write_bytes(data)
    recording = read_recording(path)
    assert len(recording.poses["ee"]) == len(recording.wrenches["sensor"]) == COUNT
    assert any(said in note.text for note in recording.notes)


def test_a_hole_of_zeros_loses_what_lay_in_it(bag: Path, tmp_path: Path) -> None:
    path = unchunked(bag / "press.mcap", tmp_path / "press.mcap")
    data = bytearray(path.read_bytes())
    begin = records(path, MESSAGE)[200][0] + 30
    data[begin : begin + 4096] = bytes(4096)
    path.write_bytes(data)
    lost = sum(
        begin < end and start - 9 < begin + 4096 for start, end in records(unchunked_copy(bag, tmp_path), MESSAGE)
    )
    recording = read_recording(path)
    found = len(recording.poses["ee"]) + len(recording.wrenches["sensor"])
    assert 2 * COUNT - lost <= found < 2 * COUNT
    (where,) = (note.text for note in recording.notes if "are no records and left out" in note.text)
    assert int(where.split()[0]) <= 4096 and abs(int(where.split()[4]) - begin) < 300


def unchunked_copy(bag: Path, tmp_path: Path) -> Path:
    return unchunked(bag / "press.mcap", tmp_path / "again.mcap")


def test_a_message_record_that_is_too_short_is_left_out(bag: Path, tmp_path: Path) -> None:
    path = unchunked(bag / "press.mcap", tmp_path / "press.mcap")
    data = path.read_bytes()
    begin, end = records(path, MESSAGE)[100]
    path.write_bytes(data[: begin - 8] + (10).to_bytes(8, "little") + data[begin : begin + 10] + data[end:])
    recording = read_recording(path)
    assert len(recording.poses["ee"]) + len(recording.wrenches["sensor"]) == 2 * COUNT - 1
    assert any("it has 10 bytes, fewer than the 22 of its header" in note.text for note in recording.notes)


def test_a_damaged_page_of_a_database_loses_itself_alone(healthy: Path, tmp_path: Path) -> None:
    made = rewrite(healthy, tmp_path / "sql", StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = next(made.glob("*.db3"))
    data = bytearray(path.read_bytes())
    page = int.from_bytes(data[16:18], "big")
    middle = len(data) // page // 2 * page
    data[middle : middle + page] = bytes(page)
    path.write_bytes(data)
    recording = read_recording(path)
    found = len(recording.poses["ee"]) + len(recording.wrenches["sensor"])
    assert 0.9 * 2 * COUNT < found < 2 * COUNT
    assert any("the database is damaged" in note.text for note in recording.notes)


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


def test_what_was_damaged_in_the_field_is_read() -> None:
    if not SHARED.exists():
        pytest.skip("the damaged recordings are not here")
    for path in sorted(SHARED.iterdir()):
        recording = read_recording(path)
        assert recording.warnings and len(recording.poses["ee"]) > 300, path.name
