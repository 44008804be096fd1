"""Checks of marker identity that need no ground truth: the neighbourhood, and the way back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError

from sysid.vision.detect import Detections
from sysid.vision.field import Points
from sysid.vision.match import match_layout
from sysid.vision.track import FrameTracks, TrackParameters, similar_frames


@dataclass(frozen=True)
class CycleCheck:
    """Numbers of a frame reached directly and by way of another frame."""

    frames: int
    """Frames compared."""
    compared: int
    """Markers compared."""
    agreeing: int
    """Markers with the same number on both ways."""
    worst_frame: int
    """Frame with the least agreement, -1 when nothing was compared."""
    worst_rate: float
    """Agreement in that frame, 0..1."""

    @property
    def rate(self) -> float:
        """Part of the markers with the same number on both ways, 0..1; NaN when nothing was compared."""
        return self.agreeing / self.compared if self.compared else float("nan")


def triangles_of(points: Points, *, min_angle_deg: float = 15.0) -> NDArray[np.intp]:
    """Return the Delaunay triangles without slivers, shape ``(t, 3)``."""
    if len(points) < 4:
        return np.zeros((0, 3), dtype=np.intp)
    try:
        corners = np.asarray(Delaunay(points).simplices, dtype=np.intp)
    except QhullError:
        return np.zeros((0, 3), dtype=np.intp)
    a, b, c = (points[corners[:, k]] for k in range(3))
    sides = np.stack([b - c, c - a, a - b], axis=1)
    length = np.linalg.norm(sides, axis=2)
    area = np.abs(signed_areas(points, corners))
    # The smallest angle lies between the two longer sides.
    sine = 2.0 * area * length.min(axis=1) / np.maximum(length.prod(axis=1), 1e-12)
    return np.asarray(corners[sine > np.sin(np.radians(min_angle_deg))])


def signed_areas(points: Points, corners: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the signed areas [px^2] of triangles, shape ``(t,)``."""
    a, b, c = (points[corners[:, k]] for k in range(3))
    ab, ac = b - a, c - a
    return np.asarray(0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]), dtype=float)


def folded_fraction(reference: Points, uv: Points) -> float:
    """Return the part of the reference's triangles that are turned over in a frame; NaN without triangles.

    Both ``(m, 2)`` [px]; rows of ``uv`` that are NaN are left out. A skin cannot fold, so anything above 0
    is a wrong number; but a row that slipped along itself by one marker folds little: see the edges.
    """
    seen = np.isfinite(uv[:, 0])
    corners = triangles_of(reference[seen])
    if not len(corners):
        return float("nan")
    before, after = signed_areas(reference[seen], corners), signed_areas(uv[seen], corners)
    return float(np.mean(before * after <= 0.0))


def flipped_edges(reference: Points, uv: Points) -> float:
    """Return the part of the reference's Delaunay edges that are no Delaunay edges in a frame.

    Rows of ``uv`` that are NaN are left out. Strong shear flips some edges of a square-like lattice even
    when all numbers are right; a row taken for the next one flips most edges along the fault.
    """
    seen = np.isfinite(uv[:, 0])
    edges, after = _edges(triangles_of(reference[seen])), _edges(triangles_of(uv[seen], min_angle_deg=0.0))
    if not edges:
        return float("nan")
    return len(edges - after) / len(edges)


def _edges(corners: NDArray[np.intp]) -> set[tuple[int, int]]:
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    return {(int(a), int(b)) for a, b in np.sort(pairs, axis=1)}


def cycle_check(
    tracks: FrameTracks,
    detections: Sequence[Detections],
    parameters: TrackParameters | None = None,
    *,
    frames: int = 100,
) -> CycleCheck:
    """Compare each frame's numbers with those it gets by way of a similar frame.

    The similar frame's markers, with the numbers it got on its own, become the reference for the frame;
    up to ``frames`` evenly spaced frames are compared.
    """
    parameters = parameters or TrackParameters()
    good = np.flatnonzero(~tracks.failed)
    if len(good) < 2:
        return CycleCheck(0, 0, 0, -1, float("nan"))
    picked = good[np.unique(np.linspace(0, len(good) - 1, min(frames, len(good))).round().astype(int))]
    compared = agreeing = done = 0
    worst_frame, worst_rate = -1, 1.0
    pitch = tracks.reference.pitch_px
    for k in picked:
        similar = similar_frames(detections, int(k), [int(other) for other in good], pitch, 1)
        if not similar:
            continue
        numbers = np.flatnonzero(tracks.found[similar[0]])
        found = detections[k]
        way = match_layout(
            tracks.uv[similar[0], numbers],
            found.uv,
            found.quality,
            view=found.image_size,
            parameters=parameters.match,
        )
        direct = tracks.matches[k].index[numbers]
        both = (direct >= 0) & way.found
        same = both & (direct == way.index)
        done += 1
        compared += int(both.sum())
        agreeing += int(same.sum())
        rate = float(same.sum() / both.sum()) if both.any() else 0.0
        if rate < worst_rate or worst_frame < 0:
            worst_frame, worst_rate = int(k), rate
    return CycleCheck(done, compared, agreeing, worst_frame, worst_rate)
