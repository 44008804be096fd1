"""Pick-Folding: push a sheet together until it stands up and creases across its middle.

    R = n s (F + 0.01 B)

F the plastic fold angle across the middle line [rad], B the whole angle between the chords from the line ``before`` to
the line ``middle`` and from there to the line ``after`` [rad], each positive where the sheet closes towards +z, and s
the sign towards which it is to crease. n = 16 is the number of hinges across the sheet in the mesh of the paper, whose
reward is the sum over them of the plastic angle and a hundredth of the whole one: this leads to where something yields.
With u the mean chord before the line and w that after it, in the plane of x and z,

    B = atan2(u_x w_z - u_z w_x, u_x w_x + u_z w_z).
"""

from __future__ import annotations

import numpy as np

from sim_core.tasks.measure import Scored, Seen

WHOLE = 0.01
"""Weight of the whole angle."""


def reward(seen: Seen) -> Scored:
    """Settings ``hinges``: n, and ``sign``: s."""
    n = float(seen.settings["hinges"]) * float(seen.settings["sign"])
    before, middle, after = (seen.points[name][-1, :, ::2].mean(axis=0) for name in ("before", "middle", "after"))
    u, w = middle - before, after - middle
    bent = float(np.arctan2(u[0] * w[1] - u[1] * w[0], u @ w))
    # The angle of a chord grows by (x dz - z dx) / |chord|^2.
    by_u, by_w = np.array([u[1], -u[0]]) / (u @ u), np.array([-w[1], w[0]]) / (w @ w)
    by_points = {}
    for name, by in (("before", -by_u), ("middle", by_u - by_w), ("after", by_w)):
        points = seen.points[name]
        by_points[name] = np.zeros_like(points)
        by_points[name][-1, :, ::2] = n * WHOLE / points.shape[1] * by
    return Scored(n * (seen.folds["middle"] + WHOLE * bent), by_points, {"middle": n})
