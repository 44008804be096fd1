"""How a stream of pictures is doing: rate, latency, markers. No ROS."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from thinshell_ros.health import Report

WINDOW = 300
"""Pictures that figures are taken over."""

FEW_SHARE = 0.5
"""Fewer markers than this share of the layout are a warning."""

SILENT_S = 2.0
"""Time [s] without a picture after which that is a warning."""


class Seeing:
    """Counts pictures; all times [s] are passed in."""

    def __init__(self) -> None:
        self._latest: deque[tuple[float, float, float]] = deque(maxlen=WINDOW)
        self.pictures = self.given_up = self.unread = 0
        self._seen, self._markers, self._note = 0, 0, "no picture has come"

    def take(self, stamp_s: float, begun_s: float, done_s: float, seen: int, markers: int, note: str) -> None:
        """A picture with a stamp, whose work began and ended at these times of one clock."""
        self.pictures += 1
        self.given_up += bool(note) and markers > 0
        self._latest.append((stamp_s, done_s - begun_s, done_s - stamp_s))
        self._seen, self._markers, self._note = seen, markers, note

    def misread(self, note: str) -> None:
        """A picture that cannot be read."""
        self.unread += 1
        self._note = note

    def figures(self) -> dict[str, float]:
        """Rate of stamps [1/s], share of pictures that were missed by their stamps, time of work and age of tracks when
        they are published [s], the median and the 99th percentile; NaN where they are not known."""
        stamps, work, age = np.array(self._latest, dtype=np.float64).reshape(-1, 3).T
        steps = np.diff(stamps)
        steps = steps[steps > 0.0]
        usual = float(np.percentile(steps, 20)) if len(steps) else math.nan
        missed = float(np.sum(np.round(steps / usual) - 1.0)) / (len(steps) + 1) if len(steps) else math.nan
        found = {"rate_hz": float(len(steps) / steps.sum()) if len(steps) else math.nan, "missed_share": missed}
        for name, values in (("work", work), ("latency", age)):
            for percentile in (50, 99):
                found[f"{name}_p{percentile}_s"] = float(np.percentile(values, percentile)) if len(values) else math.nan
        return found

    def report(self, silent_s: float) -> Report:
        """State of the stream. ``silent_s``: time since the last picture, or since the start [s]."""
        faults = []
        if silent_s > SILENT_S:
            faults.append(f"no picture has come for {silent_s:.1f} s")
        if self._note:
            faults.append(self._note)
        elif self._seen < FEW_SHARE * self._markers:
            faults.append(f"{self._seen} of {self._markers} markers are seen")
        values = {key: f"{value:.4g}" for key, value in self.figures().items()}
        values |= {"markers": str(self._markers), "seen": str(self._seen), "pictures": str(self.pictures)}
        values |= {"given_up": str(self.given_up), "unreadable": str(self.unread)}
        message = "; ".join(faults) or f"{self._seen} of {self._markers} markers are seen"
        return Report("markers", "warn" if faults else "ok", message, values)
