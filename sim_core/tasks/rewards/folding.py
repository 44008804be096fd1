"""Folding: crease a bent sheet at one line rather than at another.

    R = n (F_here - F_there)      F the plastic fold angles across the two lines [rad]

n = 3 is the number of hinges across the sheet in the mesh of the paper, whose reward is the sum of their angles.
"""

from __future__ import annotations

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """Setting ``hinges``: n."""
    n = float(seen.settings["hinges"])
    return Scored(n * (seen.folds["here"] - seen.folds["there"]), {}, {"here": n, "there": -n})
