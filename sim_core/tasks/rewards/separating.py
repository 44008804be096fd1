"""Separating: draw a sheet away from under a block.

R = N_sheet (mean x of the block - mean x of the sheet) at the end [m], over the observed points
"""

from __future__ import annotations

import numpy as np

from sim_core.tasks.measure import Scored, Seen


def reward(seen: Seen) -> Scored:
    """No settings."""
    block, sheet = seen.points["block"], seen.points["sheet"]
    count = sheet.shape[1]
    by_block, by_sheet = np.zeros_like(block), np.zeros_like(sheet)
    by_block[-1, :, 0], by_sheet[-1, :, 0] = count / block.shape[1], -1.0
    value = count * float(block[-1, :, 0].mean() - sheet[-1, :, 0].mean())
    return Scored(value, {"block": by_block, "sheet": by_sheet}, {})
