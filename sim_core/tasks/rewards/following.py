"""Following: draw a sheet so that the block on it comes along, towards -x.

R = - sum_i x_i(T)      over the observed points of the block [m]
"""

from __future__ import annotations

import numpy as np

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """No settings."""
    x = seen.points["block"]
    by = np.zeros_like(x)
    by[-1, :, 0] = -1.0
    return Scored(-float(x[-1, :, 0].sum()), {"block": by}, {})
