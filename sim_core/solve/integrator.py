"""Time integration: from what the velocity and the acceleration of a step are measured.

With positions x_b, velocities v_b and a time tau that follow from the past,

    v' = (x' - x_b) / tau,    a' = (v' - v_b) / tau,

so that a step minimises 1/2 (x' - xhat)^T M (x' - xhat) / tau^2 + sum of energies, xhat = x_b + tau v_b.

Implicit Euler:  x_b = x, v_b = v, tau = dt. First order; takes energy out of whatever moves.
BDF2, with r = dt / dt_ of the step before (state x_, v_):

    tau = dt (1 + r) / (1 + 2 r),    x_b = ((1 + r)^2 x - r^2 x_) / (1 + 2 r),    v_b likewise.

Second order, and vibrations that a step resolves keep their energy (Hairer & Wanner, Solving ODEs II, III.5 and
V.1). Both weigh forces at the end of the step alone, so contact, friction and plastic flow are the same in both.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Past:
    """The state before the present one: ``x`` [m], ``v`` [m/s] ``(n, 3)``, and the time ``dt`` [s] since."""

    x: np.ndarray
    v: np.ndarray
    dt: float
