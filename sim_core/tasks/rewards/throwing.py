"""Throwing: throw a ball up with the sheet that it lies on, the sheet's ends back where they were.

    R = n z_ball(T) - 10 sum_i (z_i(T) - z_i(0))^2      over the observed points of the sheet's ends [m, m^2]

n = 100 is the number of vertices of the ball in the mesh of the paper.
"""

from __future__ import annotations

import numpy as np

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """Setting ``vertices``: n."""
    n = float(seen.settings["vertices"])
    ball, ends = seen.points["ball"], seen.points["ends"]
    miss = ends[-1, :, 2] - ends[0, :, 2]
    by_ball, by_ends = np.zeros_like(ball), np.zeros_like(ends)
    by_ball[-1, :, 2] = n / ball.shape[1]
    by_ends[-1, :, 2], by_ends[0, :, 2] = -20.0 * miss, 20.0 * miss
    value = n * float(ball[-1, :, 2].mean()) - 10.0 * float((miss**2).sum())
    return Scored(value, {"ball": by_ball, "ends": by_ends}, {})
