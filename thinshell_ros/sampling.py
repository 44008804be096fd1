"""Readings at each stream's own rate, with its latency and noise, from a simulation in steps. No ROS."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thinshell_ros.streams import Channel

Floats = NDArray[np.float64]

COUNTED = 1000
"""Readings over which the places of readings within steps repeat, or nearly so."""

Amend = Callable[[Channel, float, Floats], Floats]
"""What a sensor makes of the values of a channel at a stamp [s]."""


@dataclass(frozen=True)
class Reading:
    """One reading of a channel. ``stamp_s``: simulated time of its stamp [s]. ``values``: pose ``(7,)``
    as x y z [m], x y z w; wrench ``(6,)`` [N, N m]; markers and meshes ``(n, 3)`` [m]; tracks ``(n, 2)`` [px].
    ``release_s``: simulated time at which it is to be given out, evenly spaced within a channel [s]."""

    channel: str
    stamp_s: float
    values: Floats
    release_s: float = 0.0


class Sampler:
    """Turns readings at the steps into readings at the channels' rates, linear in between."""

    def __init__(
        self, channels: Mapping[str, Channel], seed: int | None, amend: Amend | None = None, step_s: float = 0.0
    ) -> None:
        """``seed``: of the noise, None for none. ``amend``: what sensors do to a reading before that. ``step_s``: of
        the simulation [s]."""
        self._channels = channels
        self._hold = {name: hold_s(channel, step_s) for name, channel in channels.items()}
        self._amend = amend
        self._rng = None if seed is None else np.random.default_rng(seed)
        self._taken = dict.fromkeys(channels, 0)
        self._time = 0.0
        self._last: Mapping[str, Floats] = {}
        self._waiting: list[tuple[float, int, Reading]] = []
        self._order = 0

    def restart(self, time: float, readings: Mapping[str, Floats]) -> None:
        """Go on from a new state at the same simulated time [s]; what waits for its latency is dropped."""
        self._time, self._last = time, readings
        self._waiting.clear()

    def advance(self, time: float, readings: Mapping[str, Floats]) -> list[Reading]:
        """Readings that are due until ``time`` [s], in the order of their release."""
        for name, channel in self._channels.items():
            while (at := (self._taken[name] + 1) / channel.rate_hz) <= time + 1e-9:
                self._taken[name] += 1
                share = min((at - self._time) / (time - self._time), 1.0)
                self._queue(channel, at, (1.0 - share) * self._last[name] + share * readings[name])
        self._time, self._last = time, readings
        due: list[Reading] = []
        while self._waiting and self._waiting[0][0] <= time + 1e-9:
            due.append(heapq.heappop(self._waiting)[2])
        return due

    def _queue(self, channel: Channel, at: float, values: Floats) -> None:
        stamp = max(at + channel.latency_s, 0.0)
        if channel.kind == "pose":
            values[3:] /= np.linalg.norm(values[3:])
        elif channel.kind not in ("contact", "mesh"):
            if self._amend is not None:
                values = self._amend(channel, stamp, values)
            if self._rng is not None:
                values = values + channel.noise * self._rng.standard_normal(values.shape)
        self._order += 1
        due = max(at, stamp)
        reading = Reading(channel.name, stamp, values, due + self._hold[channel.name])
        item: Any = (due, self._order, reading)
        heapq.heappush(self._waiting, item)


def hold_s(channel: Channel, step_s: float) -> float:
    """Least delay [s] with which a channel's readings can be given out evenly spaced.

    A reading is known at the end of the step that it falls into, which is later by up to a step; those that are known
    early wait as long as the one that is known last. It is 0 where all fall on the ends of steps.
    """
    if step_s == 0.0:
        return 0.0
    due = np.arange(1, COUNTED + 1) / channel.rate_hz + max(channel.latency_s, 0.0)
    return float((np.ceil(due / step_s - 1e-6) * step_s - due).max().clip(0.0))
