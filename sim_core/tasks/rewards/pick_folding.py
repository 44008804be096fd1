"""Pick-Folding: push a sheet together until it stands up and creases across its middle.

    R = n F      F the plastic fold angle across the middle line [rad], bent upwards counted as positive

n = 16 is the number of hinges across the sheet in the mesh of the paper, whose reward is the sum of their angles. (It
also adds a hundredth of their whole angle.)
"""

from __future__ import annotations

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """Settings ``hinges``: n, and ``sign``: of the fold angle towards which the sheet is to crease."""
    n = float(seen.settings["hinges"]) * float(seen.settings["sign"])
    return Scored(n * seen.folds["middle"], {}, {"middle": n})
