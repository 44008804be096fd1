"""Serialised messages into an MCAP bag, as they come in. No ROS."""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml
from rosbags.interfaces import Connection, Qos
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sim_core.errors import RecordingError
from sysid.recording.writer import check_name
from thinshell_ros.mcapfile import CheckedMcap

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)


class BagFile:
    """A bag being recorded: MCAP files with checksums, compressed with zstd, in one or several splits.

    ``flush`` puts everything so far on disk: a recording that is cut off by a crash keeps what came
    before the last flush, and ``read_recording`` reads it.
    """

    def __init__(
        self,
        path: str | Path,
        notes: dict[str, str] | None = None,
        max_size: int = 0,
        max_duration_s: float = 0.0,
    ) -> None:
        """Create the bag directory ``path``. ``notes``: kept in its metadata. ``max_size`` [bytes], ``max_duration_s``
        [s]: of one file, after which another begins; 0 for no limit.

        Raises:
            RecordingError: the path exists, cannot be created, or has the name of another kind of file.
        """
        self.path = Path(path).expanduser()
        if self.path.exists() or self.path.is_symlink():
            raise RecordingError(f"{self.path} exists already.", "Choose another path, or move it away first.")
        check_name(self.path)
        self._bag = Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP)
        try:
            self._bag.path.mkdir(parents=True)
            self._bag.storage = CheckedMcap(self.path, 0)
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be created: {error}.", "Choose another path.") from error
        for key, text in (notes or {}).items():
            self._bag.set_custom_data(key, text)
        self._max_size, self._max_duration_s = max_size, max_duration_s
        self._begun = time.monotonic()
        self._files: list[dict[str, Any]] = []
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
                if self._is_full(storage):
                    self._files.append(_file_entry(storage))
                    self._bag.storage = storage.follow(len(self._files))
                    self._begun = time.monotonic()

    def _is_full(self, storage: CheckedMcap) -> bool:
        large = 0 < self._max_size <= storage.size
        return large or 0.0 < self._max_duration_s <= time.monotonic() - self._begun

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
            storage: Any = self._bag.storage
            files = [*self._files, _file_entry(storage)]
            self._bag.close()
            self._list_files(files)
        return True

    def _list_files(self, files: list[dict[str, Any]]) -> None:
        """Have the metadata name all files; ``rosbags`` knows of the last one only."""
        metadata = yaml.safe_load(self._bag.metapath.read_text("utf8"))
        information = metadata["rosbag2_bagfile_information"]
        information["relative_file_paths"] = [file["path"] for file in files]
        information["files"] = files
        draft = self._bag.metapath.with_suffix(".yaml.tmp")
        draft.write_text(yaml.safe_dump(metadata, sort_keys=False, allow_unicode=True), "utf8")
        draft.replace(self._bag.metapath)


def _file_entry(storage: CheckedMcap) -> dict[str, Any]:
    """What the metadata say of a file."""
    count = sum(storage.channel_stats.values())
    start = storage.message_start_time if count else 0
    return {
        "path": storage.path.name,
        "starting_time": {"nanoseconds_since_epoch": start},
        "duration": {"nanoseconds": storage.message_end_time - start},
        "message_count": count,
    }
