"""Forming: bring a sheet into a shape that another motion gave it.

R = - sum_i |x_i(T) - x*_i|^2      over the observed points of the sheet [m^2]
"""

from __future__ import annotations

import numpy as np

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """Settings ``target_seed``, ``target_scale``: the motion that makes the target, see
    :class:`sim_core.tasks.rollout.TaskRollouts`."""
    x = seen.points["sheet"]
    miss = x[-1] - seen.target["sheet"]
    by = np.zeros_like(x)
    by[-1] = -2.0 * miss
    return Scored(-float((miss**2).sum()), {"sheet": by}, {}, sought={"sheet": seen.target["sheet"]})
