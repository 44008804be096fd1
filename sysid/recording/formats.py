"""What a file holds, by its first bytes; what is no recording is named, with what to do about it."""

from __future__ import annotations

import gzip
import zlib
from dataclasses import dataclass
from pathlib import Path

import zstandard

from sim_core.errors import RecordingError
from sysid.recording import storage_mcap, storage_sqlite

MCAP, SQLITE, ROSBAG1, TABLE = "mcap", "sqlite3", "rosbag1", "csv"

SUFFIXES = {".mcap": MCAP, ".db3": SQLITE, ".bag": ROSBAG1, ".csv": TABLE, ".tsv": TABLE}
"""Kinds of files by the endings of their names, without those of compression."""
PACKED = {".zst": "zstd", ".zstd": "zstd", ".gz": "gzip"}
"""Compressions of whole files by the endings of their names."""
TABLES = {".csv", ".tsv", ".txt", ".dat", ".tab", ".asc", ""}
"""Endings of text that may be a table where a single file is named."""
WHAT = "a rosbag2 directory, an .mcap, .db3 or .bag file, or tables (.csv), each also as .zst or .gz"
"""What a recording may be."""

_ZSTD, _GZIP = b"\x28\xb5\x2f\xfd", b"\x1f\x8b"
_MAGIC = ((storage_mcap.MAGIC, MCAP), (storage_sqlite.MAGIC, SQLITE), (b"#ROSBAG V", ROSBAG1))
_HEAD = 512
"""Bytes by which a kind is known."""
_TO_MCAP = (
    "Write its topics as a rosbag2 recording (ros2 bag record, rosbags or mcap), or its columns as tables (.csv)."
)
_UNPACK = "Unpack it, and give what is in it."

_UNPACK = "Unpack it, and give what is in it."
_COLUMNS = "as columns of a table (.csv) with units in their names"
_FILM = f"Record the pictures as a topic, or write the tracks of markers {_COLUMNS}."

FOREIGN: tuple[tuple[int, bytes, str, str], ...] = (
    (0, b"PAR1", "a Parquet table", "Write it as a table, its names with units: pandas.read_parquet(...).to_csv(...)."),
    (
        0,
        b"ARROW1",
        "an Arrow table",
        "Write it as a table, its names with units: pandas.read_feather(...).to_csv(...).",
    ),
    (0, b"\x89HDF\r\n\x1a\n", "an HDF5 file", f"Write its arrays {_COLUMNS}, with h5py."),
    (0, b"RRF", "a Rerun recording", f"Write its entities {_COLUMNS}, with Rerun's dataframe API."),
    (0, b"\x93NUMPY", "a NumPy array", f"Write it {_COLUMNS}."),
    (0, b"MATLAB 5.0", "a MATLAB file", f"Write its signals {_COLUMNS}, with writetable."),
    (0, b"ULog", "a PX4 log", f"Write its topics {_COLUMNS}, with ulog2csv."),
    (4, b"ftyp", "a film", _FILM),
    (0, b"RIFF", "a film or a sound", _FILM),
    (0, b"\x1a\x45\xdf\xa3", "a film", _FILM),
    (0, b"PK\x03\x04", "a zip archive", _UNPACK),
    (0, b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive", _UNPACK),
    (0, b"Rar!", "a RAR archive", _UNPACK),
    (0, b"BZh", "a file packed by bzip2", _UNPACK),
    (0, b"\xfd7zXZ", "a file packed by xz", _UNPACK),
    (257, b"ustar", "a tar archive", _UNPACK),
)
"""Where its magic stands, the magic, what it is, and what to do, of files that are no recording."""
_ZIPPED = {
    ".npz": ("NumPy arrays", f"Write them {_COLUMNS}; a trace of this package is drawn by 'thinshell show'."),
    ".xlsx": ("an Excel workbook", "Save its sheet as CSV."),
    ".ods": ("a spreadsheet", "Save it as CSV."),
}


@dataclass(frozen=True)
class Content:
    """What a file is: one of the kinds that are read, '' for another; how it is packed as a whole, '' for not; what
    another kind is, in words, and what to do about it."""

    kind: str = ""
    packed: str = ""
    words: str = ""
    remedy: str = ""


def content_of(path: Path) -> Content:
    """What is in a file, by its first bytes, and where these say nothing (text, damage) by its name.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD)
    packed, inner = "", head
    if head.startswith((_ZSTD, _GZIP)):
        packed = "zstd" if head.startswith(_ZSTD) else "gzip"
        inner = _unpacked_head(path, packed)
    name = plain_name(path.name)
    suffix = Path(name).suffix.lower()
    kind = next((kind for magic, kind in _MAGIC if inner.startswith(magic)), "")
    if kind:
        return Content(kind, packed)
    for at, magic, words, remedy in FOREIGN:
        if inner[at : at + len(magic)] == magic:
            words, remedy = _ZIPPED.get(suffix, (words, remedy)) if words == "a zip archive" else (words, remedy)
            return Content("", packed, words, remedy)
    if suffix in SUFFIXES and (SUFFIXES[suffix] != TABLE or is_text(inner)):
        return Content(SUFFIXES[suffix], packed)
    if inner and is_text(inner):
        if suffix in TABLES:
            return Content(TABLE, packed)
        words = "a mesh" if suffix in (".stl", ".obj", ".ply", ".msh", ".inp") else f"a text file ({suffix})"
        return Content("", packed, words, f"Give {WHAT}.")
    return Content("", packed)


def is_text(head: bytes) -> bool:
    """Whether a file that begins so is text: UTF-8, Latin 1, or UTF-16."""
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return True
    ones = sum(byte < 32 and byte not in b"\t\n\r\f" for byte in head)
    return ones == 0 or encoding_of(head) != "utf-8-sig"


def encoding_of(raw: bytes) -> str:
    """The encoding of text, by its mark or, of UTF-16 without one, by where its zero bytes are."""
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    head = raw[:_HEAD]
    even, odd = head[::2].count(0), head[1::2].count(0)
    if len(head) > 3 and max(even, odd) > len(head) // 4 and min(even, odd) == 0:
        return "utf-16-le" if odd else "utf-16-be"
    return "utf-8-sig"


def plain_name(name: str) -> str:
    """The name of a file without the endings of compression."""
    while Path(name).suffix.lower() in PACKED:
        name = name[: -len(Path(name).suffix)]
    return name


def refuse(path: Path, content: Content) -> RecordingError:
    """What is said of a file that is no recording."""
    return RecordingError(f"{path} is {content.words}, not a recording.", content.remedy)


def _unpacked_head(path: Path, packed: str) -> bytes:
    try:
        with path.open("rb") as file:
            if packed == "zstd":
                with zstandard.ZstdDecompressor().stream_reader(file) as reader:
                    return bytes(reader.read(_HEAD))
            with gzip.GzipFile(fileobj=file) as plain:
                return plain.read(_HEAD)
    except (zstandard.ZstdError, zlib.error, EOFError, gzip.BadGzipFile):
        return b""
