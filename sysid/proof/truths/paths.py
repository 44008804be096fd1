"""Smooth paths of a hand: rests, moves between poses without jerks at their ends, and shakes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

Array = np.ndarray


@dataclass
class Path:
    """A path of some coordinates (m, rad) built piece by piece; callable with times [s].

    A move follows s(u) = u^3 (10 - 15 u + 6 u^2), so velocity and acceleration vanish at both ends. A shake adds
    amplitude sin(2 pi f u) under the window sin^2(pi u).
    """

    start: tuple[float, ...]
    _pieces: list[tuple[float, float, Array, Array, Array | None, float]] = field(default_factory=list)

    @property
    def end_s(self) -> float:
        """Time at which the last piece ends [s]."""
        return self._pieces[-1][1] if self._pieces else 0.0

    @property
    def end(self) -> Array:
        """Where the last piece ends."""
        return self._pieces[-1][3] if self._pieces else np.array(self.start, dtype=float)

    def wait(self, seconds: float) -> Path:
        """Stand still."""
        return self._add(seconds, self.end)

    def move(self, by: tuple[float, ...], seconds: float) -> Path:
        """Go on by ``by`` in ``seconds``."""
        return self._add(seconds, self.end + np.asarray(by))

    def shake(self, amplitude: tuple[float, ...], hertz: float, seconds: float) -> Path:
        """Swing about the place where the hand is."""
        return self._add(seconds, self.end, np.asarray(amplitude), hertz)

    def _add(self, seconds: float, to: Array, amplitude: Array | None = None, hertz: float = 0.0) -> Path:
        self._pieces.append((self.end_s, self.end_s + seconds, self.end, to, amplitude, hertz))
        return self

    def __call__(self, t: Array | float) -> Array:
        """Coordinates at the times ``t``, shape ``(..., k)``; before and after the path, its ends."""
        t = np.asarray(t, dtype=float)
        out = np.broadcast_to(np.array(self.start, dtype=float), (*t.shape, len(self.start))).copy()
        for begin, end, first, last, amplitude, hertz in self._pieces:
            inside = t >= begin
            u = np.clip((t - begin) / (end - begin), 0.0, 1.0)[..., None]
            value = first + (last - first) * u**3 * (10 - 15 * u + 6 * u**2)
            if amplitude is not None:
                swing = np.sin(2 * np.pi * hertz * u * (end - begin)) * np.sin(np.pi * u) ** 2
                value = value + amplitude * swing
            out[inside] = value[inside]
        return np.asarray(out)
