"""Identity of markers over a sequence of frames, close in time or each a press of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from sysid.vision.detect import Detections
from sysid.vision.field import Points
from sysid.vision.match import LayoutMatch, MatchParameters, match_layout
from sysid.vision.reference import CONTINUITY_PITCH, Reference, follows_closely, mean_squared_gap

_FRAMES_TO_JUDGE = 10
"""Fewer frames than this do not tell glare from a marker that is hidden now and then."""


@dataclass(frozen=True)
class TrackParameters:
    """How frames are matched, and when a frame is given up."""

    match: MatchParameters = field(default_factory=MatchParameters)
    """How one frame is matched."""
    fail_cost: float = 0.03
    """A frame whose match costs more than this [pitch^2] keeps no tracks: its numbers may be wrong."""
    min_found: float = 0.5
    """A frame with a smaller part of the markers keeps no tracks."""
    min_seen: float = 0.75
    """A reference blob found in a smaller part of the frames is glare, not a marker, and is dropped."""
    likely_frames: int = 3
    """Number of similar frames tried as a start for a frame that could not be matched."""


@dataclass(frozen=True)
class FrameTracks:
    """Markers of a reference followed through ``n`` frames, one column a marker."""

    reference: Reference
    """The layout, ``m`` markers."""
    uv: NDArray[np.float64]
    """Positions [px], NaN where lost, shape ``(n, m, 2)``."""
    confidence: NDArray[np.float64]
    """Trust in 0..1, 0 where lost, shape ``(n, m)``."""
    residual_px: NDArray[np.float64]
    """Distance [px] to the place that the neighbours predict, NaN where lost, shape ``(n, m)``."""
    place: NDArray[np.float64]
    """Positions [px] with the smooth field's guess where lost, shape ``(n, m, 2)``."""
    matches: tuple[LayoutMatch, ...]
    """The match of each frame, also of frames given up."""
    failed: NDArray[np.bool_]
    """True for frames given up, shape ``(n,)``."""
    dropped: Points
    """Blobs of the reference frame [px] that were taken for glare, shape ``(k, 2)``."""

    @property
    def found(self) -> NDArray[np.bool_]:
        """True where a marker has a position, shape ``(n, m)``."""
        return np.asarray(np.isfinite(self.uv[:, :, 0]))


def track_frames(
    detections: Sequence[Detections],
    reference: Reference,
    parameters: TrackParameters | None = None,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> FrameTracks:
    """Match every frame to the reference layout.

    A frame that is close to the one before starts from it; any other starts from the whole pattern. What
    remains unsolved is tried again from the most similar solved frames. ``progress`` is called with the
    number of frames done and to do.
    """
    parameters = parameters or TrackParameters()
    continuous = follows_closely(detections)
    matches: list[LayoutMatch] = []
    for k, found in enumerate(detections):
        matches.append(_match_next(reference, found, matches[-1] if matches else None, continuous, parameters))
        if progress is not None:
            progress(k + 1, len(detections))
    _retry(reference, detections, matches, parameters)
    seen = _seen_rate(detections, matches, continuous)
    keep = seen >= parameters.min_seen * max(float(np.median(seen)), 1e-9)
    if keep.sum() < 4:
        keep[:] = True
    dropped = reference.uv[~keep]
    if len(dropped):
        reference = replace(reference, uv=reference.uv[keep])
        matches = [
            replace(match, index=match.index[keep], uv=match.uv[keep], residual_px=match.residual_px[keep])
            for match in matches
        ]
    return _collect(reference, detections, matches, dropped, parameters)


def _match_next(
    reference: Reference,
    found: Detections,
    before: LayoutMatch | None,
    continuous: bool,
    parameters: TrackParameters,
) -> LayoutMatch:
    """Match a frame from the one before if it is close to it, else from the whole pattern.

    Only where the whole sequence is continuous may markers enter the image that the reference lacks; a
    lone press that looks close to the one before may be one row further on a lattice.
    """
    if before is not None and before.cost <= parameters.match.accept_cost and len(found) >= 4:
        if is_close(before, found, reference.pitch_px):
            starts = {"previous frame": before.uv}
            for whole in (True, False) if continuous else (True,):
                match = _match(reference, found, starts, False, parameters, whole=whole)
                if match.cost <= parameters.match.accept_cost:
                    return match
    return _match(reference, found, {}, True, parameters)


def is_close(before: LayoutMatch, found: Detections, pitch_px: float) -> bool:
    """Whether most markers of a frame are within :data:`CONTINUITY_PITCH` of where they were in the one before."""
    gap = cKDTree(found.uv).query(before.uv[before.found])[0]
    return bool(np.percentile(gap, 80) < CONTINUITY_PITCH * pitch_px)


def _match(
    reference: Reference,
    found: Detections,
    starts: dict[str, Points],
    search: bool,
    parameters: TrackParameters,
    *,
    whole: bool = True,
) -> LayoutMatch:
    return match_layout(
        reference.uv,
        found.uv,
        found.quality,
        starts=starts,
        search=search,
        whole=whole,
        view=found.image_size,
        parameters=parameters.match,
    )


def _retry(
    reference: Reference,
    detections: Sequence[Detections],
    matches: list[LayoutMatch],
    parameters: TrackParameters,
) -> None:
    """Solve frames that cost too much from the most similar frames that do not, as long as it helps."""
    accept = parameters.match.accept_cost
    while True:
        good = [k for k, match in enumerate(matches) if match.cost <= accept]
        bad = [k for k, match in enumerate(matches) if match.cost > accept and len(detections[k]) >= 4]
        improved = False
        for k in bad:
            similar = similar_frames(detections, k, good, reference.pitch_px, parameters.likely_frames)
            if not similar:
                continue
            starts = {f"frame {other}": matches[other].uv for other in similar}
            again = _match(reference, detections[k], starts, False, parameters)
            if again.cost < matches[k].cost - 1e-4:
                matches[k] = again
                improved = True
        if not improved:
            return


def similar_frames(
    detections: Sequence[Detections], k: int, among: Sequence[int], pitch: float, count: int
) -> list[int]:
    """Return the ``count`` frames of ``among`` whose markers lie nearest to those of frame ``k``."""
    others = [other for other in among if other != k and len(detections[other]) >= 4]
    gaps = [mean_squared_gap(detections[k].uv, detections[other].uv, pitch) for other in others]
    return [others[place] for place in np.argsort(gaps)[:count]]


def _seen_rate(
    detections: Sequence[Detections], matches: Sequence[LayoutMatch], continuous: bool
) -> NDArray[np.float64]:
    """Return the part of the frames that show each marker, shape ``(m,)``.

    In a continuous sequence markers may leave the image for good, so only frames count in which the marker
    is inside; single presses show the whole pattern but for a rim. A marker that few frames can show counts
    as seen.
    """
    found = np.array([match.found for match in matches])
    count = np.full(found.shape[1], len(found))
    if continuous:
        place = np.array([match.uv for match in matches])
        last = np.array([blobs.image_size for blobs in detections], dtype=float)[:, None, :] - 1.0
        count = np.sum(((place >= 0.0) & (place <= last)).all(axis=2) | found, axis=0)
    return np.where(count >= _FRAMES_TO_JUDGE, found.sum(axis=0) / np.maximum(count, 1), 1.0)


def _collect(
    reference: Reference,
    detections: Sequence[Detections],
    matches: list[LayoutMatch],
    dropped: Points,
    parameters: TrackParameters,
) -> FrameTracks:
    frames, markers = len(matches), len(reference)
    uv = np.full((frames, markers, 2), np.nan)
    residual = np.full((frames, markers), np.nan)
    confidence = np.zeros((frames, markers))
    failed = np.zeros(frames, dtype=bool)
    for k, (match, found) in enumerate(zip(matches, detections, strict=True)):
        uv[k], confidence[k], residual[k], failed[k] = markers_of(match, found, reference.pitch_px, parameters)
    place = np.array([match.uv for match in matches]).reshape(frames, markers, 2)
    return FrameTracks(reference, uv, confidence, residual, place, tuple(matches), failed, dropped)


def markers_of(
    match: LayoutMatch, found: Detections, pitch_px: float, parameters: TrackParameters
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], bool]:
    """What a match of one frame is worth: positions [px] ``(m, 2)``, NaN where lost, trust in 0..1 and distance [px] to
    the place that the neighbours predict ``(m,)``, and whether the frame is given up."""
    uv, residual = np.full((len(match.index), 2), np.nan), np.full(len(match.index), np.nan)
    confidence = np.zeros(len(match.index))
    if match.cost > parameters.fail_cost or match.found.mean() < parameters.min_found:
        return uv, confidence, residual, True
    rows = np.flatnonzero(match.found)
    uv[rows] = found.uv[match.index[rows]]
    residual[rows] = match.residual_px[rows]
    fit = np.exp(-((match.residual_px[rows] / (0.2 * pitch_px)) ** 2))
    doubt = 1.0 if match.cost <= parameters.match.accept_cost else 0.5
    confidence[rows] = np.clip(doubt * fit * found.quality[match.index[rows]], 0.0, 1.0)
    return uv, confidence, residual, False
