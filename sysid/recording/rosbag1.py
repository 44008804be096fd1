"""ROS 1 bags: what this package reads of them, written as a ROS 2 recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rosbags.rosbag1 import Reader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sim_core.errors import RecordingError
from sysid.recording.message_types import ROLES, TF, TYPESTORE

MAGIC = b"#ROSBAG V"

_WANTED = {msgtype for _, types in ROLES.values() for msgtype in types} | {TF}
_NAMES = {"tf/msg/tfMessage": TF}
"""Types that have another name in ROS 2."""


def write_as_ros2(path: Path, out: Path, shown: Path) -> tuple[str, ...]:
    """Write the messages of a ROS 1 bag that have types of the contract into the recording ``out``, which must not
    exist. Returns what could not be read, in words.

    Raises:
        RecordingError: nothing in it can be read.
    """
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TF))
    damaged = 0
    try:
        with Reader(path) as bag, Writer(out, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            made: dict[tuple[str, str], Any] = {}
            for connection in bag.connections:
                msgtype = _NAMES.get(connection.msgtype, connection.msgtype)
                if (connection.topic, msgtype) not in made and msgtype in TYPESTORE.fielddefs:
                    made[(connection.topic, msgtype)] = writer.add_connection(
                        connection.topic, msgtype, typestore=TYPESTORE
                    )
            wanted = [c for c in bag.connections if _NAMES.get(c.msgtype, c.msgtype) in _WANTED]
            for connection, log_ns, raw in bag.messages(wanted) if wanted else ():
                msgtype = _NAMES.get(connection.msgtype, connection.msgtype)
                try:
                    source = store.deserialize_ros1(raw, _in_ros1(connection.msgtype))
                    data = TYPESTORE.serialize_cdr(_migrated(source, msgtype), msgtype)
                except Exception:  # of code that rosbags generates, on bytes that may be anything
                    damaged += 1
                    continue
                writer.write(made[(connection.topic, msgtype)], log_ns, data)
    except Exception as error:  # ReaderError, and what a damaged index leads the reader into
        raise RecordingError(
            f"{shown} is a ROS 1 bag that cannot be read: {' '.join(str(error).split())}.",
            "Mend a copy with `rosbag reindex` or `rosbag fix`, or convert it with rosbags-convert.",
        ) from error
    return (f"{damaged} messages of the ROS 1 bag cannot be read",) if damaged else ()


def _in_ros1(msgtype: str) -> str:
    return TF if msgtype in _NAMES else msgtype


def _migrated(message: Any, msgtype: str) -> Any:
    """A message of ROS 1 as one of ROS 2: without ``seq``, with the names of fields in small letters."""
    fields = dict(TYPESTORE.fielddefs[msgtype][1])
    values: dict[str, Any] = {}
    for name, (kind, description) in fields.items():
        value = getattr(message, name, None)
        if value is None:
            value = getattr(message, name.upper())
        if int(kind) == _NAME:
            value = _migrated(value, str(description))
        elif int(kind) in (_ARRAY, _SEQUENCE) and int(description[0][0]) == _NAME:
            inner = str(description[0][1])
            value = [_migrated(item, inner) for item in value]
        values[name] = value
    return TYPESTORE.types[msgtype](**values)


_NAME, _ARRAY, _SEQUENCE = 2, 3, 4
"""Kinds of fields of the type store: another type, and arrays and sequences of one."""
