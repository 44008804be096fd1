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

SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")
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


def index_file(path: Path) -> FileIndex:
    """Index one storage file: ``.mcap`` or ``.db3``, each also with ``.zstd`` behind it.

    Raises:
        RecordingError: the file cannot be opened, is no such file, or nothing in it can be read.
    """
    try:
        plain, compressed, cut_short = _plain(path)
        is_sqlite = _is_sqlite(plain, path)
        index = (storage_sqlite.index_sqlite if is_sqlite else storage_mcap.index_mcap)(plain, path)
    except PermissionError as error:
        raise permission_denied(path) from error
    if compressed:
        index = replace(index, compression="+".join(filter(None, [index.compression, "zstd file"])))
    if cut_short:
        index = replace(index, problems=("the compressed file is cut short", *index.problems))
    return index


def open_payloads(path: Path) -> Payloads:
    """Open a storage file for reading single messages."""
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
    if magic.startswith(b"#ROSBAG V"):
        raise RecordingError(f"{shown} is a ROS 1 bag.", "Convert it to ROS 2 first, for example with rosbags-convert.")
    return magic == storage_sqlite.MAGIC
