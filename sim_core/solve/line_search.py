"""How much of a step to make: up to where the residual has no part along it any more.

Matthies & Strang, Int. J. Numer. Meth. Eng. 14, 1979, by false position.
"""

from __future__ import annotations

import numpy as np

from sim_core.solve.system import System

ENOUGH = 0.3
"""The residual along the step may keep this share of what it was at its start."""

TRIES = 4
"""Shorter steps that are tried."""


def shorten(
    system: System, start: np.ndarray, step: np.ndarray, before: float, after: float
) -> tuple[float, np.ndarray | None, int]:
    """Shorten ``step`` [m] from the unknowns ``start`` [m] if it overshoots. ``before``, ``after``: the residual
    along it there (negative) and behind all of it [J].

    Returns the share of the step that the system was left at, the residual [N] there (None: the whole step was
    left as it is) and how often it was evaluated.
    """
    low, high, at_low, at_high = 0.0, 1.0, before, after
    enough = ENOUGH * abs(before)
    share, along, g = 1.0, after, None
    tries = 0
    while tries < TRIES and (along > enough or (tries and along < -enough)):
        share = (low * at_high - high * at_low) / (at_high - at_low)
        share = min(max(share, 0.9 * low + 0.1 * high), 0.1 * low + 0.9 * high)
        system.set_unknowns(start + share * step)
        g = system.residual()
        along = float(g @ step)
        tries += 1
        if along > 0.0:
            high, at_high = share, along
        else:
            low, at_low = share, along
    return share, g, tries
