"""Index of one MCAP file, by a sequential scan that survives damage, a missing end, footer or chunk.

The scan reads the data section itself instead of the summary at the end of the file, which only tells what channels
there are where their records are damaged. Four things
follow from it: a recording cut short by a crash is read up to the last whole message, topics never
disappear because of the quality-of-service text stored with them, the number of messages found
can be checked against the number that the summary promises, and behind a damaged place the scan goes
on with the next records that follow each other as records do.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from array import array
from collections.abc import Container
from functools import partial
from io import BytesIO
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Header, Schema, Statistics

from sim_core.errors import RecordingError
from sysid.recording.mcap_summary import Summary, summary_of
from sysid.recording.storage import ChannelEntry, FileIndex

MAGIC = b"\x89MCAP0\r\n"
_FRAME = struct.Struct("<BQ")  # opcode, record length
_MESSAGE = struct.Struct("<HIQQ")  # channel id, sequence, log time, publish time
_CHUNK = struct.Struct("<QQQI")  # start time, end time, uncompressed size, uncompressed CRC
_LARGEST_CHUNK = 1 << 31
"""Bytes that a chunk may unpack to; recorders write chunks of a megabyte."""
_OPCODES = frozenset(range(1, 16))
"""Kinds of records; of others (128 and more are private) none are written by recorders of ROS."""
_IN_A_ROW = 3
"""Records that follow each other from which a place is where records go on."""
_BLOCK = 1 << 20
"""Bytes that are searched at a time for where records go on."""
_LISTED = 4
"""Damaged places of a file that are listed."""
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
    if size > _LARGEST_CHUNK:
        raise ValueError(f"chunk states {size} bytes")
    try:
        if compression == "":
            data = packed
        elif compression == "zstd":
            with zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True) as reader:
                data = reader.read(size + 1)
        elif compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
        else:
            raise ValueError(f"chunk compression {compression!r} is not known")
    except (zstandard.ZstdError, RuntimeError, MemoryError) as error:
        raise ValueError(f"chunk does not decompress: {error}") from error
    if len(packed) == packed_size:
        if len(data) != size:
            raise ValueError(f"chunk holds {len(data)} bytes instead of {size}")
        if crc and zlib.crc32(data) != crc:
            raise ValueError("chunk checksum does not agree")
    return data, compression


class _Scan:
    """State of one pass over a file."""

    def __init__(self, summary: Summary) -> None:
        self.schemas: dict[int, Schema] = dict(summary.schemas) if summary.whole else {}
        self.channels: dict[int, Channel] = dict(summary.channels) if summary.whole else {}
        self.stated = set(summary.channels)
        """Numbers of channels that the file has by its summary."""
        self.rows = array("q")  # channel id, log time, chunk position, payload offset, payload size
        self.problems: list[str] = []
        self.damage: list[str] = []
        self.compression: set[str] = set()
        self.promised: int | None = None

    def records(self, data: bytes, chunk_at: int) -> None:
        """Take up the records inside a chunk, as many as are whole."""
        at = 0
        while at + _FRAME.size <= len(data):
            opcode, length = _FRAME.unpack_from(data, at)
            at += _FRAME.size
            if at + length > len(data):
                return
            self.record(opcode, data, at, length, chunk_at, 0)
            at += length

    def record(self, opcode: int, data: bytes, at: int, length: int, chunk_at: int, base: int) -> None:
        """Take up one record whose content is ``data[at : at + length]``, or say that it is damaged."""
        try:
            self._record(opcode, data, at, length, chunk_at, base)
        except (EndOfFile, struct.error, ValueError, OverflowError) as error:
            where = f"at byte {base + at}" if chunk_at < 0 else f"in the chunk at byte {chunk_at}"
            reason = str(error) or "it ends too early"
            self.damage.append(f"the {_NAMES.get(opcode, 'unknown')} record {where} is damaged and left out ({reason})")

    def _record(self, opcode: int, data: bytes, at: int, length: int, chunk_at: int, base: int) -> None:
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise ValueError(f"it has {length} bytes, fewer than the {_MESSAGE.size} of its header")
            channel_id, _, log_time, _ = _MESSAGE.unpack_from(data, at)
            start = at + _MESSAGE.size
            if log_time > _LATEST_NS:
                raise ValueError(f"recorded {log_time} ns after 1970")
            self.rows.extend((channel_id, log_time, chunk_at, base + start, length - _MESSAGE.size))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.STATISTICS):
            stream = ReadDataStream(BytesIO(data[at : at + length]))
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                kept = self.schemas.setdefault(schema.id, schema)
                _check_alike(kept.name, schema.name)
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                known = self.channels.setdefault(channel.id, channel)
                for one, other in zip(_words(known), _words(channel), strict=True):
                    _check_alike(one, other)
            else:
                self.promised = Statistics.read(stream).message_count

    def index(self, path: Path, shown: Path) -> FileIndex:
        """Return what was found."""
        rows = np.frombuffer(self.rows, dtype=np.int64).reshape(-1, 5).copy()
        order = {channel_id: k for k, channel_id in enumerate(sorted(self.channels))}
        known = np.isin(rows[:, 0], list(order))
        self.problems += self.damage[:_LISTED]
        if len(self.damage) > _LISTED:
            self.problems.append(f"{len(self.damage) - _LISTED} more records are damaged and left out")
        if not known.all():
            self.problems.append(f"{int((~known).sum())} messages belong to no known topic and are left out")
            rows = rows[known]
        if self.promised is not None and len(rows) != self.promised:
            self.problems.append(f"{len(rows)} messages found where the summary counts {self.promised}")
        return FileIndex(
            path=shown,
            storage="mcap",
            compression="+".join(sorted(c for c in self.compression if c)),
            channels=tuple(self._entry(self.channels[channel_id]) for channel_id in order),
            channel=np.array([order[int(c)] for c in rows[:, 0]], dtype=np.int64),
            log_ns=rows[:, 1],
            locator=rows[:, 2:],
            problems=tuple(self.problems),
            open=partial(McapPayloads, path),
        )

    def _entry(self, channel: Channel) -> ChannelEntry:
        schema = self.schemas.get(channel.schema_id)
        name = schema.name if schema else ""
        encoding = channel.message_encoding
        if schema is not None and schema.encoding not in _SCHEMAS:
            encoding = f"{encoding} with {schema.encoding} schema"
        return ChannelEntry(channel.topic, name, encoding)


def _words(channel: Channel) -> tuple[str, str, str]:
    return channel.topic, channel.message_encoding, f"schema {channel.schema_id}"


def _check_alike(kept: str, other: str) -> None:
    """A record that a file repeats says the same each time."""
    if kept != other:
        raise ValueError(f"it says {other!r} where the file says {kept!r} elsewhere")


_NAMES = {int(code): code.name.lower().replace("_", " ") for code in Opcode}
_LATEST_NS = np.iinfo(np.int64).max


def index_mcap(path: Path, shown: Path) -> FileIndex:
    """Scan an MCAP file.

    Args:
        path: the file to read.
        shown: the path to name in messages (differs from ``path`` for an unpacked copy).

    Raises:
        RecordingError: the file is empty, or is no MCAP file.
    """
    size = path.stat().st_size
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
                "Give a rosbag2 directory, an .mcap, .db3 or .bag file, or tables (.csv).",
            )
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            return _scanned(data, size, shown).index(path, shown)


def _scanned(data: mmap.mmap, size: int, shown: Path) -> _Scan:
    scan = _Scan(summary_of(data, size))
    start, footer = len(MAGIC), False
    while not footer and start + _FRAME.size <= size:
        opcode, length = _FRAME.unpack_from(data, start)
        at = start + _FRAME.size
        if opcode not in _OPCODES or not _follows(data, at + length, size):
            # Either this record states a wrong length, or what comes behind it is damaged.
            on = _next_record(data, start + 1, size, scan.stated | set(scan.channels))
            if on is None:
                if opcode == Opcode.CHUNK and at + length > size:
                    _take_chunk(scan, data[at:size], at, whole=False)
                elif opcode in _OPCODES and at + length <= size:
                    footer = _take(scan, data, opcode, at, length, shown)
                break
            if opcode not in _OPCODES or on < at + length:
                scan.damage.append(f"{on - start} bytes from byte {start} on are no records and left out")
                start = on
                continue
        footer = _take(scan, data, opcode, at, length, shown)
        start = at + length
    if not footer:
        scan.problems.append(
            f"the file is cut short after {size} bytes (no footer); {len(scan.rows) // 5} messages were "
            "recovered up to the last whole one, the file itself is left as it is"
        )
    return scan


def _take(scan: _Scan, data: mmap.mmap, opcode: int, at: int, length: int, shown: Path) -> bool:
    """Take up one whole record of the file; whether it is the footer."""
    if opcode in (Opcode.ATTACHMENT, Opcode.METADATA, Opcode.MESSAGE_INDEX):
        return False
    content = data[at : at + length]
    if opcode == Opcode.CHUNK:
        _take_chunk(scan, content, at, whole=True)
    elif opcode == Opcode.HEADER:
        try:
            profile = Header.read(ReadDataStream(BytesIO(content))).profile
        except (EndOfFile, struct.error, ValueError) as error:
            scan.damage.append(f"the header record is damaged ({str(error) or 'it ends too early'})")
        else:
            _check_profile(profile, shown)
    else:
        scan.record(opcode, content, 0, length, -1, at)
    return opcode == Opcode.FOOTER


def _follows(data: mmap.mmap, end: int, size: int) -> bool:
    """Whether behind a record that ends there another one may begin, or the file ends."""
    if end > size:
        return False
    if end + _FRAME.size > size:
        return end == size or data[end:size] == MAGIC[: size - end]
    return data[end] in _OPCODES or data[end : end + len(MAGIC)] == MAGIC


def _next_record(data: mmap.mmap, start: int, size: int, channels: Container[int]) -> int | None:
    """Where records go on behind damage: the first place from which several follow each other; None if nowhere."""
    for begin in range(start, size, _BLOCK):
        block = np.frombuffer(data[begin : min(begin + _BLOCK + _FRAME.size, size)], dtype=np.uint8)
        if len(block) < _FRAME.size:
            return None
        # The length is 8 bytes, of which the upper four are zero in any file of less than 4 GiB a record.
        upper = block[5:].astype(np.int64)
        zero = upper[:-3] + upper[1:-2] + upper[2:-1] + upper[3:] == 0
        kinds = (block[: len(zero)] >= 1) & (block[: len(zero)] <= 15)
        for offset in np.flatnonzero(zero & kinds):
            place = begin + int(offset)
            at = place
            for _ in range(_IN_A_ROW):
                opcode, length = _FRAME.unpack_from(data, at)
                at += _FRAME.size
                if not _plausible(data, opcode, at, length, channels) or not _follows(data, at + length, size):
                    break
                at += length
                if opcode == Opcode.FOOTER:
                    return place
                if at + _FRAME.size > size:
                    break
            else:
                return place
    return None


def _plausible(data: mmap.mmap, opcode: int, at: int, length: int, channels: Container[int]) -> bool:
    """Whether what states to be a record of a kind may be one."""
    if opcode == Opcode.MESSAGE:
        if length < _MESSAGE.size or at + _MESSAGE.size > len(data):
            return False
        channel, _, recorded, published = _MESSAGE.unpack_from(data, at)
        return channel in channels and max(recorded, published) < _LATEST_NS
    if opcode == Opcode.CHUNK:
        head = _CHUNK.size + 4
        if length < head + 8 or at + head > len(data):
            return False
        begin, end, unpacked, _ = _CHUNK.unpack_from(data, at)
        (name,) = struct.unpack_from("<I", data, at + _CHUNK.size)
        if begin > end or unpacked > _LARGEST_CHUNK or name > 4 or at + head + name + 8 > len(data):
            return False
        (packed,) = struct.unpack_from("<Q", data, at + head + name)
        return bool(head + name + 8 + packed == length)
    if opcode == Opcode.MESSAGE_INDEX:
        return length >= 6 and (length - 6) % 16 == 0 and struct.unpack_from("<H", data, at)[0] in channels
    return _LENGTHS.get(opcode, length) == length and length >= 4


_LENGTHS = {int(Opcode.DATA_END): 4, int(Opcode.FOOTER): 20, int(Opcode.SUMMARY_OFFSET): 17}


def _take_chunk(scan: _Scan, content: bytes, at: int, whole: bool) -> None:
    try:
        data, compression = unpack_chunk(content)
        scan.compression.add(compression)
        scan.records(data, at)
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
