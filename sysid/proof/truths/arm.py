"""A lumped arm between what is commanded and where the hand is: delay, lag, play, offset, and yielding to load.

In the coordinates of the stand (x, z, angle) or (x, y, z):

    c' = command(t - delay), then tau dm/dt = c' - m             (the measured pose m follows the command)
    |m - b| <= play / 2, b moves only when it is pushed          (play between motor and hand)
    hand = b + offset + C w                                      (w: force on the hand; added where it is known)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from sysid.proof.truths.paths import Path

Array = np.ndarray

GRID_S = 1e-3

Motion = Callable[[Array | float], Array]
"""Coordinates at times [s]."""


@dataclass(frozen=True)
class ArmFaults:
    """``offset``: constant shift of the hand; ``play``: width of the backlash of each coordinate; ``delay_s``,
    ``lag_s``: of the arm behind its command; ``echo``: the pose that is reported is the command; ``compliance``: rows
    of the matrix C [m/N], empty for a rigid arm."""

    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    play: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay_s: float = 0.0
    lag_s: float = 0.0
    echo: bool = False
    compliance: tuple[tuple[float, float, float], ...] = ()


RIGID = ArmFaults()
"""An arm that is where it was commanded to be."""


def through(path: Path, faults: ArmFaults) -> tuple[Motion, Motion]:
    """Motion of the hand without load, and of what is reported."""
    if faults == ArmFaults(compliance=faults.compliance):
        return path, path
    t = np.arange(round(path.end_s / GRID_S) + 2) * GRID_S
    followed = path(t - faults.delay_s)
    if faults.lag_s:
        keep = float(np.exp(-GRID_S / faults.lag_s))
        followed = lfilter([1.0 - keep], [1.0, -keep], followed, axis=0, zi=keep * followed[:1])[0]
    hand = _with_play(followed, np.asarray(faults.play)) + np.asarray(faults.offset)
    return _sampled(t, hand), path if faults.echo else _sampled(t, followed)


def _sampled(t: Array, values: Array) -> Motion:
    def sample(at: Array | float) -> Array:
        return np.stack([np.interp(at, t, values[:, k]) for k in range(values.shape[1])], axis=-1)

    return sample


def _with_play(driven: Array, width: Array) -> Array:
    """The play operator (Visintin, Differential Models of Hysteresis, 1994, ch. 3), begun in the middle."""
    if not width.any():
        return driven
    out = driven.copy()
    for k in range(1, len(driven)):
        out[k] = np.clip(out[k - 1], driven[k] - 0.5 * width, driven[k] + 0.5 * width)
    return np.asarray(out)
