"""Messages and small recordings, sound ones by default, for the tests of what is read from bags."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from sysid.recording import Recording, TopicNames, read_recording

MS = 1_000_000
START = 1_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"
CLOUD, INFO = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/CameraInfo"
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
KINDS = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}

Item = tuple[str, str, int, Any]  # topic, type, log time [ns], message


def make(msgtype: str, **values: Any) -> Any:
    return STORE.types[msgtype](**values)


def header(stamp_ns: int, frame: str) -> Any:
    seconds, rest = divmod(stamp_ns, 1_000_000_000)
    stamp = make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def pose(stamp_ns: int, p=(0.0, 0.0, 0.1), q=(0.0, 0.0, 0.0, 1.0), frame: str = "base_link") -> Any:
    point = make("geometry_msgs/msg/Point", **dict(zip("xyz", map(float, p), strict=True)))
    turn = make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, q), strict=True)))
    body = make("geometry_msgs/msg/Pose", position=point, orientation=turn)
    return make(POSE, header=header(stamp_ns, frame), pose=body)


def wrench(stamp_ns: int, f=(0.0, 0.0, 1.0), m=(0.0, 0.0, 0.0), frame: str = "gel") -> Any:
    force, torque = (make("geometry_msgs/msg/Vector3", **dict(zip("xyz", map(float, v), strict=True))) for v in (f, m))
    body = make("geometry_msgs/msg/Wrench", force=force, torque=torque)
    return make(WRENCH, header=header(stamp_ns, frame), wrench=body)


def cloud(
    stamp_ns: int,
    columns: dict[str, Any],
    *,
    kinds: dict[str, str] | None = None,
    order: str = "<",
    gap: int = 0,
    rows: int = 1,
    row_padding: int = 0,
) -> Any:
    """A PointCloud2 with ``gap`` unused bytes after every field, as several rows if wanted."""
    kinds = {name: "f4" for name in columns} | {"id": "u4"} | (kinds or {})
    formats = [order + kinds[name] for name in columns]
    sizes = [np.dtype(f).itemsize + gap for f in formats]
    offsets = np.concatenate(([0], np.cumsum(sizes)[:-1])).tolist()
    dtype = np.dtype({"names": list(columns), "formats": formats, "offsets": offsets, "itemsize": int(sum(sizes))})
    points = np.zeros(len(next(iter(columns.values()))), dtype=dtype)
    for name, values in columns.items():
        points[name] = values
    width = len(points) // rows
    raw = np.frombuffer(points.tobytes(), dtype=np.uint8).reshape(rows, width * dtype.itemsize)
    padded = np.pad(raw, ((0, 0), (0, row_padding)))
    return make(
        CLOUD,
        header=header(stamp_ns, "gel"),
        height=rows,
        width=width,
        fields=[
            make("sensor_msgs/msg/PointField", name=name, offset=int(at), datatype=KINDS[kinds[name]], count=1)
            for name, at in zip(columns, offsets, strict=True)
        ],
        is_bigendian=order == ">",
        point_step=dtype.itemsize,
        row_step=padded.shape[1],
        data=padded.reshape(-1),
        is_dense=False,
    )


def store(path: Path, items: list[Item]) -> Path:
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        made: dict[str, Any] = {}
        for topic, msgtype, log_ns, message in items:
            if topic not in made:
                made[topic] = bag.add_connection(topic, msgtype, typestore=STORE)
            data = message if isinstance(message, bytes) else STORE.serialize_cdr(message, msgtype)
            bag.write(made[topic], log_ns, data)
    return path


def log_time(k: int) -> int:
    return START + 10 * MS * k


def poses(count: int = 20, **options: Any) -> list[Item]:
    return [
        ("/current_pose", POSE, log_time(k), pose(log_time(k), (1e-4 * k, 0, 0.1), **options)) for k in range(count)
    ]


def wrenches(count: int = 20, stamp: Callable[[int], int] = log_time, **options: Any) -> list[Item]:
    return [("/wrench", WRENCH, log_time(k), wrench(stamp(k), (0, 0, 0.1 * k), **options)) for k in range(count)]


def read(tmp_path: Path, items: list[Item], topics: TopicNames | None = None, **options: Any) -> Recording:
    return read_recording(store(tmp_path / "bag", items), topics, **options)


def notes(recording: Recording) -> str:
    return "\n".join(map(str, recording.notes))


XYZ = {
    "x": np.array([0.0, 0.001, 0.002]),
    "y": np.array([0.0, 0.0, 0.001]),
    "z": np.array([0.003, 0.0, 0.0]),
}
IDS = np.array([4, 9, 2])
UV = {"u": np.array([1.0, 20.0, 30.5]), "v": np.array([4.0, 5.0, 6.0])}


def markers(columns: Callable[[int], dict[str, Any]], count: int = 6, **options: Any) -> list[Item]:
    return [("/markers", CLOUD, t, cloud(t, columns(k), **options)) for k, t in enumerate(map(log_time, range(count)))]


def tracks(columns: dict[str, Any], count: int = 6) -> list[Item]:
    return [("/marker_tracks", CLOUD, t, cloud(t, columns)) for t in map(log_time, range(count))]
