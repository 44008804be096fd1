"""A figure of which most is the same in every picture: that is drawn once, as a pane of glass over pictures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np


class Pane:
    """What is on a matplotlib figure now, over pictures that are put below it, under artists that are drawn above it.
    ``canvas``: of Agg, of a figure without a colour of its own."""

    def __init__(self, canvas: Any) -> None:
        canvas.draw()
        self._canvas = canvas
        drawn = np.asarray(canvas.buffer_rgba())
        self._where = np.nonzero(drawn[..., 3])
        colour = drawn[self._where].astype(float)
        self._colour, self._opacity = colour[:, :3], colour[:, 3:] / 255.0

    def begin(self) -> None:
        """Begin with white paper."""
        self._pixels()[:] = 255

    def put(self, axes: Any, picture: np.ndarray) -> None:
        """Put a picture, RGB uint8 ``(height, width, 3)``, where axes of the figure are."""
        pixels, box = self._pixels(), axes.get_window_extent()
        top, left = pixels.shape[0] - round(box.y1), round(box.x0)
        pixels[top : top + picture.shape[0], left : left + picture.shape[1], :3] = picture

    def finish(self, artists: Iterable[Any]) -> np.ndarray:
        """Lay the pane over the pictures and draw artists above it: RGB uint8 ``(height, width, 3)``."""
        pixels = self._pixels()[..., :3]
        below = pixels[self._where]
        pixels[self._where] = (below + self._opacity * (self._colour - below) + 0.5).astype(np.uint8)
        renderer = self._canvas.get_renderer()
        for artist in sorted(artists, key=lambda a: float(a.get_zorder())):
            artist.draw(renderer)
        return np.array(pixels)

    def _pixels(self) -> np.ndarray:
        return np.asarray(self._canvas.buffer_rgba())
