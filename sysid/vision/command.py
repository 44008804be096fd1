"""The work behind ``track`` on the command line: tracks, pictures and a report of one recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from sim_core.errors import RecordingError
from sysid.recording import ImageStream, TopicNames, read_recording
from sysid.recording.notes import plural
from sysid.vision.detect import DetectionParameters
from sysid.vision.from_recording import (
    Progress,
    TrackingResult,
    track_recording,
    write_tracked_recording,
)
from sysid.vision.overlay import contact_sheet, overlay, telling_frames
from sysid.vision.segment import Image

BAG, REPORT, SHEET = "tracked", "tracking.json", "overlay.png"
"""What is written into the output folder: a bag, a report and a picture."""


def track(
    bag: Path,
    out: Path,
    camera: str | None = None,
    *,
    topics: TopicNames | None = None,
    reference: str | int = "auto",
    depth_axis: str | None = None,
    effector: str | None = None,
    polarity: str = "auto",
    diameter_px: float | None = None,
    pictures: int = 6,
    progress: Progress | None = None,
) -> TrackingResult:
    """Track the markers in the images of ``bag`` and write bag, report and overlay into the folder ``out``.

    ``camera``, ``reference``, ``depth_axis`` and ``effector`` are those of ``track_recording``; ``polarity``
    and ``diameter_px`` those of ``DetectionParameters``; ``pictures`` is the number of images in the
    overlay, from the best to the worst. The report is printed. The source bag is only read.
    """
    out = Path(out)
    for name in (BAG, REPORT, SHEET):
        if (out / name).exists():
            raise RecordingError(f"{out / name} exists already.", "Choose another output folder.")
    recording = read_recording(bag, topics, need_pose=False)
    result = track_recording(
        recording,
        camera,
        reference=reference,
        depth_axis=depth_axis,
        effector=effector,
        detection=DetectionParameters(polarity=polarity, diameter_px=diameter_px),
        progress=progress,
    )
    out.mkdir(parents=True, exist_ok=True)
    write_tracked_recording(recording, [result], out / BAG)
    (out / REPORT).write_text(json.dumps(_content(bag, result), indent=1) + "\n", encoding="utf-8")
    if pictures > 0:
        images = recording.images[result.camera]
        tracked = images.take(np.isin(images.t, result.stream.t))
        sheet = overlay_sheet(result, tracked, count=pictures)
        cv2.imwrite(str(out / SHEET), cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))
    if result.broken:
        print(f"{plural(result.broken, 'image')} could not be decoded and had to be skipped.")
    print(result.report.text())
    print(f"Written to {out}: {BAG}, {REPORT}" + (f", {SHEET}." if pictures > 0 else "."))
    return result


def overlay_sheet(result: TrackingResult, images: ImageStream, *, count: int = 6, scale: int = 3) -> Image:
    """Return an RGB picture of ``count`` images with their tracks, from the best to the worst."""
    tracks = result.tracks
    cost = np.array([match.cost for match in tracks.matches])
    drawn = []
    for k in telling_frames(result.report.rate, cost, count):
        title = f"image {k}, t = {images.t[k]:.3f} s, {int(tracks.found[k].sum())} of {len(tracks.reference)}"
        picture = overlay(
            images.image(k),
            tracks.uv[k],
            tracks.reference.uv,
            ids=result.stream.ids,
            confidence=tracks.confidence[k],
            place=tracks.place[k],
            title=title + (", given up" if tracks.failed[k] else ""),
            scale=scale,
        )
        drawn.append(picture)
    return contact_sheet(drawn, width_px=1800 * min(3, len(drawn)))


def _content(bag: Path, result: TrackingResult) -> dict[str, Any]:
    content = result.report.as_dict()
    content["bag"] = Path(bag).name
    content["reference_uv_px"] = result.tracks.reference.uv.round(3).tolist()
    content["in_words"] = result.report.text().split("\n")
    return content
