"""Lifting: carry a block by a displacement d.

R = - sum_i |x_i(T) - x_i(0) - d|^2      over the observed points of the block [m^2]
"""

from __future__ import annotations

import numpy as np

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """Setting ``displacement_m``: d."""
    x = seen.points["block"]
    sought = x[0] + np.asarray(seen.settings["displacement_m"])
    miss = x[-1] - sought
    by = np.zeros_like(x)
    by[-1], by[0] = -2.0 * miss, 2.0 * miss
    return Scored(-float((miss**2).sum()), {"block": by}, {}, sought={"block": sought})
