"""A small recording, and the same in other storages and compressions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sysid.recording import Recording, RecordingWriter

COUNT = 400
MS = 1_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)


def write(path: Path, start: int = 0, stop: int = COUNT) -> Path:
    with RecordingWriter(path) as bag:
        for k in range(start, stop):
            t = 10 * MS * (k + 1)
            bag.pose("current_pose", t, (1e-5 * k, 0, 0.1), (0, 0, 0, 1), "base_link")
            bag.wrench("wrench", t, (0, 0, 0.01 * k), (0, 0, 0), "gel")
    return path


def rewrite(source: Path, target: Path, plugin: StoragePlugin, mode: CompressionMode) -> Path:
    """Write a recording again with another storage or compression."""
    writer = Writer(target, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with Reader(source) as old, writer as new:
        made = {c.topic: new.add_connection(c.topic, c.msgtype, typestore=STORE) for c in old.connections}
        for connection, stamp, raw in old.messages():
            new.write(made[connection.topic], stamp, raw)
    return target


def repack(source: Path, target: Path, **options) -> Path:
    """Write an .mcap file again with the mcap library."""
    with source.open("rb") as old, target.open("wb") as new:
        writer = McapWriter(new, **options)
        writer.start(profile="ros2", library="test")
        ids: dict[str, int] = {}
        for schema, channel, message in make_reader(old).iter_messages():
            assert schema is not None
            if channel.topic not in ids:
                ids[channel.topic] = writer.register_channel(
                    channel.topic, "cdr", writer.register_schema(schema.name, schema.encoding, schema.data)
                )
            writer.add_message(ids[channel.topic], message.log_time, message.data, message.publish_time)
        writer.finish()
    return target


def assert_whole(recording: Recording) -> None:
    np.testing.assert_array_equal(recording.poses["ee"].position[:, 0], 1e-5 * np.arange(COUNT))
    np.testing.assert_array_equal(recording.wrenches["sensor"].force[:, 2], 0.01 * np.arange(COUNT))


def notes(recording: Recording) -> str:
    return "\n".join(map(str, recording.notes))


def edit_metadata(bag: Path, change) -> None:
    content = yaml.safe_load((bag / "metadata.yaml").read_text())
    change(content["rosbag2_bagfile_information"])
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
