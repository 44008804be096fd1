"""Writes recordings that follow the bag contract, without ROS."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rosbags.rosbag2 import StoragePlugin, Writer

from sim_core.errors import RecordingError
from sysid.recording.message_types import CAMERA_INFO, CLOUD, COMPRESSED, POSE, TYPESTORE, WRENCH

_F4, _U4 = 7, 6
_TYPES = {_F4: "<f4", _U4: "<u4"}
MARKER_FIELDS = (
    ("x", _F4), ("y", _F4), ("z", _F4),
    ("dx", _F4), ("dy", _F4), ("dz", _F4),
    ("fx", _F4), ("fy", _F4), ("fz", _F4),
    ("id", _U4),
)  # fmt: skip
"""Layout of a marker cloud, 40 bytes a point."""
TRACK_FIELDS = (("u", _F4), ("v", _F4), ("id", _U4), ("confidence", _F4))
"""Layout of a cloud of tracks, 16 bytes a point."""

_LATEST_NS = (2**31 - 1) * 1_000_000_000


def check_name(path: Path) -> None:
    """Raise ``RecordingError`` for a name by which other tools would take a recording for what it is not."""
    kind = {".bag": "a ROS 1 bag", ".db3": "a file of sqlite3"}.get(path.suffix.lower())
    if kind is not None:
        plain = path.with_suffix("")
        raise RecordingError(
            f"{path} has the name of {kind}, which other tools would take it for.",
            f"Name a folder, {plain}, or a single file, {plain}.mcap.",
        )


class RecordingWriter:
    """Writes one recording as an MCAP bag; a context manager.

    Messages may come in any order; they are stored in the order of their stamps, which are also the times
    of recording. The bag appears under its name only when the block ends without an exception. The same
    calls give the same bytes.

    >>> with RecordingWriter("out/press") as bag:
    ...     bag.pose("current_pose", 0, (0, 0, 0.1), (0, 0, 0, 1), "base_link")
    """

    def __init__(self, path: str | Path) -> None:
        """Prepare to write the bag directory ``path``, or the single file of a name that ends with ``.mcap``.

        Raises:
            RecordingError: the path exists, or has the name of another kind of file.
        """
        self.path = Path(path)
        self._refuse_existing()
        check_name(self.path)
        self._types: dict[str, str] = {}
        self._remarks: dict[str, str] = {}
        self._index: list[tuple[int, str, int, int]] = []  # time, topic, offset and size in the spool
        self._folder: Path | None = None
        self._spool: Any = None

    def __enter__(self) -> RecordingWriter:
        self._refuse_existing()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self._folder = Path(tempfile.mkdtemp(prefix=f".{self.path.name}.", suffix=".partial", dir=self.path.parent))
        self._spool = (self._folder / "spool").open("w+b")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._folder is not None
        try:
            if kind is None:
                made = self._folder / (self.path.stem if self.path.suffix.lower() == ".mcap" else self.path.name)
                self._store(made)
                self._refuse_existing()
                (next(made.glob("*.mcap")) if self.path.suffix.lower() == ".mcap" else made).rename(self.path)
        finally:
            self._spool.close()
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def remark(self, name: str, text: str) -> None:
        """Say something about the recording in its metadata; readers note it."""
        self._remarks[name] = text

    def pose(self, topic: str, t_ns: int, position: ArrayLike, quaternion: ArrayLike, frame_id: str) -> None:
        """Add a pose.

        Args:
            topic: for example 'current_pose'.
            t_ns: stamp [ns].
            position: [m], shape (3,).
            quaternion: unit, x y z w, shape (4,).
            frame_id: the frame that the pose is in.
        """
        p, q = _vector(topic, "position", position, 3), _vector(topic, "quaternion", quaternion, 4)
        if not (np.isfinite(p).all() and abs(float(np.linalg.norm(q)) - 1.0) < 1e-6):
            raise RecordingError(
                f"{topic}: pose {p.tolist()}, {q.tolist()} at {t_ns} ns.",
                "Give a finite position and a unit quaternion.",
            )
        pose = _make(
            "geometry_msgs/msg/Pose", position=_xyz("Point", p), orientation=_make(
                "geometry_msgs/msg/Quaternion", x=float(q[0]), y=float(q[1]), z=float(q[2]), w=float(q[3])
            ),
        )  # fmt: skip
        self._add(topic, t_ns, POSE, _make(POSE, header=_header(topic, t_ns, frame_id), pose=pose))

    def wrench(self, topic: str, t_ns: int, force: ArrayLike, torque: ArrayLike, frame_id: str) -> None:
        """Add a wrench acting on the sensor, about the origin of its frame.

        Args:
            topic: for example 'wrench'.
            t_ns: stamp [ns].
            force: [N], NaN where not measured, shape (3,).
            torque: [N m], NaN where not measured, shape (3,).
            frame_id: the sensor's frame.
        """
        f, m = _vector(topic, "force", force, 3), _vector(topic, "torque", torque, 3)
        wrench = _make("geometry_msgs/msg/Wrench", force=_xyz("Vector3", f), torque=_xyz("Vector3", m))
        self._add(topic, t_ns, WRENCH, _make(WRENCH, header=_header(topic, t_ns, frame_id), wrench=wrench))

    def markers(
        self,
        topic: str,
        t_ns: int,
        positions: ArrayLike,
        rest: ArrayLike,
        ids: ArrayLike,
        frame_id: str,
        *,
        forces: ArrayLike | None = None,
    ) -> None:
        """Add a cloud of 3-D markers. Markers with a position that is not finite are left out as lost.

        Args:
            topic: for example 'tactile/left/markers'.
            t_ns: stamp [ns].
            positions: current positions [m], shape (m, 3).
            rest: positions at rest [m], shape (m, 3).
            ids: stable numbers, shape (m,).
            frame_id: the gel's frame.
            forces: nodal forces on the sensor [N], shape (m, 3); None writes NaN.
        """
        where, name = _rows(topic, "positions", positions, 3), _ids(topic, ids)
        start = _rows(topic, "rest", rest, 3)
        force = np.full_like(where, np.nan) if forces is None else _rows(topic, "forces", forces, 3)
        if not len(where) == len(start) == len(force) == len(name):
            raise RecordingError(
                f"{topic}: {len(where)} positions, {len(start)} rest positions, {len(force)} forces and "
                f"{len(name)} ids.",
                "Give one of each a marker.",
            )
        columns = np.hstack([where, where - start, force])
        seen = np.isfinite(where).all(axis=1)
        values = {field: columns[seen, k] for k, (field, _) in enumerate(MARKER_FIELDS[:-1])}
        self._cloud(topic, t_ns, frame_id, MARKER_FIELDS, {**values, "id": name[seen]})

    def tracks(
        self, topic: str, t_ns: int, uv: ArrayLike, ids: ArrayLike, confidence: ArrayLike, frame_id: str
    ) -> None:
        """Add image-plane tracks. Markers with a position that is not finite are left out as lost.

        Args:
            topic: for example 'marker_tracks'.
            t_ns: stamp [ns].
            uv: column and row [px], shape (m, 2).
            ids: stable numbers, shape (m,).
            confidence: in 0..1, shape (m,).
            frame_id: the camera's optical frame.
        """
        where, name = _rows(topic, "uv", uv, 2), _ids(topic, ids)
        trust = _vector(topic, "confidence", confidence, len(where))
        if len(name) != len(where):
            raise RecordingError(f"{topic}: {len(where)} positions and {len(name)} ids.", "Give one id a marker.")
        if not ((trust >= 0.0) & (trust <= 1.0)).all():
            raise RecordingError(
                f"{topic}: confidence from {trust.min():g} to {trust.max():g}.", "Give numbers in 0..1."
            )
        seen = np.isfinite(where).all(axis=1)
        values = {"u": where[seen, 0], "v": where[seen, 1], "id": name[seen], "confidence": trust[seen]}
        self._cloud(topic, t_ns, frame_id, TRACK_FIELDS, values)

    def camera_info(
        self,
        topic: str,
        t_ns: int,
        K: ArrayLike,
        D: ArrayLike,
        model: str,
        width: int,
        height: int,
        frame_id: str,
    ) -> None:
        """Add the calibration of a camera.

        Args:
            topic: for example 'camera_info'.
            t_ns: stamp [ns].
            K: intrinsic matrix [px], shape (3, 3).
            D: distortion coefficients, shape (k,).
            model: 'plumb_bob', 'rational_polynomial' or 'equidistant'.
            width: [px].
            height: [px].
            frame_id: the camera's optical frame.
        """
        k = _rows(topic, "K", K, 3)
        if k.shape != (3, 3):
            raise RecordingError(f"{topic}: K has the shape {k.shape}.", "Give a 3 x 3 matrix.")
        message = _make(
            CAMERA_INFO,
            header=_header(topic, t_ns, frame_id),
            height=int(height),
            width=int(width),
            distortion_model=model,
            d=np.asarray(D, dtype=np.float64).reshape(-1),
            k=k.reshape(9),
            r=np.eye(3).reshape(9),
            p=np.hstack([k, np.zeros((3, 1))]).reshape(12),
            binning_x=0,
            binning_y=0,
            roi=_make(
                "sensor_msgs/msg/RegionOfInterest",
                x_offset=0,
                y_offset=0,
                height=0,
                width=0,
                do_rectify=False,
            ),
        )
        self._add(topic, t_ns, CAMERA_INFO, message)

    def image_compressed(
        self, topic: str, t_ns: int, image: NDArray[np.uint8] | bytes, frame_id: str, *, fmt: str = "png"
    ) -> None:
        """Add a compressed image.

        Args:
            topic: for example 'image/compressed'.
            t_ns: stamp [ns].
            image: uint8 of shape (height, width), or (height, width, 3) as red, green, blue; or bytes
                already compressed as ``fmt``.
            frame_id: the camera's optical frame.
            fmt: 'png' or 'jpeg'.
        """
        if fmt not in ("png", "jpeg"):
            raise RecordingError(f"{topic}: image format {fmt!r}.", "Use 'png' or 'jpeg'.")
        message = _make(
            COMPRESSED,
            header=_header(topic, t_ns, frame_id),
            format=fmt,
            data=np.frombuffer(image, dtype=np.uint8) if isinstance(image, bytes) else _encode(topic, image, fmt),
        )
        self._add(topic, t_ns, COMPRESSED, message)

    def _cloud(
        self,
        topic: str,
        t_ns: int,
        frame_id: str,
        layout: tuple[tuple[str, int], ...],
        values: dict[str, Any],
    ) -> None:
        points = np.zeros(len(values["id"]), dtype=[(name, _TYPES[kind]) for name, kind in layout])
        for name, column in values.items():
            points[name] = column
        step = points.dtype.itemsize
        message = _make(
            CLOUD,
            header=_header(topic, t_ns, frame_id),
            height=1,
            width=len(points),
            fields=[
                _make("sensor_msgs/msg/PointField", name=name, offset=4 * k, datatype=kind, count=1)
                for k, (name, kind) in enumerate(layout)
            ],
            is_bigendian=False,
            point_step=step,
            row_step=step * len(points),
            data=np.frombuffer(points.tobytes(), dtype=np.uint8),
            is_dense=all(bool(np.isfinite(column).all()) for column in values.values()),
        )
        self._add(topic, t_ns, CLOUD, message)

    def _add(self, topic: str, t_ns: int, msgtype: str, message: Any) -> None:
        if self._folder is None:
            raise RecordingError(f"{self.path} is not open.", "Write inside `with RecordingWriter(path) as bag:`.")
        name = "/" + topic.strip("/")
        known = self._types.setdefault(name, msgtype)
        if known != msgtype:
            raise RecordingError(f"{name} already holds {known}, not {msgtype}.", "Use another topic.")
        data = bytes(TYPESTORE.serialize_cdr(message, msgtype))
        self._index.append((int(t_ns), name, self._spool.tell(), len(data)))
        self._spool.write(data)

    def _store(self, folder: Path) -> None:
        if not self._index:
            raise RecordingError(f"{self.path}: nothing was written.", "Add messages before the block ends.")
        writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        for name, text in self._remarks.items():
            writer.set_custom_data(name, text)
        with writer as bag:
            connections = {
                name: bag.add_connection(name, msgtype, typestore=TYPESTORE) for name, msgtype in self._types.items()
            }
            for t_ns, name, offset, size in sorted(self._index, key=lambda item: item[0]):
                self._spool.seek(offset)
                bag.write(connections[name], t_ns, self._spool.read(size))

    def _refuse_existing(self) -> None:
        if self.path.exists() or self.path.is_symlink():
            raise RecordingError(f"{self.path} exists already.", "Choose another path, or move it away first.")


def _make(msgtype: str, **values: Any) -> Any:
    return TYPESTORE.types[msgtype](**values)


def _xyz(name: str, v: NDArray[np.float64]) -> Any:
    return _make(f"geometry_msgs/msg/{name}", x=float(v[0]), y=float(v[1]), z=float(v[2]))


def _header(topic: str, t_ns: int, frame_id: str) -> Any:
    if not 0 <= t_ns <= _LATEST_NS:
        raise RecordingError(f"{topic}: stamp {t_ns} ns.", f"Give a whole number in 0..{_LATEST_NS}.")
    seconds, rest = divmod(int(t_ns), 1_000_000_000)
    stamp = _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame_id)


def _vector(topic: str, what: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape != (size,):
        raise RecordingError(f"{topic}: {what} has the shape {vector.shape}.", f"Give {size} numbers.")
    return vector


def _rows(topic: str, what: str, values: ArrayLike, size: int) -> NDArray[np.float64]:
    rows = np.asarray(values, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != size:
        raise RecordingError(f"{topic}: {what} has the shape {rows.shape}.", f"Give rows of {size} numbers.")
    return rows


def _ids(topic: str, ids: ArrayLike) -> NDArray[np.int64]:
    name = np.asarray(ids)
    fit = name.ndim == 1 and (name.size == 0 or (name.dtype.kind in "iu" and name.min() >= 0 and name.max() < 2**32))
    if not fit or len(np.unique(name)) != len(name):
        raise RecordingError(f"{topic}: ids {name!r}.", "Give whole numbers in 0..2^32-1, each once.")
    return name.astype(np.int64)


def _encode(topic: str, image: NDArray[np.uint8], fmt: str) -> NDArray[np.uint8]:
    if image.dtype != np.uint8 or not (image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)):
        raise RecordingError(
            f"{topic}: image of shape {image.shape}, {image.dtype}.", "Give uint8, grey or red-green-blue."
        )
    import cv2

    ordered = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    return np.asarray(cv2.imencode(f".{fmt}", ordered)[1], dtype=np.uint8).reshape(-1)
