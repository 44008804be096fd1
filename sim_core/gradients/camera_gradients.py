"""Derivatives by what cameras are, where they look and how they image, summed up on the way back.

Nothing in the mechanics depends on these, so what a camera sees is kept in the frame of its mount and imaged by one
camera with a little more and one with a little less of each parameter, many pictures at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.gradients.directions import Direction
from sim_core.sensing.observe import taken

POINTS = 3000
"""Points that are imaged at once: calls of OpenCV have their price, and so have large tables of its derivatives."""


class Pictures:
    """Sums by the parameters ``along`` over the pictures of a rollout."""

    def __init__(self, along: Sequence[Direction]) -> None:
        self._along = along
        self._changing = [k for k, d in enumerate(along) if d.low.cameras != d.high.cameras]
        self.clear()

    def __bool__(self) -> bool:
        return bool(self._changing)

    def clear(self) -> None:
        """Begin anew."""
        self._sums = np.zeros(len(self._along))
        self._kept: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}

    def add(self, seen: Mapping[str, np.ndarray], weights: Mapping[str, np.ndarray]) -> None:
        """Take one picture of each camera in ``weights``, the derivatives of a loss by its readings. ``seen``: its
        points in the frame of its mount [m] ``(n, 3)``."""
        for name, points in seen.items():
            if name in weights:
                kept = self._kept.setdefault(name, [])
                kept.append((points, weights[name].reshape(-1, 2)))
                if len(kept) * len(points) >= POINTS:
                    self._image(name)

    def total(self) -> np.ndarray:
        """Derivatives by the parameters ``(n_parameters,)`` of all pictures so far."""
        for name in list(self._kept):
            self._image(name)
        return self._sums

    def _image(self, name: str) -> None:
        """Image what was kept of a camera."""
        points, weights = (np.stack(a) for a in zip(*self._kept.pop(name), strict=True))
        for k in self._changing:
            direction = self._along[k]
            high, low = (rig.cameras[name] for rig in (direction.high, direction.low))
            if high != low:
                change = (taken(high, points) - taken(low, points)) / direction.width
                self._sums[k] += float(np.vdot(np.nan_to_num(change), weights))
