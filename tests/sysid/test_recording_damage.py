"""Recordings of which bytes are missing or wrong: what is whole is read, and what is lost is said."""

import os
import sqlite3
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType
from recording_files import COUNT, assert_whole, notes, repack, rewrite
from rosbags.rosbag2 import CompressionMode, Reader, StoragePlugin

from sim_core.errors import RecordingError
from sysid.recording import read_recording
from sysid.recording.sqlite_pages import Pages

ROOT = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared"))
SHARED = ROOT / "faults" / "damaged_records"
MESSAGE, SCHEMA, CHANNEL, STATISTICS, HEADER = 5, 3, 4, 11, 1


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


def test_a_truncated_database(bag: Path, tmp_path: Path) -> None:
    made = rewrite(bag, tmp_path / "made", StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = made / "made.db3"
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    recording = read_recording(made)
    count = len(recording.poses["ee"])
    assert 0.3 * COUNT < count < COUNT and "the database is damaged" in notes(recording)
    written = np.round(1e5 * recording.poses["ee"].position[:, 0])  # a page may lie behind that of later messages
    assert (np.diff(written) > 0.0).all() and written[-1] < COUNT
    np.testing.assert_array_equal(recording.poses["ee"].position[:, 0], 1e-5 * written)


def test_a_database_of_which_nothing_is_left(bag: Path, tmp_path: Path) -> None:
    made = rewrite(bag, tmp_path / "made", StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = made / "made.db3"
    path.write_bytes(path.read_bytes()[:4096])
    with pytest.raises(RecordingError, match="not a readable rosbag2 database"):
        read_recording(made)


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


def test_a_database_is_read_without_its_first_page(healthy: Path, tmp_path: Path) -> None:
    """The schema lies there: no query can be asked. Messages that go on in further pages are read whole."""
    made = rewrite(healthy, tmp_path / "sql", StoragePlugin.SQLITE3, CompressionMode.NONE)
    path = next(made.glob("*.db3"))
    whole = read_recording(path)
    data = bytearray(path.read_bytes())
    data[100:4096] = bytes(3996)
    path.write_bytes(data)
    recording = read_recording(path)
    assert_whole(recording)
    for kind, name, stream in whole.streams():
        (again,) = (s for k, n, s in recording.streams() if (k, n) == (kind, name))
        np.testing.assert_array_equal(again.t, stream.t)
    long = "a" * 9000
    with sqlite3.connect(tmp_path / "long.db3") as db:
        db.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB)")
        db.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
                       [(1, 10**18 + k, f"{k}{long[: 97 * k]}".encode()) for k in range(90)])  # fmt: skip
    db.close()
    pages = Pages(tmp_path / "long.db3")
    rows = {row.number: row for row in pages.rows() if len(row.values) == 4}
    assert len(rows) == 90
    for number, row in rows.items():
        k = number - 1
        assert pages.row(row.at, blobs=True).values == (None, 1, 10**18 + k, f"{k}{long[: 97 * k]}".encode())
    pages.close()


@pytest.mark.parametrize("which", [0, -1])
def test_a_topic_that_is_misspelt_in_one_of_its_records_is_read(bag: Path, tmp_path: Path, which: int) -> None:
    """The summary has a checksum, and what it says holds if that agrees; else the first record does."""
    path = unchunked(bag / "press.mcap", tmp_path / "press.mcap")
    data = bytearray(path.read_bytes())
    at = data.index(b"current_pose", 0 if which == 0 else data.rindex(b"current_pose") - 4)
    data[at] ^= 1
    path.write_bytes(data)
    recording = read_recording(path)
    assert_whole(recording)
    assert "where the file says '/current_pose' elsewhere" in notes(recording) or which == -1


def test_messages_of_a_channel_without_its_record_are_read(bag: Path, tmp_path: Path) -> None:
    """Its length is damaged: where records go on behind it is found by the channels that the summary has."""
    path = unchunked(bag / "press.mcap", tmp_path / "press.mcap")
    data = bytearray(path.read_bytes())
    begin, _ = records(path, CHANNEL)[0]
    data[begin - 5] ^= 0x80
    path.write_bytes(data)
    recording = read_recording(path)
    assert_whole(recording)
    assert "are no records and left out" in notes(recording)


def test_what_was_damaged_in_the_field_is_read() -> None:
    if not SHARED.exists():
        pytest.skip("the damaged recordings are not here")
    for path in sorted(SHARED.iterdir()):
        recording = read_recording(path)
        assert recording.warnings and len(recording.poses["ee"]) > 300, path.name
