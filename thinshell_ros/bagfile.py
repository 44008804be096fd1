"""Serialised messages into an MCAP bag, as they come in. No ROS."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import RecordingError

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


class BagFile:
    """A bag being recorded.

    ``flush`` puts everything so far on disk: a recording that is cut off by a crash keeps what came
    before the last flush, and ``read_recording`` reads it.
    """

    def __init__(self, path: str | Path, notes: dict[str, str] | None = None) -> None:
        """Create the bag directory ``path``. ``notes``: kept in its metadata.

        Raises:
            RecordingError: the path exists, or cannot be created.
        """
        self.path = Path(path).expanduser()
        if self.path.exists() or self.path.is_symlink():
            raise RecordingError(f"{self.path} exists already.", "Choose another path, or move it away first.")
        self._bag = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        try:
            self._bag.open()
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be created: {error}.", "Choose another path.") from error
        for key, text in (notes or {}).items():
            self._bag.set_custom_data(key, text)
        self._connections: dict[str, Connection] = {}
        self.counts: dict[str, int] = {}

    def add(self, topic: str, msgtype: str, offered: Sequence[Qos] = ()) -> None:
        """Prepare for messages of a topic, for example of type 'sensor_msgs/msg/PointCloud2'.

        Raises:
            RecordingError: the type is not one of the standard ones.
        """
        if msgtype not in TYPESTORE.types:
            raise RecordingError(
                f"{topic} is of type {msgtype}, which is not known here.",
                "Record topics of standard message types.",
            )
        self._connections[topic] = self._bag.add_connection(
            topic, msgtype, typestore=TYPESTORE, offered_qos_profiles=offered
        )
        self.counts[topic] = 0

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Add a serialised message (CDR) received at ``time_ns``."""
        with self._disk():
            self._bag.write(self._connections[topic], time_ns, data)
        self.counts[topic] += 1

    def flush(self) -> None:
        """Put what has come on disk, as a chunk of its own."""
        storage: Any = self._bag.storage
        if storage is not None and storage.chunk.msgs:
            with self._disk():
                storage.close_chunk()
                storage.bio.flush()

    @contextmanager
    def _disk(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self._bag.abort()
            raise RecordingError(
                f"{self.path} cannot be written: {error}.",
                "What was written before can be read; make room and record again.",
            ) from error

    def close(self) -> bool:
        """Finish the bag. One without messages is removed; returns whether there is one."""
        if self._bag.storage is None:
            return self.path.exists()
        if not any(self.counts.values()):
            self._bag.abort()
            shutil.rmtree(self.path)
            return False
        with self._disk():
            self._bag.close()
        return True
