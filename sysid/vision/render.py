"""Pictures of markers whose places are known: what a camera would see of a simulated sensor."""

from __future__ import annotations

import numpy as np

from sysid.vision.field import Points, pitch_of
from sysid.vision.segment import Image

GROUND, DOT = 180.0, 50.0
"""Grey levels of the lit ground and of the dots."""

DIAMETER_PITCH = 0.4
"""Diameter of a dot over the distance of neighbours at rest."""


def dot_diameter(rest: Points) -> float:
    """Diameter [px] of the dots of a layout ``(m, 2)`` [px]; 8 where it has none to measure."""
    seen = rest[np.isfinite(rest).all(axis=1)]
    return max(DIAMETER_PITCH * pitch_of(seen), 4.0) if len(seen) > 1 else 8.0


def draw_dots(places: Points, diameter_px: float, width_px: int, height_px: int) -> Image:
    """A grey picture ``(height, width)`` of dark dots at ``places`` ``(m, 2)`` [px], pixel centres at integers; a place
    that is not finite has none. Each pixel is covered by the share min(max(r - d + 1/2, 0), 1), d its distance from the
    centre."""
    picture = np.full((height_px, width_px), GROUND)
    radius = 0.5 * diameter_px
    for u, v in places[np.isfinite(places).all(axis=1)]:
        left, right = (int(np.clip(np.floor(u + s * (radius + 2.0)), -1, width_px)) for s in (-1.0, 1.0))
        top, bottom = (int(np.clip(np.floor(v + s * (radius + 2.0)), -1, height_px)) for s in (-1.0, 1.0))
        columns, rows = np.arange(max(left, 0), right), np.arange(max(top, 0), bottom)
        if len(columns) and len(rows):
            cover = np.clip(radius + 0.5 - np.hypot(columns[None, :] - u, rows[:, None] - v), 0.0, 1.0)
            part = picture[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
            np.minimum(part, GROUND + (DOT - GROUND) * cover, out=part)
    return np.round(picture).astype(np.uint8)
