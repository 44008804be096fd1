"""One storage file of a recording, whatever its storage and compression."""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import zstandard

from sim_core.errors import RecordingError
from sysid.recording import storage_mcap, storage_sqlite
from sysid.recording.storage import FileIndex, Payloads

SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd", ".bag")
TABLE = ".csv"
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


class _Unpacked:
    """A plain copy of a file compressed as a whole; it lives as long as this object."""

    def __init__(self, path: Path) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="thinshell-bag-")
        self.path = Path(self._folder.name) / path.stem
        unpacker = zstandard.ZstdDecompressor().decompressobj()
        with path.open("rb") as packed, self.path.open("wb") as plain:
            while block := packed.read(1 << 20):
                while block:
                    if unpacker.eof:
                        unpacker = zstandard.ZstdDecompressor().decompressobj()
                    try:
                        plain.write(unpacker.decompress(block))
                    except zstandard.ZstdError as error:
                        raise RecordingError(
                            f"{path} does not decompress as zstd: {error}.",
                            "Use another copy of the recording.",
                        ) from error
                    block = unpacker.unused_data if unpacker.eof else b""
        self.cut_short = not unpacker.eof


class _Converted:
    """A recording of another kind as an .mcap file; it lives as long as this object."""

    def __init__(self, path: Path) -> None:
        from sysid.recording.csv_tables import write_table
        from sysid.recording.rosbag1 import write_as_ros2

        self._folder = tempfile.TemporaryDirectory(prefix="thinshell-bag-")
        out = Path(self._folder.name) / "bag"
        self.problems: tuple[str, ...] = ()
        if path.suffix.lower() == TABLE:
            self.problems = write_table(path, out)
        else:
            self.problems = write_as_ros2(path, out, path)
        self.path = next(out.glob("*.mcap"))


def index_file(path: Path) -> FileIndex:
    """Index one storage file: ``.mcap`` or ``.db3``, each also with ``.zstd`` behind it, ``.bag`` of ROS 1 or ``.csv``.

    Raises:
        RecordingError: the file cannot be opened, is no such file, or nothing in it can be read.
    """
    try:
        if foreign := _foreign(path):
            made = _converted(path, path.stat().st_mtime_ns)
            index = storage_mcap.index_mcap(made.path, path)
            return replace(index, storage=foreign, compression="", problems=(*made.problems, *index.problems))
        plain, compressed, cut_short = _plain(path)
        is_sqlite = _is_sqlite(plain, path)
        index = (storage_sqlite.index_sqlite if is_sqlite else storage_mcap.index_mcap)(plain, path)
    except PermissionError as error:
        raise permission_denied(path) from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.", "Use another copy.") from error
    if compressed:
        index = replace(index, compression="+".join(filter(None, [index.compression, "zstd file"])))
    if cut_short:
        index = replace(index, problems=("the compressed file is cut short", *index.problems))
    return index


def open_payloads(path: Path) -> Payloads:
    """Open a storage file for reading single messages."""
    if _foreign(path):
        return storage_mcap.McapPayloads(_converted(path, path.stat().st_mtime_ns).path)
    plain, _, _ = _plain(path)
    is_sqlite = _is_sqlite(plain, path)
    return storage_sqlite.SqlitePayloads(plain) if is_sqlite else storage_mcap.McapPayloads(plain)


def sha256(path: Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()


def permission_denied(path: Path) -> RecordingError:
    """Return the error for a path that may not be read."""
    return RecordingError(
        f"{path} cannot be opened: permission denied.", f"Allow reading, for example with: chmod u+rX {path}"
    )


@lru_cache(maxsize=4)
def _unpacked(path: Path, _modified_ns: int) -> _Unpacked:
    return _Unpacked(path)


@lru_cache(maxsize=4)
def _converted(path: Path, _modified_ns: int) -> _Converted:
    return _Converted(path)


def _foreign(path: Path) -> str:
    """The kind of a file that is no ROS 2 recording, '' of one that is."""
    if path.suffix.lower() == TABLE:
        return "csv"
    with path.open("rb") as file:
        return "rosbag1" if file.read(9) == b"#ROSBAG V" else ""


def _plain(path: Path) -> tuple[Path, bool, bool]:
    """Return a path to the uncompressed file, whether it was compressed, and whether that was cut short."""
    with path.open("rb") as file:
        compressed = file.read(len(ZSTD_MAGIC)) == ZSTD_MAGIC
    if not compressed:
        return path, False, False
    unpacked = _unpacked(path, path.stat().st_mtime_ns)
    return unpacked.path, True, unpacked.cut_short


def _is_sqlite(plain: Path, shown: Path) -> bool:
    with plain.open("rb") as file:
        magic = file.read(16)
    return magic == storage_sqlite.MAGIC
