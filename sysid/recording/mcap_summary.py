"""What an MCAP file repeats of its channels and schemas behind the messages, and whether that is whole."""

from __future__ import annotations

import mmap
import struct
import zlib
from dataclasses import dataclass, field
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

_FRAME = struct.Struct("<BQ")  # opcode, record length
_FOOTER = struct.Struct("<QQI")  # start of the summary, of its offsets, CRC of both and of these two numbers
_MAGIC_SIZE = 8


@dataclass
class Summary:
    """``whole``: its checksum agrees, so that it is right where records before it say something else."""

    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    whole: bool = False


def summary_of(data: mmap.mmap, size: int) -> Summary:
    """The summary of a file of ``size`` bytes; empty where there is none, or none that can be read."""
    found = Summary()
    at = size - _MAGIC_SIZE - _FOOTER.size
    if at < _FRAME.size + _MAGIC_SIZE or _FRAME.unpack_from(data, at - _FRAME.size) != (Opcode.FOOTER, _FOOTER.size):
        return found
    start, _, crc = _FOOTER.unpack_from(data, at)
    if not _MAGIC_SIZE <= start < at:
        return found
    found.whole = crc != 0 and zlib.crc32(data[start : at + _FOOTER.size - 4]) == crc
    while start + _FRAME.size <= at:
        opcode, length = _FRAME.unpack_from(data, start)
        start += _FRAME.size
        if start + length > at:
            break
        stream = ReadDataStream(BytesIO(data[start : start + length]))
        try:
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                found.schemas[schema.id] = schema
            elif opcode == Opcode.CHANNEL:
                channel = Channel.read(stream)
                found.channels[channel.id] = channel
        except (EndOfFile, struct.error, ValueError, OverflowError):
            pass  # said by the scan, which comes here too
        start += length
    return found
