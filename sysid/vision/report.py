"""What tracking achieved and where it failed, in numbers and in words."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid.vision.check import CycleCheck, cycle_check, flipped_edges, folded_fraction
from sysid.vision.detect import Detections
from sysid.vision.motion import PoseCheck, slide_sign
from sysid.vision.track import FrameTracks, TrackParameters


@dataclass(frozen=True)
class FrameRemark:
    """A frame that was given up, or that lacks markers."""

    frame: int
    """Number of the image, from 0."""
    time_s: float
    """Time of the image [s]."""
    found: int
    """Markers found."""
    reason: str
    """What is wrong, in words."""


@dataclass(frozen=True)
class TrackingReport:
    """Result of tracking the markers of one camera."""

    camera: str
    """Name of the camera."""
    markers: int
    """Markers of the reference layout."""
    reference: str
    """Which frame the reference is, and why, in words."""
    pitch_px: float
    """Typical distance between neighbouring markers [px]."""
    dropped: int
    """Blobs of the reference that turned out to be glare."""
    rate: NDArray[np.float64]
    """Part of the reference markers found in each frame, shape ``(n,)``."""
    merged: NDArray[np.int64]
    """Markers cut out of touching blobs in each frame, shape ``(n,)``."""
    unexplained: NDArray[np.int64]
    """Detections that belong to no marker in each frame (glare), shape ``(n,)``."""
    residual_px: NDArray[np.float64]
    """Median misfit to the neighbours [px] in each frame, NaN where nothing was found, shape ``(n,)``."""
    folded: NDArray[np.float64]
    """Part of the layout's triangles turned over in each frame, shape ``(n,)``."""
    flipped: NDArray[np.float64]
    """Part of the layout's Delaunay edges that changed in each frame, shape ``(n,)``."""
    cycle: CycleCheck
    """Numbers reached directly and by way of another frame."""
    failures: tuple[FrameRemark, ...]
    """Frames given up: they have no tracks."""
    incomplete: tuple[FrameRemark, ...]
    """Frames with tracks that lack markers."""
    rarely_seen: dict[int, float]
    """Markers found in less than 95 % of the frames, with the part."""
    starts: dict[str, int]
    """How many frames each kind of start solved."""
    pose_check: PoseCheck | None = None
    """How well the poses explain the motion on held-out frames; None without poses."""
    pose_check_by_depth: PoseCheck | None = None
    """The same with the products of depth and the other pose components as regressors."""

    @property
    def overall_rate(self) -> float:
        """Part of all markers found over all frames, 0..1."""
        return float(self.rate.mean()) if self.rate.size else 0.0

    def text(self) -> str:
        """Return the report in words, one finding a line."""
        n = len(self.rate)
        lines = [
            f"Camera {self.camera}: {self.markers} markers in {n} images, {self.pitch_px:.1f} px apart.",
            f"Reference: {self.reference}"
            + (f"; {self.dropped} blobs of it dropped as glare." if self.dropped else "."),
            f"Detection rate: {100 * self.overall_rate:.3f} % overall; least {100 * self.rate.min():.1f} %, "
            f"5th percentile {100 * np.percentile(self.rate, 5):.1f} %, "
            f"all markers in {int((self.rate == 1.0).sum())} of {n} images.",
            f"Misfit to the neighbours: median {_median(self.residual_px):.2f} px.",
            f"Identity: {100 * _mean(self.folded):.3f} % of triangles folded, "
            f"{100 * _mean(self.flipped):.2f} % of Delaunay edges changed; "
            f"{self.cycle.agreeing} of {self.cycle.compared} numbers agree on the way over another image "
            f"({self.cycle.frames} images).",
            f"Touching markers cut apart: {self.merged.mean():.2f} an image; "
            f"detections that are no marker: {self.unexplained.mean():.2f} an image.",
        ]
        lines.append(f"Images given up: {len(self.failures) or 'none'}.")
        lines += [f"  {_line(remark)}" for remark in self.failures[:20]]
        lines.append(f"Images that lack markers: {len(self.incomplete) or 'none'}.")
        worst = sorted(self.incomplete, key=lambda remark: remark.found)
        lines += [f"  {_line(remark)}" for remark in worst[:10]]
        if len(worst) > 10:
            lines.append(f"  and {len(worst) - 10} more with fewer losses")
        if self.rarely_seen:
            rare = ", ".join(f"{k} ({100 * part:.0f} %)" for k, part in self.rarely_seen.items())
            lines.append(f"Markers found in less than 95 % of the images: {rare}.")
        for check, what in (
            (self.pose_check, ""),
            (self.pose_check_by_depth, " and its products with depth"),
        ):
            if check is not None:
                parts = ", ".join(f"{name} {value:.3f}" for name, value in check.r_squared.items())
                lines.append(f"Explained by the pose{what} on {check.frames[1]} held-out images (R^2): {parts}.")
        if self.pose_check_by_depth is not None:
            lines.append(f"If this is a dome pressed on a flat plate, {slide_sign(self.pose_check_by_depth)}.")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as plain values for JSON."""
        checks = {"linear": self.pose_check, "with_depth_products": self.pose_check_by_depth}
        return {
            "camera": self.camera,
            "markers": self.markers,
            "reference": self.reference,
            "pitch_px": self.pitch_px,
            "reference_blobs_dropped": self.dropped,
            "overall_rate": self.overall_rate,
            "rate": self.rate.tolist(),
            "merged": self.merged.tolist(),
            "unexplained": self.unexplained.tolist(),
            "residual_px": _plain(self.residual_px),
            "folded": _plain(self.folded),
            "flipped": _plain(self.flipped),
            "cycle": {
                "frames": self.cycle.frames,
                "compared": self.cycle.compared,
                "agreeing": self.cycle.agreeing,
                "worst_frame": self.cycle.worst_frame,
            },
            "failures": [vars(remark) for remark in self.failures],
            "incomplete": [vars(remark) for remark in self.incomplete],
            "rarely_seen": {str(k): part for k, part in self.rarely_seen.items()},
            "starts": self.starts,
            "pose_check": {
                name: {
                    "r_squared": check.r_squared,
                    "coefficients": check.coefficients,
                    "frames_fitted": check.frames[0],
                    "frames_held_out": check.frames[1],
                }
                for name, check in checks.items()
                if check is not None
            },
        }


def make_report(
    camera: str,
    times_s: NDArray[np.float64],
    detections: Sequence[Detections],
    tracks: FrameTracks,
    parameters: TrackParameters,
    *,
    cycle_frames: int = 100,
    pose_check: PoseCheck | None = None,
    pose_check_by_depth: PoseCheck | None = None,
) -> TrackingReport:
    """Judge the tracks of one camera; ``times_s`` [s] and ``detections`` are those of its images."""
    found = tracks.found
    reference = tracks.reference
    failures, incomplete = [], []
    merged, unexplained = np.zeros(len(found), np.int64), np.zeros(len(found), np.int64)
    for k, (blobs, match) in enumerate(zip(detections, tracks.matches, strict=True)):
        count = int(found[k].sum())
        merged[k] = int(blobs.merged.sum())
        unexplained[k] = len(blobs) - int(match.found.sum())
        if tracks.failed[k]:
            failures.append(FrameRemark(k, float(times_s[k]), count, _why_failed(blobs, match.cost, parameters)))
        elif count < len(reference):
            reason = _why_lost(tracks.place[k][~found[k]], blobs, reference.pitch_px)
            incomplete.append(FrameRemark(k, float(times_s[k]), count, reason))
    good = ~tracks.failed
    seen = found[good].mean(axis=0) if good.any() else np.zeros(len(reference))
    residual = [np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in tracks.residual_px]
    starts = Counter(match.start.rstrip(" 0123456789") for match in tracks.matches)
    return TrackingReport(
        camera=camera,
        markers=len(reference),
        reference=f"image {reference.frame}, {reference.source}",
        pitch_px=reference.pitch_px,
        dropped=len(tracks.dropped),
        rate=found.mean(axis=1),
        merged=merged,
        unexplained=unexplained,
        residual_px=np.array(residual),
        folded=np.array([folded_fraction(reference.uv, frame) for frame in tracks.uv]),
        flipped=np.array([flipped_edges(reference.uv, frame) for frame in tracks.uv]),
        cycle=cycle_check(tracks, detections, parameters, frames=cycle_frames),
        failures=tuple(failures),
        incomplete=tuple(incomplete),
        rarely_seen={int(k): float(seen[k]) for k in np.flatnonzero(seen < 0.95)},
        starts=dict(starts),
        pose_check=pose_check,
        pose_check_by_depth=pose_check_by_depth,
    )


def _why_failed(blobs: Detections, cost: float, parameters: TrackParameters) -> str:
    if blobs.note:
        return blobs.note
    if len(blobs) < 4:
        return f"only {len(blobs)} blobs look like markers"
    if cost > parameters.fail_cost:
        limit = parameters.fail_cost
        return f"no smooth motion explains the {len(blobs)} blobs (cost {cost:.3f}, limit {limit})"
    return f"less than {100 * parameters.min_found:.0f} % of the markers found"


def _why_lost(lost: NDArray[np.float64], blobs: Detections, pitch: float) -> str:
    """Sort lost markers by where they should be: out of the image, at its edge, at a blob, or nowhere."""
    size = np.array(blobs.image_size, dtype=float)
    edge = np.minimum(lost, size - 1.0 - lost).min(axis=1)
    out = edge < 0.0
    near_edge = ~out & (edge < 0.6 * pitch)
    gap = np.full(len(lost), np.inf)
    if len(blobs):
        gap = np.linalg.norm(lost[:, None, :] - blobs.uv[None, :, :], axis=2).min(axis=1)
    off = ~out & ~near_edge & (gap < 0.6 * pitch)
    gone = ~out & ~near_edge & ~off
    parts = {
        "left the image": out,
        "cut by the edge of the image": near_edge,
        "too far from where the neighbours put them": off,
        "not seen (hidden, or run into glare)": gone,
    }
    return ", ".join(f"{int(which.sum())} {words}" for words, which in parts.items() if which.any())


def _line(remark: FrameRemark) -> str:
    return f"image {remark.frame} at {remark.time_s:.3f} s, {remark.found} found: {remark.reason}"


def _mean(values: NDArray[np.float64]) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else float("nan")


def _median(values: NDArray[np.float64]) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")


def _plain(values: NDArray[np.float64]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]
