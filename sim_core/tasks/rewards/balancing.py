"""Balancing: keep a ball over the middle of the sheet that it lies on.

    R = - n sum_t [(x_t - xc_t)^2 + (y_t - yc_t)^2]      of the centres of the ball and the sheet, from when hands act

n = 100 is the number of vertices of the ball in the mesh of the paper.
"""

from __future__ import annotations

import numpy as np

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """Setting ``vertices``: n."""
    n = float(seen.settings["vertices"])
    ball, sheet = seen.points["ball"], seen.points["sheet"]
    away = (ball.mean(axis=1) - sheet.mean(axis=1))[:, :2]
    away[: seen.acting] = 0.0
    by_ball, by_sheet = np.zeros_like(ball), np.zeros_like(sheet)
    by_ball[..., :2] = (-2.0 * n / ball.shape[1]) * away[:, None]
    by_sheet[..., :2] = (2.0 * n / sheet.shape[1]) * away[:, None]
    sought = np.array([*sheet[-1, :, :2].mean(axis=0), ball[-1, :, 2].mean()])
    return Scored(-n * float((away**2).sum()), {"ball": by_ball, "sheet": by_sheet}, {}, sought={"ball": sought[None]})
