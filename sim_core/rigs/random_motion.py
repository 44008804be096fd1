"""Smooth random motion within bounds on SE(3), the same for the same seed bit by bit.

Each of six coordinates, three of the position and three of the rotation vector r against the centre pose, is a uniform
cubic B-spline over control values c_k that are drawn evenly within its bound:

    q(t) = sum_k c_k B_3(t / h - k),    |q| <= max |c_k|,    |q'| <= max |c_(k+1) - c_k| / h

(de Boor, A Practical Guide to Splines, ch. IX and X), so bounds hold and the speed has one: h is chosen so that it is
the highest speed at most. For the rotation |omega| <= |r'|. The first and the last values are zero: the motion
begins and ends at rest at the centre. Acceleration is continuous.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs.fields import FloatArray

REST = 3
"""Control values of zero at either end: position, speed and acceleration vanish there."""


@dataclass(frozen=True)
class Wander:
    """Motion about a centre: ``origin`` [m] ``(3,)``, ``facing``. ``control``: values ``(k, 6)`` [m, rad]."""

    origin: FloatArray
    facing: Rotation
    control: FloatArray

    def poses(self, share: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions [m] ``(n, 3)`` and quaternions ``(n, 4)`` after the given shares of the duration."""
        spans = len(self.control) - 3
        place = np.clip(share, 0.0, 1.0) * spans
        span = np.minimum(place.astype(int), spans - 1)
        t = place - span
        basis = np.stack([(1 - t) ** 3, 3 * t**3 - 6 * t**2 + 4, -3 * t**3 + 3 * t**2 + 3 * t + 1, t**3]) / 6.0
        q = sum(basis[k][:, None] * self.control[span + k] for k in range(4))
        return self.origin + q[:, :3], (Rotation.from_rotvec(q[:, 3:]) * self.facing).as_quat()


def spans_within(bounds: FloatArray, speed: float, turn_speed: float, duration: float) -> int:
    """Most knot spans that the speed allows within a duration [s]; ``bounds``: of the coordinates ``(6,)`` [m, rad].

    A coordinate goes from one bound to the other, twice as far, within a span at most.
    """
    longest = max(2.0 * float(np.linalg.norm(bounds[:3])) / speed, 2.0 * float(np.linalg.norm(bounds[3:])) / turn_speed)
    return math.floor(duration / longest)


def wander(origin: FloatArray, facing: Rotation, bounds: FloatArray, spans: int, seed: int) -> Wander:
    """Draw a motion with so many knot spans; at least ``2 REST - 2``."""
    inner = spans + 3 - 2 * REST
    values = np.random.default_rng(seed).uniform(-1.0, 1.0, (inner, 6)) * bounds
    return Wander(origin, facing, np.vstack([np.zeros((REST, 6)), values, np.zeros((REST, 6))]))
