"""Points of marker and track clouds, in the layout of the bag contract. No ROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.recording.writer import MARKER_FIELDS, TRACK_FIELDS

Points = NDArray[Any]
"""Structured array, one record a point."""

_TYPES = {7: "<f4", 6: "<u4"}  # sensor_msgs/PointField FLOAT32 and UINT32


def _dtype(layout: tuple[tuple[str, int], ...]) -> np.dtype[Any]:
    return np.dtype([(name, _TYPES[kind]) for name, kind in layout])


MARKER_POINT = _dtype(MARKER_FIELDS)
TRACK_POINT = _dtype(TRACK_FIELDS)


def marker_points(positions: NDArray[np.float64], rest: NDArray[np.float64], ids: NDArray[Any]) -> Points:
    """Points of markers at ``positions`` [m] ``(m, 3)`` that were at ``rest`` [m] ``(m, 3)``.

    Markers without a finite position are left out as lost. Nodal forces are not known: NaN.
    """
    seen = np.isfinite(positions).all(axis=1)
    points = np.full(int(seen.sum()), np.nan, dtype=[(name, "f8") for name, _ in MARKER_FIELDS])
    for axis, name in enumerate("xyz"):
        points[name] = positions[seen, axis]
        points["d" + name] = positions[seen, axis] - rest[seen, axis]
    points["id"] = ids[seen]
    return points.astype(MARKER_POINT)


def track_points(
    pixels: NDArray[np.float64], ids: NDArray[Any], confidence: NDArray[np.float64] | float = 1.0
) -> Points:
    """Points of tracks at ``pixels`` [px] ``(m, 2)``; those that are not finite are left out as lost."""
    seen = np.isfinite(pixels).all(axis=1)
    points = np.zeros(int(seen.sum()), dtype=TRACK_POINT)
    points["u"], points["v"] = pixels[seen].T
    points["id"] = ids[seen]
    points["confidence"] = np.broadcast_to(confidence, seen.shape)[seen]
    return points


def marker_positions(
    data: bytes, point_step: int, layout: Mapping[str, tuple[int, int]]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Ids ``(m,)`` and positions [m] ``(m, 3)`` of the markers in the data of a cloud. ``layout``: offset and type of
    each field; a cloud without x, y, z and id, or of other types, has no markers that could be identified."""
    wanted = {"x": 7, "y": 7, "z": 7, "id": 6}
    fits = point_step > 0 and len(data) % point_step == 0
    if not fits or any(layout.get(name, (0, 0))[1] != kind for name, kind in wanted.items()):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    offsets = [layout[name][0] for name in wanted]
    if max(offsets) + 4 > point_step:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    kind = np.dtype(
        {
            "names": list(wanted),
            "formats": [_TYPES[kind] for kind in wanted.values()],
            "offsets": offsets,
            "itemsize": point_step,
        }
    )
    points = np.frombuffer(data, dtype=kind)
    return points["id"].astype(np.int64), np.column_stack([points[axis] for axis in "xyz"]).astype(np.float64)
