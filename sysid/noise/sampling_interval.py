"""Times of a stream in units of its usual interval."""

from __future__ import annotations

import numpy as np

SHORTEST = 0.5
"""Least time from one sample to the next [usual intervals]. Sensors sample evenly and stamps do not: two messages that
were stamped at once are no measurement of how fast noise changes."""

NEXT = 1.5
"""Time from one sample to the next [usual intervals] from which one is missing between them."""


def in_sampling_intervals(t: np.ndarray) -> np.ndarray:
    """Times [s] ``(n,)``, in order, in units of the median interval ``(n,)``, with each interval at least
    :data:`SHORTEST`."""
    pauses = np.diff(t)
    if not len(pauses):
        return np.zeros(len(t))
    usual = max(float(np.median(pauses)), np.finfo(float).tiny)
    return np.concatenate([[0.0], np.cumsum(np.maximum(pauses / usual, SHORTEST))])
