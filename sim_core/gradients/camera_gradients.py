"""Derivatives by what cameras are, where they look and how they image, forwards and summed up on the way back.

Nothing in the mechanics depends on these, so what a camera sees is kept in the frame of its mount and imaged by one
camera with a little more and one with a little less of each parameter, many pictures at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.gradients.directions import Direction
from sim_core.rigs import Rig
from sim_core.sensing.observe import taken

POINTS = 3000
"""Points that are imaged at once: calls of OpenCV have their price, and so have large tables of its derivatives."""


class Imaging:
    """What the parameters ``along`` that change cameras change in the pictures of a rollout."""

    def __init__(self, along: Sequence[Direction]) -> None:
        self._along = along
        self._changing = [k for k, d in enumerate(along) if d.low.cameras != d.high.cameras]
        self._kept: dict[tuple[str, int, bool], list[np.ndarray]] = {}

    def take_all(self, rig: Rig, before: Callable[[Rig], Mapping[str, np.ndarray]]) -> None:
        """Pictures of each camera of a ``rig`` at several instants. ``before``: what the cameras of a rig are to see in
        the frames of their mounts [m] ``(t, n, 3)``."""
        if not self._changing:
            return
        plain = before(rig)
        for k in self._changing:
            for high in (True, False):
                end = self._end(k, high)
                alike = {name: end.cameras[name].sees == camera.sees for name, camera in rig.cameras.items()}
                points = plain if all(alike.values()) else before(end)
                for name in plain:
                    self._kept.setdefault((name, k, high), []).append(points[name])

    def slopes(self, channel: str) -> dict[int, np.ndarray]:
        """Derivatives of the pictures taken ``(t, n, 2)``, by number of the parameter; others change nothing. A point
        that the low end of a direction sees has one wherever the high end takes it, out of the picture too: a secant
        to a camera that stands elsewhere tells of all points that this one sees."""
        found = {}
        for k in self._changing:
            high, low = (self._imaged(channel, k, high) for high in (True, False))
            if high is not None and low is not None:
                found[k] = (high - low) / self._along[k].width
        return found

    def _end(self, k: int, high: bool) -> Rig:
        return self._along[k].high if high else self._along[k].low

    def _imaged(self, channel: str, k: int, high: bool) -> np.ndarray | None:
        if (channel, k, high) not in self._kept:
            return None
        points, camera = np.concatenate(self._kept[channel, k, high]), self._end(k, high).cameras[channel]
        at_once = max(1, POINTS // max(1, points.shape[1]))
        parts = (points[a : a + at_once] for a in range(0, len(points), at_once))
        return np.concatenate([taken(camera, part, beyond=high) for part in parts])


class CameraGradients:
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
