"""The reference layout: which frame gives the markers their numbers, and which of its blobs are markers."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from sim_core.errors import RecordingError
from sysid.vision.detect import Detections
from sysid.vision.field import Points, pitch_of

CONTINUITY_PITCH = 0.3
"""Two frames follow one another when the markers move less than this part of the pitch between them."""


@dataclass(frozen=True)
class Reference:
    """The layout that all frames are matched to; a marker's number is its row here."""

    uv: Points
    """Positions [px], shape ``(m, 2)``."""
    frame: int
    """The frame it was taken from."""
    source: str
    """Why that frame, in words."""

    def __len__(self) -> int:
        """Return the number of markers."""
        return len(self.uv)

    @property
    def pitch_px(self) -> float:
        """Typical distance between neighbouring markers [px]."""
        return pitch_of(self.uv)


def choose_reference(
    detections: Sequence[Detections],
    *,
    choice: str | int = "auto",
    posed: NDArray[np.bool_] | None = None,
    depth: NDArray[np.float64] | None = None,
) -> Reference:
    """Choose the reference frame and clean its layout.

    ``choice`` is ``auto``, ``first``, ``typical``, ``shallowest`` or a frame number. ``posed`` tells which
    frames have a pose of the end effector, ``depth`` is the press depth in any unit (NaN where not known),
    both of shape ``(n,)``. ``auto`` takes, in this order: the first frame if it alone has no pose (a rest
    image), the shallowest press if depths are given, the first frame if the frames follow one another
    closely, else the most typical frame.
    """
    frame, source = _choose(detections, choice, posed, depth)
    found = detections[frame]
    rows = main_pattern(found)
    if len(rows) < 4:
        why = f": {found.note}" if found.note else ""
        raise RecordingError(
            f"Frame {frame} ({source}) shows {len(rows)} markers{why}; a layout needs 4.",
            "Choose another reference frame, or set the marker size and polarity.",
        )
    return Reference(found.uv[rows], frame, source)


def _choose(
    detections: Sequence[Detections],
    choice: str | int,
    posed: NDArray[np.bool_] | None,
    depth: NDArray[np.float64] | None,
) -> tuple[int, str]:
    counts = np.array([len(found) for found in detections])
    if not counts.size or counts.max() < 4:
        notes = sorted({found.note for found in detections if found.note})
        raise RecordingError(
            f"No marker pattern in any of {len(detections)} images" + (f": {notes[0]}." if notes else "."),
            "Use images of a sensor with markers, or set the marker size and polarity.",
        )
    if isinstance(choice, int):
        if not 0 <= choice < len(detections):
            raise RecordingError(f"Reference frame {choice} does not exist.", f"Give 0 to {len(detections) - 1}.")
        return choice, "chosen by number"
    depths_known = depth is not None and bool(np.isfinite(depth).any())
    if choice == "shallowest" and not depths_known:
        raise RecordingError(
            "The shallowest press cannot be found: no depth is known for any image.",
            "Name the axis of the pose that is the depth, or choose another reference.",
        )
    rest = posed is not None and len(posed) > 2 and not posed[0] and float(posed[1:].mean()) > 0.8
    if choice == "auto" and rest:
        return 0, "the first image, which alone has no pose: the unloaded sensor"
    if choice in ("auto", "shallowest") and depths_known:
        assert depth is not None
        usable = np.where(counts >= 0.9 * np.median(counts), depth, np.nan)
        return int(np.nanargmin(usable)), f"the lightest press (depth {np.nanmin(usable):.3g}); no rest image"
    if choice == "first" or (choice == "auto" and follows_closely(detections)):
        first = int(np.argmax(counts >= 0.9 * np.median(counts)))
        return first, "the first image with most markers, the images follow one another closely"
    if choice in ("auto", "typical"):
        why = "; no rest image and no depth known" if choice == "auto" else ""
        return _most_typical(detections), f"the most typical image{why}"
    raise RecordingError(
        f"The reference {choice!r} is not known.",
        "Use auto, first, typical, shallowest or the number of a frame.",
    )


def follows_closely(detections: Sequence[Detections]) -> bool:
    """Tell whether markers move less than 0.3 pitch between most successive frames.

    On a lattice the nearest marker is never further than about half a pitch, so the test looks at the
    distance in the middle of the pattern of distances: unrelated frames have a median near 0.3 pitch.
    """
    steps = []
    for before, after in itertools.pairwise(detections):
        if len(before) >= 4 and len(after) >= 4:
            pitch = pitch_of(before.uv)
            gap = cKDTree(after.uv).query(before.uv)[0]
            steps.append(float(np.percentile(gap, 80)) / max(pitch, 1e-9))
    return bool(steps) and float(np.median(steps)) < CONTINUITY_PITCH


def main_pattern(found: Detections) -> NDArray[np.intp]:
    """Return the rows of the largest group of marker-like blobs that lie within reach of one another."""
    rows = np.flatnonzero(found.quality > 0.35)
    if len(rows) < 4:
        return rows
    uv = found.uv[rows]
    pairs = cKDTree(uv).query_pairs(1.6 * pitch_of(uv), output_type="ndarray")
    links = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(uv), len(uv)))
    _, group = connected_components(links, directed=False)
    return np.asarray(rows[group == np.bincount(group).argmax()])


def mean_squared_gap(first: Points, second: Points, pitch: float) -> float:
    """Return how far apart two sets of points are, mean squared gap [pitch^2], each gap limited to 0.6."""
    gap = cKDTree(second).query(first)[0] / pitch
    return float(np.mean(np.minimum(gap, 0.6) ** 2))


def _most_typical(detections: Sequence[Detections], sample: int = 60) -> int:
    """Return the frame nearest to all others, among evenly spaced frames with the usual marker count."""
    counts = np.array([len(found) for found in detections])
    full = np.flatnonzero(counts >= 0.95 * np.percentile(counts, 80))
    picked = full[np.unique(np.linspace(0, len(full) - 1, min(sample, len(full))).round().astype(int))]
    patterns = [detections[k].uv[main_pattern(detections[k])] for k in picked]
    pitch = pitch_of(patterns[0])
    total = [sum(mean_squared_gap(one, other, pitch) for other in patterns) for one in patterns]
    return int(picked[int(np.argmin(total))])
