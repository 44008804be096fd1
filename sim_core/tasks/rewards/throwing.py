"""Throwing: throw a ball up with the sheet that it lies on, the sheet's ends back where they were.

    R = n z_ball(T) - w sum_i (z_i(T) - z_i(0))^2      over the observed points of the sheet's ends [m, m^2]

n = 100 is the number of vertices of the ball in the mesh of the paper, and its w is 10, for which it pays to hold the
ball up instead of throwing it. So a success asks besides for ends that are back.
"""

from __future__ import annotations

import numpy as np

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """Settings ``vertices``: n, ``ends_weight``: w, ``ends_within_m``: root mean square of z_i(T) - z_i(0) up to which
    the throw can be a success."""
    n, w = float(seen.settings["vertices"]), float(seen.settings["ends_weight"])
    ball, ends = seen.points["ball"], seen.points["ends"]
    miss = ends[-1, :, 2] - ends[0, :, 2]
    by_ball, by_ends = np.zeros_like(ball), np.zeros_like(ends)
    by_ball[-1, :, 2] = n / ball.shape[1]
    by_ends[-1, :, 2], by_ends[0, :, 2] = -2.0 * w * miss, 2.0 * w * miss
    value = n * float(ball[-1, :, 2].mean()) - w * float((miss**2).sum())
    back = float(np.sqrt((miss**2).mean())) <= float(seen.settings["ends_within_m"])
    return Scored(value, {"ball": by_ball, "ends": by_ends}, {}, back)
