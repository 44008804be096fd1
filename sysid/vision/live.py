"""Markers of pictures as they come: the code of :func:`sysid.vision.track.track_frames`, one frame at a time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sim_core.errors import RecordingError
from sysid.vision.detect import DetectionParameters, Detections, detect_markers
from sysid.vision.field import Points
from sysid.vision.match import LOST_COST, LayoutMatch, match_layout
from sysid.vision.reference import Reference, choose_reference
from sysid.vision.track import TrackParameters, is_close, markers_of, track_frames


@dataclass(frozen=True)
class LiveFrame:
    """Markers of one picture. ``uv`` ``(m, 2)`` [px], NaN where lost; ``confidence`` ``(m,)`` in 0..1, 0 where lost;
    ``note``: why the picture gives none, '' if it does."""

    uv: NDArray[np.float64]
    confidence: NDArray[np.float64]
    note: str = ""


class LiveTracker:
    """Follows the markers of a layout from picture to picture.

    The layout is that of the first pictures with markers, of a sensor at rest; a blob that few of them show is glare
    and no marker. A marker's number is its row in the layout: one that is lost keeps it, and gets it back where the
    field of its neighbours says that it should be. A picture whose match is in doubt gives none, and the next one is
    matched from the whole pattern.
    """

    def __init__(
        self,
        rest_images: int = 10,
        *,
        layout: Points | None = None,
        detection: DetectionParameters | None = None,
        tracking: TrackParameters | None = None,
    ) -> None:
        """``rest_images``: how many pictures the layout is taken from; ``layout``: positions [px] ``(m, 2)`` of an
        earlier one, which is used instead."""
        self._count = rest_images
        self._detection, self._tracking = detection or DetectionParameters(), tracking or TrackParameters()
        self._rest: list[Detections] = []
        self._last: LayoutMatch | None = None
        self.reference = None if layout is None else Reference(np.asarray(layout, dtype=float), 0, "given")
        """The layout, None before it is known."""

    def take(self, image: NDArray[np.generic]) -> LiveFrame:
        """The markers of the next picture, grey ``(height, width)`` or RGB ``(height, width, 3)``."""
        found = detect_markers(image, self._detection)
        if self.reference is None:
            return self._at_rest(found, image)
        match = self._matched(self.reference, found)
        uv, confidence, _, failed = markers_of(match, found, self.reference.pitch_px, self._tracking)
        self._last = None if failed else match
        return LiveFrame(uv, confidence, (found.note or _doubt(match, self._tracking)) if failed else "")

    def _matched(self, reference: Reference, found: Detections) -> LayoutMatch:
        """From the picture before if that is good enough to keep, else from the whole pattern, which takes longer."""
        common: dict[str, Any] = {"view": found.image_size, "parameters": self._tracking.match}
        last, given = self._last, (reference.uv, found.uv, found.quality)
        if last is not None and len(found) >= 4 and is_close(last, found, reference.pitch_px):
            starts = {"previous frame": last.uv}
            match = match_layout(*given, starts=starts, search=False, whole=False, close=True, **common)
            # What is covered makes the others none the less certain where they have hardly moved.
            lost = LOST_COST * float((~match.found).mean())
            match = replace(match, cost=max(match.cost - lost, 0.0))
            if not markers_of(match, found, reference.pitch_px, self._tracking)[3]:
                return match
        return match_layout(*given, starts={"at rest": reference.uv}, **common)

    def _at_rest(self, found: Detections, image: NDArray[np.generic]) -> LiveFrame:
        """One of the pictures that the layout is taken from."""
        nothing = np.zeros((0, 2)), np.zeros(0)
        if len(found) < 4:
            return LiveFrame(*nothing, found.note or f"{len(found)} markers are seen, and a layout needs 4")
        self._rest.append(found)
        if len(self._rest) < self._count:
            return LiveFrame(
                *nothing, f"the layout at rest is taken from {self._count} pictures, {len(self._rest)} came"
            )
        rest, self._rest = self._rest, []
        try:
            tracks = track_frames(rest, choose_reference(rest, choice="first"), self._tracking)
        except RecordingError as error:
            return LiveFrame(*nothing, str(error))
        if self._detection.diameter_px is None:
            typical = float(np.median([one.diameter_px for one in rest]))
            self._detection = replace(self._detection, diameter_px=min(max(typical, 2.0), 200.0))
            # With the scale known the same dots are segmented wider or narrower: their area is that from now on.
            known = detect_markers(image, self._detection)
            if len(known):
                self._detection = replace(self._detection, typical_area_px2=float(np.median(known.area_px2)))
        self.reference, self._last = tracks.reference, None if tracks.failed[-1] else tracks.matches[-1]
        return LiveFrame(tracks.uv[-1], tracks.confidence[-1])


def _doubt(match: LayoutMatch, parameters: TrackParameters) -> str:
    seen = int(match.found.sum())
    return (
        f"{seen} of {len(match.found)} markers are seen with a misfit of {match.cost:.2g} pitch^2, at least "
        f"{parameters.min_found * len(match.found):.0f} with at most {parameters.fail_cost:g} are needed: which is "
        "which is in doubt"
    )
