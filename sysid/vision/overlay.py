"""Pictures of tracks drawn over their images."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from sysid.vision.field import Points
from sysid.vision.segment import Image, to_grey

_GREEN, _YELLOW, _RED, _WHITE, _CYAN = (
    (0, 230, 0),
    (240, 200, 0),
    (255, 60, 60),
    (255, 255, 255),
    (0, 220, 255),
)


def overlay(
    image: NDArray[np.generic],
    uv: Points,
    reference: Points,
    *,
    ids: NDArray[np.integer] | None = None,
    confidence: NDArray[np.float64] | None = None,
    place: Points | None = None,
    title: str = "",
    scale: int = 3,
    number_every: int = 1,
) -> Image:
    """Draw the tracks of one frame, and return an RGB image ``scale`` times as large.

    Main arguments: ``image`` grey or RGB; ``uv`` ``(m, 2)`` [px], NaN where lost; ``reference`` ``(m, 2)``.
    Other arguments: ``ids`` ``(m,)`` are written at the markers, every ``number_every``-th; ``confidence``
    ``(m,)`` below 0.5 turns an arrow yellow; ``place`` ``(m, 2)`` is where lost markers should be, red.
    Arrows go from the reference to the frame.
    """
    grey = to_grey(image) // 2
    canvas = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
    canvas = cv2.resize(canvas, None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)
    numbers = np.arange(len(reference)) if ids is None else ids
    for k, start in enumerate(reference):
        lost = not np.isfinite(uv[k, 0])
        if lost and place is None:
            continue
        end = place[k] if lost and place is not None else uv[k]
        doubtful = confidence is not None and confidence[k] < 0.5
        colour = _RED if lost else _YELLOW if doubtful else _GREEN
        tip = _pixel(end, scale)
        tail = _pixel(start, scale)
        length = max(float(np.hypot(tip[0] - tail[0], tip[1] - tail[1])), 1.0)
        cv2.arrowedLine(canvas, tail, tip, colour, 1, cv2.LINE_AA, tipLength=min(0.3, 8.0 / length))
        cv2.circle(canvas, tip, 2, colour, -1, cv2.LINE_AA)
        if number_every and k % number_every == 0:
            corner = (tip[0] + 3, tip[1] - 2)
            cv2.putText(canvas, str(int(numbers[k])), corner, cv2.FONT_HERSHEY_SIMPLEX, 0.33, _CYAN, 1, cv2.LINE_AA)
    if title:
        cv2.putText(canvas, title, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, _WHITE, 1, cv2.LINE_AA)
    return np.asarray(canvas, dtype=np.uint8)


def contact_sheet(pictures: Sequence[Image], *, columns: int = 3, width_px: int = 2400) -> Image:
    """Put pictures side by side in rows, and return one RGB image at most ``width_px`` wide."""
    height = max(picture.shape[0] for picture in pictures)
    width = max(picture.shape[1] for picture in pictures)
    columns = min(columns, len(pictures))
    rows = -(-len(pictures) // columns)
    sheet = np.zeros((rows * height, columns * width, 3), dtype=np.uint8)
    for k, picture in enumerate(pictures):
        top, left = (k // columns) * height, (k % columns) * width
        sheet[top : top + picture.shape[0], left : left + picture.shape[1]] = picture
    if sheet.shape[1] > width_px:
        size = (width_px, round(sheet.shape[0] * width_px / sheet.shape[1]))
        sheet = np.asarray(cv2.resize(sheet, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return sheet


def telling_frames(rate: NDArray[np.float64], cost: NDArray[np.float64], count: int) -> list[int]:
    """Return ``count`` frames from the best to the worst, evenly over the ranking by rate, then cost."""
    order = np.lexsort((cost, -rate))
    places = np.unique(np.linspace(0, len(order) - 1, min(count, len(order))).round().astype(int))
    return [int(order[place]) for place in places]


def _pixel(point: NDArray[np.float64], scale: int) -> tuple[int, int]:
    return round(scale * (float(point[0]) + 0.5)), round(scale * (float(point[1]) + 0.5))
