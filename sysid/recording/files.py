"""One storage file of a recording, whatever its storage and compression."""

from __future__ import annotations

import hashlib
import tempfile
import zlib
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import zstandard

from sim_core.errors import RecordingError
from sysid.recording import storage_mcap, storage_sqlite
from sysid.recording.formats import ROSBAG1, SQLITE, TABLE, Content, content_of, plain_name, refuse
from sysid.recording.storage import FileIndex, Payloads


class _Unpacked:
    """A plain copy of a file compressed as a whole; it lives as long as this object."""

    def __init__(self, path: Path, packed: str) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="thinshell-bag-")
        self.path = Path(self._folder.name) / plain_name(path.name)
        self.problems: tuple[str, ...] = ()
        unpacker = _unpacker(packed)
        with path.open("rb") as source, self.path.open("wb") as plain:
            while block := source.read(1 << 20):
                while block:
                    if unpacker.eof:
                        unpacker = _unpacker(packed)
                    try:
                        plain.write(unpacker.decompress(block))
                    except (zstandard.ZstdError, zlib.error) as error:
                        if plain.tell():
                            self.problems = (f"the compressed file is damaged behind {plain.tell()} bytes of content",)
                            return
                        raise RecordingError(
                            f"{path} does not decompress as {packed}: {error}.",
                            "Use another copy of the recording.",
                        ) from error
                    block = unpacker.unused_data if unpacker.eof else b""
        self.problems = () if unpacker.eof else ("the compressed file is cut short",)


def _unpacker(packed: str) -> Any:
    return zlib.decompressobj(zlib.MAX_WBITS + 16) if packed == "gzip" else zstandard.ZstdDecompressor().decompressobj()


class _Converted:
    """A recording of another kind as an .mcap file; it lives as long as this object."""

    def __init__(self, plain: Path, kind: str, shown: Path, mapped: Mapping[str, str]) -> None:
        from sysid.recording.csv_tables import write_table
        from sysid.recording.rosbag1 import write_as_ros2

        self._folder = tempfile.TemporaryDirectory(prefix="thinshell-bag-")
        out = Path(self._folder.name) / "bag"
        self.remarks: tuple[str, ...] = ()
        if kind == TABLE:
            self.problems, self.remarks = write_table(plain, out, shown, mapped)
        else:
            self.problems = write_as_ros2(plain, out, shown)
        self.path = next(out.glob("*.mcap"))


def index_file(path: Path, mapped: Mapping[str, str]) -> FileIndex:
    """Index one storage file or table, whatever its name and its compression. ``mapped``: names of columns of tables.

    Raises:
        RecordingError: the file cannot be opened, is no such file, or nothing in it can be read.
    """
    try:
        content = content_of(path)
        if content.words:
            raise refuse(path, content)
        plain, problems, remarks = _plain(path, content, tuple(mapped.items()))
        reader = storage_sqlite.index_sqlite if content.kind == SQLITE else storage_mcap.index_mcap
        index = reader(plain, path)
    except PermissionError as error:
        raise permission_denied(path) from error
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error.strerror or error}.", "Use another copy.") from error
    index = replace(index, problems=(*problems, *index.problems), remarks=remarks)
    if content.kind in (TABLE, ROSBAG1):
        index = replace(index, storage=content.kind, compression="")
    if content.packed:
        index = replace(index, compression="+".join(filter(None, [index.compression, f"{content.packed} file"])))
    return index if plain == path else replace(index, open=partial(_opened, path, tuple(mapped.items())))


def _opened(path: Path, mapped: tuple[tuple[str, str], ...]) -> Payloads:
    """The messages of a file that is compressed or no recording of ROS 2, made readable again where it no longer is."""
    content = content_of(path)
    plain, _, _ = _plain(path, content, mapped)
    return storage_sqlite.SqlitePayloads(plain) if content.kind == SQLITE else storage_mcap.McapPayloads(plain)


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


def _plain(
    path: Path, content: Content, mapped: tuple[tuple[str, str], ...]
) -> tuple[Path, tuple[str, ...], tuple[str, ...]]:
    """The file itself, or a copy of it that is unpacked or a recording of ROS 2; what was lost or assumed, and what
    else is to be said, in words."""
    plain, modified = path, path.stat().st_mtime_ns
    problems: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    if content.packed:
        unpacked = _unpacked(path, modified, content.packed)
        plain, problems = unpacked.path, unpacked.problems
    if content.kind in (TABLE, ROSBAG1):
        made = _converted(path, modified, plain, content.kind, mapped)
        plain, problems = made.path, (*problems, *made.problems)
        remarks = made.remarks
    return plain, problems, remarks


@lru_cache(maxsize=4)
def _unpacked(path: Path, _modified_ns: int, packed: str) -> _Unpacked:
    return _Unpacked(path, packed)


@lru_cache(maxsize=4)
def _converted(
    path: Path, _modified_ns: int, plain: Path, kind: str, mapped: tuple[tuple[str, str], ...]
) -> _Converted:
    return _Converted(plain, kind, path, dict(mapped))
