"""MCAP files as ``rosbags`` writes them, with compressed chunks and their checksums. No ROS."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode
from rosbags.rosbag2.storage_mcap import McapWriter

_CRC_AT = 1 + 8 + 3 * 8
"""Place of the checksum in a chunk: after opcode, length, two times and the uncompressed size."""


class CheckedMcap(McapWriter):
    """One file of a bag, compressed with zstd. ``rosbags`` writes 0 for the CRC-32 of a chunk, which means none."""

    def __init__(self, folder: Path, number: int) -> None:
        """Create file ``number`` of the bag in ``folder``."""
        super().__init__(folder, CompressionMode.STORAGE)
        self.path = self.path.rename(folder / f"{folder.name}_{number}.mcap")
        self._added: list[tuple[Connection, str]] = []
        self._types: set[str] = set()

    def add_msgtype(self, connection: Connection) -> None:
        """Write the definition of a message type, once."""
        if connection.msgtype not in self._types:
            self._types.add(connection.msgtype)
            super().add_msgtype(connection)

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Prepare for a topic."""
        self._added.append((connection, offered_qos_profiles))
        super().add_connection(connection, offered_qos_profiles)

    def close_chunk(self) -> None:
        """Put a chunk with its checksum on disk."""
        crc = zlib.crc32(self.chunk.bio.getbuffer())
        start = self.bio.tell()
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(start + _CRC_AT)
        self.bio.write(struct.pack("<I", crc))
        self.bio.seek(end)

    @property
    def size(self) -> int:
        """Bytes so far, those not yet compressed included."""
        return int(self.bio.tell() + self.chunk.bio.tell())

    def follow(self, number: int) -> CheckedMcap:
        """Finish this file; returns the next one of the bag, with the same topics."""
        added = self._added
        self.close(9, "")
        following = CheckedMcap(self.path.parent, number)
        for connection, offered in added:
            following.add_msgtype(connection)
            following.add_connection(connection, offered)
        return following
