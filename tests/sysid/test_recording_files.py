"""Which files a recording is made of: by content, in any case, compressed, hidden ones skipped; others are named."""

from __future__ import annotations

import bz2
import gzip
import io
import json
import os
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
import zstandard
from recording_files import COUNT, assert_whole, edit_metadata, notes, rewrite, write
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from sim_core.errors import RecordingError
from sim_core.rigs import load_rig
from sysid.recording import read_recording
from sysid.show.subject import subject_of

ROOT = Path(os.environ.get("THINSHELL_SHARED", Path(__file__).resolve().parents[3] / "shared")) / "faults"


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    return write(tmp_path / "press")


def packed(data: bytes, ending: str) -> bytes:
    return gzip.compress(data) if ending == ".gz" else zstandard.ZstdCompressor().compress(data)


@pytest.mark.parametrize("with_metadata", [True, False])
@pytest.mark.parametrize("ending", [".zst", ".zstd", ".gz", ".ZST"])
@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_compressed_file_is_found(
    bag: Path, tmp_path: Path, plugin: StoragePlugin, ending: str, with_metadata: bool
) -> None:
    made = rewrite(bag, tmp_path / "made", plugin, CompressionMode.NONE)
    (file,) = (p for p in made.iterdir() if p.name != "metadata.yaml")
    (made / (file.name + ending)).write_bytes(packed(file.read_bytes(), ending.lower()))
    file.unlink()
    if not with_metadata:
        (made / "metadata.yaml").unlink()
    assert_whole(read_recording(made))
    assert_whole(read_recording(made / (file.name + ending)))


@pytest.mark.parametrize("name", ["RUN1.MCAP", "run1", "run1.mcap.active", "Run 1 (copy).data"])
@pytest.mark.parametrize("with_metadata", [True, False])
def test_a_file_is_known_by_its_content(bag: Path, name: str, with_metadata: bool) -> None:
    (bag / "press.mcap").rename(bag / name)
    if not with_metadata:
        (bag / "metadata.yaml").unlink()
    recording = read_recording(bag)
    assert_whole(recording)
    assert (f"lists press.mcap, of which none exists; {name} read instead" in notes(recording)) == with_metadata


def test_names_in_another_case_are_the_listed_ones(bag: Path) -> None:
    (bag / "press.mcap").rename(bag / "PRESS.MCAP")
    (bag / "metadata.yaml").rename(bag / "METADATA.YAML")
    recording = read_recording(bag)
    assert_whole(recording)
    assert recording.notes == ()


@pytest.mark.parametrize("with_metadata", [True, False])
def test_hidden_files_and_those_of_a_desktop_are_skipped(bag: Path, with_metadata: bool) -> None:
    mac = b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X        " + bytes(100)
    for name in ("._press.mcap", ".DS_Store", "._metadata.yaml", ".press.mcap.swp"):
        (bag / name).write_bytes(mac)
    (bag / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(100))
    (bag / "README.txt").write_text("time flies, pressed on Monday, twice\nand again, and again, and again\n")
    if not with_metadata:
        (bag / "metadata.yaml").unlink()
    recording = read_recording(bag)
    assert_whole(recording)
    assert not recording.warnings


def test_a_file_that_is_there_plain_and_packed_is_read_once(bag: Path) -> None:
    (bag / "press.mcap.zst").write_bytes(packed((bag / "press.mcap").read_bytes(), ".zst"))
    (bag / "metadata.yaml").unlink()
    recording = read_recording(bag)
    assert_whole(recording)
    assert "press.mcap.zst: not read: press.mcap is there unpacked" in notes(recording)


def test_one_split_that_cannot_be_read_does_not_stop_the_others(bag: Path, tmp_path: Path) -> None:
    shutil.copy(write(tmp_path / "later", COUNT, COUNT + 10) / "later.mcap", bag / "press_2.mcap")
    (bag / "press_1.mcap").write_bytes(b"")
    edit_metadata(bag, lambda info: info.update(relative_file_paths=["press.mcap", "press_1.mcap", "press_2.mcap"]))
    recording = read_recording(bag)
    assert len(recording.poses["ee"]) == COUNT + 10
    assert "warning: press_1.mcap: left out" in notes(recording) and "is empty (0 bytes)" in notes(recording)


def test_two_kinds_of_recordings_in_a_folder_are_refused(bag: Path, tmp_path: Path) -> None:
    made = rewrite(bag, tmp_path / "made", StoragePlugin.SQLITE3, CompressionMode.NONE)
    (bag / "metadata.yaml").unlink()
    shutil.copy(next(made.glob("*.db3")), bag / "press.db3")
    with pytest.raises(RecordingError, match=r"holds recordings of 2 kinds: .*press\.mcap \(mcap\)"):
        read_recording(bag)


def as_zip() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as made:
        made.writestr("x.npy", b"")
    return out.getvalue()


FOREIGN = [
    ("run.parquet", b"PAR1" + bytes(600), "a Parquet table", "read_parquet"),
    ("run.h5", b"\x89HDF\r\n\x1a\n" + bytes(600), "an HDF5 file", "h5py"),
    ("run.rrd", b"RRF2" + bytes(600), "a Rerun recording", "dataframe"),
    ("run.npz", as_zip(), "NumPy arrays", "thinshell show"),
    ("run.zip", as_zip(), "a zip archive", "Unpack it"),
    ("run.mcap.bz2", bz2.compress(b"x" * 600), "packed by bzip2", "Unpack it"),
    ("run.tar", bytes(257) + b"ustar" + bytes(300), "a tar archive", "Unpack it"),
    ("run.mp4", b"\x00\x00\x00\x18ftypmp42" + bytes(600), "a film", "tracks of markers"),
]


@pytest.mark.parametrize(("name", "data", "words", "remedy"), FOREIGN, ids=[case[0] for case in FOREIGN])
def test_foreign_formats_are_named_with_what_to_do(
    tmp_path: Path, name: str, data: bytes, words: str, remedy: str
) -> None:
    (tmp_path / name).write_bytes(data)
    for path in [tmp_path / name] + [tmp_path] * (words != "a film"):
        with pytest.raises(RecordingError, match=words) as caught:
            read_recording(path)
        assert remedy in caught.value.remedy


def test_a_lerobot_dataset_is_named(tmp_path: Path) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text(json.dumps({"codebase_version": "v3.0", "fps": 30}))
    with pytest.raises(RecordingError, match=r"is a LeRobot dataset \(v3\.0\)"):
        read_recording(tmp_path)


def test_show_takes_what_inspect_takes(tmp_path: Path) -> None:
    """A folder of tables: motion of the example rig, without ROS."""
    rig = load_rig("card_press")
    (name,) = rig.end_effectors
    start = rig.end_effectors[name].start.position_m
    rows = [f"{0.05 * k:.2f},{start[0]},{start[1]},{start[2] - 1e-5 * k}" for k in range(3)]
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "pose.CSV").write_text("\n".join(["time [s],x [m],y [m],z [m]", *rows]) + "\n")
    topic = next(s for s in rig.sensors.values() if s.type == "wrench").topic.replace("/", ".")
    header = ",".join(["time [s]", *(f"{topic}.force_{axis} [N]" for axis in "xyz")])
    (folder / "force.csv").write_text("\n".join([header, *(f"{0.05 * k:.2f},0,0,{0.1 * k}" for k in range(3))]))
    found = subject_of(rig, str(folder))
    assert found.what == "recording" and len(found.times) > 1
    assert np.isfinite(next(iter(found.measured_wrenches.values()))).any()


@pytest.mark.skipif(not ROOT.is_dir(), reason="the shared inputs are not here")
@pytest.mark.parametrize("name", ["mac_dotfile", "upper_suffix", "zst_suffix"])
def test_shared_files_are_found(name: str) -> None:
    recording = read_recording(ROOT / "files_beside_metadata" / name)
    assert len(recording.poses["ee"]) == 431 and not recording.warnings
