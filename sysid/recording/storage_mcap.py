"""Index of one MCAP file, by a sequential scan that survives a missing end, footer or chunk.

The scan reads the data section itself instead of the summary at the end of the file. Three things
follow from it: a recording cut short by a crash is read up to the last whole message, topics never
disappear because of the quality-of-service text stored beside them, and the number of messages found
can be checked against the number that the summary promises.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema, Statistics

from sim_core.errors import RecordingError
from sysid.recording.storage import ChannelEntry, FileIndex

MAGIC = b"\x89MCAP0\r\n"
_FRAME = struct.Struct("<BQ")  # opcode, record length
_MESSAGE = struct.Struct("<HIQQ")  # channel id, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQI")  # start time, end time, uncompressed size, uncompressed CRC
_SCHEMAS = {"ros2msg", "ros2idl", "omgidl", ""}


class McapPayloads:
    """Message payloads of one MCAP file by position."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("rb")
        self._size = path.stat().st_size
        self._chunk_at = -1
        self._chunk = b""

    def payload(self, chunk_at: int, offset: int, size: int, /) -> bytes:
        """Return ``size`` bytes at ``offset`` of the chunk whose record content starts at ``chunk_at``.

        ``chunk_at`` is -1 for a message outside any chunk; ``offset`` then counts from the file's start.
        """
        if chunk_at < 0:
            self._file.seek(offset)
            return self._file.read(size)
        if chunk_at != self._chunk_at:
            self._file.seek(chunk_at - _FRAME.size)
            _, length = _FRAME.unpack(self._file.read(_FRAME.size))
            data, _ = unpack_chunk(self._file.read(min(length, self._size - chunk_at)))
            self._chunk_at, self._chunk = chunk_at, data
        return self._chunk[offset : offset + size]

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def unpack_chunk(content: bytes) -> tuple[bytes, str]:
    """Decompress the content of a chunk record; of a content cut short, what can be had.

    Returns:
        The records inside, and the name of the compression ('' for none).

    Raises:
        ValueError: the compression is unknown, or the data do not agree with size or checksum.
    """
    _, _, size, crc = _CHUNK.unpack_from(content)
    (name_length,) = struct.unpack_from("<I", content, _CHUNK.size)
    at = _CHUNK.size + 4
    compression = content[at : at + name_length].decode()
    at += name_length
    (packed_size,) = struct.unpack_from("<Q", content, at)
    packed = content[at + 8 : at + 8 + packed_size]
    try:
        if compression == "":
            data = packed
        elif compression == "zstd":
            data = zstandard.ZstdDecompressor().decompressobj().decompress(packed)
        elif compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed)
        else:
            raise ValueError(f"chunk compression {compression!r} is not known")
    except (zstandard.ZstdError, RuntimeError) as error:
        raise ValueError(f"chunk does not decompress: {error}") from error
    if len(packed) == packed_size:
        if len(data) != size:
            raise ValueError(f"chunk holds {len(data)} bytes instead of {size}")
        if crc and zlib.crc32(data) != crc:
            raise ValueError("chunk checksum does not agree")
    return data, compression


class _Scan:
    """State of one pass over a file."""

    def __init__(self) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.rows = array("q")  # channel id, log time, chunk position, payload offset, payload size
        self.problems: list[str] = []
        self.compression: set[str] = set()
        self.promised: int | None = None

    def records(self, data: bytes, chunk_at: int) -> Iterator[int]:
        """Read the records inside a chunk; yields the position after each whole record."""
        at = 0
        while at + _FRAME.size <= len(data):
            opcode, length = _FRAME.unpack_from(data, at)
            at += _FRAME.size
            if at + length > len(data):
                return
            self.record(opcode, data, at, length, chunk_at, 0)
            at += length
            yield at

    def record(self, opcode: int, data: bytes, at: int, length: int, chunk_at: int, base: int) -> None:
        """Take up one record whose content is ``data[at : at + length]``."""
        if opcode == Opcode.MESSAGE:
            channel_id, _, log_time, _ = _MESSAGE.unpack_from(data, at)
            start = at + _MESSAGE.size
            self.rows.extend((channel_id, log_time, chunk_at, base + start, length - _MESSAGE.size))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
            stream = ReadDataStream(BytesIO(data[at : at + length]))
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                self.channels[channel.id] = channel
            else:
                self.promised = Statistics.read(stream).message_count

    def index(self, path: Path) -> FileIndex:
        """Return what was found."""
        rows = np.frombuffer(self.rows, dtype=np.int64).reshape(-1, 5).copy()
        order = {channel_id: k for k, channel_id in enumerate(sorted(self.channels))}
        known = np.isin(rows[:, 0], list(order))
        if not known.all():
            self.problems.append(f"{int((~known).sum())} messages belong to no known topic and are left out")
            rows = rows[known]
        if self.promised is not None and len(rows) != self.promised:
            self.problems.append(f"{len(rows)} messages found where the summary counts {self.promised}")
        return FileIndex(
            path=path,
            storage="mcap",
            compression="+".join(sorted(c for c in self.compression if c)),
            channels=tuple(self._entry(self.channels[channel_id]) for channel_id in order),
            channel=np.array([order[int(c)] for c in rows[:, 0]], dtype=np.int64),
            log_ns=rows[:, 1],
            locator=rows[:, 2:],
            problems=tuple(self.problems),
        )

    def _entry(self, channel: Channel) -> ChannelEntry:
        schema = self.schemas.get(channel.schema_id)
        name = schema.name if schema else ""
        encoding = channel.message_encoding
        if schema is not None and schema.encoding not in _SCHEMAS:
            encoding = f"{encoding} with {schema.encoding} schema"
        return ChannelEntry(channel.topic, name, encoding)


def index_mcap(path: Path, shown: Path) -> FileIndex:
    """Scan an MCAP file.

    Args:
        path: the file to read.
        shown: the path to name in messages (differs from ``path`` for an unpacked copy).

    Raises:
        RecordingError: the file is empty, or is no MCAP file.
    """
    size = path.stat().st_size
    scan = _Scan()
    with path.open("rb") as file:
        magic = file.read(len(MAGIC))
        if not magic:
            raise RecordingError(
                f"{shown} is empty (0 bytes).",
                "The recorder was stopped before it wrote anything, or the copy failed; use another copy.",
            )
        if magic != MAGIC:
            raise RecordingError(
                f"{shown} is not an MCAP file: it starts with {magic!r}.",
                "Give a rosbag2 recording: its directory, an .mcap file or a .db3 file.",
            )
        footer = False
        while not footer:
            frame = file.read(_FRAME.size)
            at = file.tell()
            if len(frame) < _FRAME.size:
                break
            opcode, length = _FRAME.unpack(frame)
            whole = at + length <= size
            if opcode == 0 or (not whole and opcode != Opcode.CHUNK):
                break
            if opcode in (Opcode.ATTACHMENT, Opcode.METADATA, Opcode.MESSAGE_INDEX):
                file.seek(at + length)
                continue
            content = file.read(length if whole else size - at)
            if opcode == Opcode.CHUNK:
                _take_chunk(scan, content, at, whole)
                if not whole:
                    break
            elif opcode == Opcode.HEADER:
                _check_profile(Header.read(ReadDataStream(BytesIO(content))).profile, shown)
            else:
                scan.record(opcode, content, 0, length, -1, at)
            footer = opcode == Opcode.FOOTER
        if not footer:
            scan.problems.append(
                f"the file is cut short after {size} bytes (no footer); {len(scan.rows) // 5} messages were "
                "recovered up to the last whole one, the file itself is left as it is"
            )
    return scan.index(shown)


def _take_chunk(scan: _Scan, content: bytes, at: int, whole: bool) -> None:
    try:
        data, compression = unpack_chunk(content)
        scan.compression.add(compression)
        for _ in scan.records(data, at):
            pass
    except (ValueError, struct.error) as error:
        if not whole:
            return  # cut short within its header
        scan.problems.append(f"the chunk at byte {at} is damaged and left out ({error})")


def _check_profile(profile: str, shown: Path) -> None:
    if profile == "ros1":
        raise RecordingError(
            f"{shown} holds ROS 1 messages (profile 'ros1').",
            "Convert it to ROS 2 first, for example with rosbags-convert.",
        )
