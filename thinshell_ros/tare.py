"""What readings are relative to: rest positions of markers, offsets of wrenches. No ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from thinshell_ros.streams import Channel

Floats = NDArray[np.float64]

AVERAGED = 10
"""Readings that a tare averages over, so that it does not freeze one reading's noise."""


class Tare:
    """Rest positions and wrench offsets of all channels, by the stamps [s] from which they hold."""

    def __init__(self, channels: Mapping[str, Channel]) -> None:
        self._channels = channels
        self._recent: dict[str, deque[Floats]] = {
            name: deque(maxlen=AVERAGED) for name, c in channels.items() if c.kind in ("wrench", "markers")
        }
        self._zero: dict[str, tuple[Floats, float, Floats]] = {}  # until a stamp, that stamp, and after it

    def restart(self, rest: Mapping[str, Floats]) -> None:
        """Markers are relative to ``rest`` [m], wrenches to nothing, as at the start."""
        for name, recent in self._recent.items():
            recent.clear()
            zero = rest[name] if self._channels[name].kind == "markers" else np.zeros_like(rest[name])
            self._zero[name] = zero, -np.inf, zero

    def take(self, channel: str, values: Floats) -> None:
        """Remember a reading."""
        if channel in self._recent:
            self._recent[channel].append(values)

    def zero(self, stamp_s: float) -> list[str]:
        """Make the last readings the zero of those stamped later than ``stamp_s`` [s]; returns the channels that have
        no reading yet."""
        for name, recent in self._recent.items():
            if recent:
                self._zero[name] = self._zero[name][2], stamp_s, np.mean(recent, axis=0)
        return [name for name, recent in self._recent.items() if not recent]

    def offset(self, channel: str, stamp_s: float = np.inf) -> Floats:
        """Zero of a channel at a stamp [s]: rest positions [m] ``(n, 3)``, or a wrench [N, N m] ``(6,)``."""
        before, since, after = self._zero[channel]
        return after if stamp_s > since else before
