"""Times of a stream in units of its usual interval."""

from __future__ import annotations

import numpy as np

from sysid.settings.noise import NOISE


def in_sampling_intervals(t: np.ndarray) -> np.ndarray:
    """Times [s] ``(n,)``, in order, in units of the median interval ``(n,)``, with each interval at least
    ``NOISE.shortest_interval``."""
    pauses = np.diff(t)
    if not len(pauses):
        return np.zeros(len(t))
    usual = max(float(np.median(pauses)), np.finfo(float).tiny)
    return np.concatenate([[0.0], np.cumsum(np.maximum(pauses / usual, NOISE.shortest_interval))])
