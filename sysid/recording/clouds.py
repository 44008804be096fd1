"""PointCloud2 topics to marker and track streams."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_core.errors import RecordingError
from sysid.recording.arrays import Floats, Ints
from sysid.recording.messages import Series
from sysid.recording.notes import Notes
from sysid.recording.streams import CameraInfo, MarkerStream, TrackStream
from sysid.recording.times import note_gaps
from sysid.recording.topics import SensorTopic

WIDEST_M = 1.0
"""No tactile sensor or sheet on a table is wider than this, nor does a marker move farther."""

_POINT_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_UNSTABLE_IDS = 4

Cloud = dict[str, NDArray[Any]]


def cloud_fields(message: Any) -> Cloud:
    """Return the scalar fields of a PointCloud2 by name, each of shape (points,).

    Raises:
        ValueError: the message contradicts itself.
    """
    order = ">" if message.is_bigendian else "<"
    names, formats, offsets = [], [], []
    for item in message.fields:
        if item.datatype in _POINT_TYPES and item.count in (0, 1):
            names.append(str(item.name))
            formats.append(order + _POINT_TYPES[item.datatype])
            offsets.append(int(item.offset))
    step, width, height = int(message.point_step), int(message.width), int(message.height)
    data = np.asarray(message.data, dtype=np.uint8)
    row = int(message.row_step) if height > 1 else width * step
    if data.size < height * row or row < width * step:
        raise ValueError(f"holds {data.size} bytes where {height} x {width} points of {step} are stated")
    ends = [at + np.dtype(kind).itemsize for at, kind in zip(offsets, formats, strict=True)]
    if min(offsets, default=0) < 0 or max(ends, default=0) > step:
        # numpy adds in 32 bits, and reads where there is nothing.
        raise ValueError(f"has fields that reach to byte {max(ends)} of points of {step}")
    try:
        dtype = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    except ValueError as error:
        raise ValueError(f"has fields that do not fit its point_step of {step}: {error}") from error
    rows = data[: height * row].reshape(height, row)[:, : width * step]
    points = np.frombuffer(np.ascontiguousarray(rows).tobytes(), dtype=dtype)
    return {name: points[name] for name in names}


def marker_content(message: Any) -> Cloud:
    """Return the fields of a marker cloud. Raises ValueError when it has no positions."""
    return _with_fields(cloud_fields(message), ("x", "y", "z"))


def track_content(message: Any) -> Cloud:
    """Return the fields of a cloud of tracks. Raises ValueError when it has no pixel positions."""
    return _with_fields(cloud_fields(message), ("u", "v"))


def marker_stream(series: Series, declared: SensorTopic, t0_ns: int, notes: Notes) -> MarkerStream:
    """Put the clouds of one topic into arrays with one column a marker.

    Raises:
        RecordingError: ids are missing or not stable, or the unit is not plausible.
    """
    topic = series.topic
    t = series.seconds(t0_ns)
    ids, row, column, clouds = _assign(series, ("x", "y", "z"), t, notes)
    shape = (len(series.rows), len(ids))
    position = _fill(clouds, ("x", "y", "z"), row, column, shape)
    displacement = force = None
    if {"dx", "dy", "dz"} <= clouds.keys():
        displacement = _fill(clouds, ("dx", "dy", "dz"), row, column, shape)
    if {"fx", "fy", "fz"} <= clouds.keys():
        force = _fill(clouds, ("fx", "fy", "fz"), row, column, shape)
        force = force if np.isfinite(force).any() else None
    scale = _scale(topic, position, displacement, declared, notes)
    note_gaps(topic, t, notes)
    return MarkerStream(
        topic=topic,
        frame_id=series.frame_id,
        t=t,
        arrival=series.arrival(t0_ns),
        ids=ids,
        position=position * scale,
        displacement=None if displacement is None else displacement * scale,
        force=force,
    )


def track_stream(series: Series, camera: CameraInfo | None, t0_ns: int, notes: Notes) -> TrackStream:
    """Put the tracks of one topic into arrays with one column a marker.

    Raises:
        RecordingError: ids are missing or not stable.
    """
    topic = series.topic
    t = series.seconds(t0_ns)
    ids, row, column, clouds = _assign(series, ("u", "v"), t, notes)
    shape = (len(series.rows), len(ids))
    uv = _fill(clouds, ("u", "v"), row, column, shape)
    confidence = np.zeros(shape)
    if "confidence" in clouds:
        confidence[row, column] = np.nan_to_num(clouds["confidence"])
        if confidence.min() < 0.0 or confidence.max() > 1.0:
            notes.warning(topic, f"confidence from {confidence.min():.4g} to {confidence.max():.4g} limited to 0..1")
            confidence = np.clip(confidence, 0.0, 1.0)
    else:
        notes.info(topic, "no confidence given: taken as 1")
        confidence[row, column] = 1.0
    note_gaps(topic, t, notes)
    return TrackStream(
        topic=topic,
        frame_id=series.frame_id,
        t=t,
        arrival=series.arrival(t0_ns),
        ids=ids,
        uv=uv,
        confidence=confidence,
        camera_info=camera,
    )


def _with_fields(cloud: Cloud, needed: tuple[str, ...]) -> Cloud:
    missing = [name for name in needed if name not in cloud]
    if missing:
        raise ValueError(f"has no field {', '.join(missing)} (it has {', '.join(cloud) or 'none'})")
    return cloud


def _assign(series: Series, needed: tuple[str, ...], t: Floats, notes: Notes) -> tuple[Ints, Ints, Ints, Cloud]:
    """Give every point its place: message (row) and marker (column). ``t``: times of the messages [s], shape (n,).

    Returns:
        Ids of the markers (m,), row and column per point (p,), and the fields of all points (p,).
    """
    topic = series.topic
    common = Counter(frozenset(cloud) for cloud in series.rows).most_common(1)[0][0]
    sound = np.array([common <= cloud.keys() and _are_whole(cloud.get("id")) for cloud in series.rows])
    if "id" in common and not sound.any():
        raise RecordingError(f"{topic}: the field id holds numbers that are not whole.", "Write the id as UINT32.")
    if not sound.all():
        notes.count(
            "warning", topic, "message", "with other fields than most, or ids that are not whole, left out", t[~sound]
        )
    clouds = [cloud for cloud, kept in zip(series.rows, sound, strict=True) if kept]
    sizes = np.array([len(cloud[needed[0]]) if kept else 0 for cloud, kept in zip(series.rows, sound, strict=True)])
    points = {name: np.concatenate([cloud[name] for cloud in clouds]) for name in sorted(common)}
    row = np.repeat(np.arange(len(sizes)), sizes)
    if "id" in points:
        name = points["id"].astype(np.int64)
    elif len(set(sizes[sound].tolist())) == 1:
        notes.warning(topic, "no field id: markers are identified by their row")
        name = np.tile(np.arange(sizes[sound][0]), len(clouds)).astype(np.int64)
    else:
        raise RecordingError(
            f"{topic}: no field id, and from {sizes.min()} to {sizes.max()} rows a message: markers cannot "
            "be followed.",
            "Write a stable marker number in the field id (UINT32); a lost marker is a missing row.",
        )
    finite = np.all([np.isfinite(points[key]) for key in needed], axis=0)
    if not finite.all():
        notes.count("info", topic, "point", "with NaN taken as missing markers", t[row[~finite]])
    ids = np.unique(name[finite])
    if not len(ids):
        raise RecordingError(f"{topic}: no message holds a finite marker.", "Check the tracker.")
    if len(ids) > _UNSTABLE_IDS * max(int(sizes.max()), 1):
        raise RecordingError(
            f"{topic}: {len(ids)} different ids, but {int(sizes.max())} markers a message at most: the "
            "tracker numbers lost markers anew.",
            "Keep one id per marker for the whole recording, or record images instead.",
        )
    column = np.searchsorted(ids, name)
    place = row * np.int64(len(ids)) + np.minimum(column, len(ids) - 1)
    first = np.zeros(len(place), dtype=np.bool_)
    usable = np.flatnonzero(finite)
    first[usable[np.unique(place[usable], return_index=True)[1]]] = True
    doubled = finite & ~first
    if doubled.any():
        notes.count("warning", topic, "point", "with an id already used in its message dropped", t[row[doubled]])
    return ids, row[first], column[first], {key: values[first] for key, values in points.items()}


def _are_whole(ids: Any) -> bool:
    """Whether numbers of markers are whole; of a cloud without any, yes."""
    number = np.zeros(0) if ids is None else ids.astype(np.float64)
    return bool(np.isfinite(number).all() and (number == np.round(number)).all() and (np.abs(number) < 2**62).all())


def _fill(clouds: Cloud, names: tuple[str, ...], row: Ints, column: Ints, shape: tuple[int, int]) -> Floats:
    out = np.full((*shape, len(names)), np.nan)
    out[row, column] = np.stack([clouds[name].astype(np.float64) for name in names], axis=-1)
    return out


def _usual(sizes: Floats) -> float:
    """The largest of sizes [m] ``(n, 3)`` but for those of one message, which may be damaged."""
    largest = np.sort(sizes.max(axis=1))
    return float(max(largest[-2 if len(largest) > 1 else -1], 0.0))


def _scale(topic: str, position: Floats, displacement: Floats | None, declared: SensorTopic, notes: Notes) -> float:
    if declared.length_unit == "mm":
        notes.info(topic, "positions scaled from mm to m, as declared")
        return 1e-3
    if declared.length_unit is None:
        spread = _usual(np.nanmax(position, axis=1, initial=-np.inf) - np.nanmin(position, axis=1, initial=np.inf))
        moved = 0.0 if displacement is None else _usual(np.nanmax(np.abs(displacement), axis=1, initial=0.0))
        if max(spread, moved) > WIDEST_M:
            raise RecordingError(
                f"{topic}: markers spread over {spread:.4g} m and move by up to {moved:.4g} m (plausible: "
                f"{WIDEST_M:g} m); they look like millimetres.",
                "Write `length_unit: mm` into this sensor of the rig, or `length_unit: m` if metres are right.",
            )
    return 1.0
