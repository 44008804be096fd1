"""How much of a Newton step to make where contact stands in its way.

A step d from x_0 ends where the residual g vanishes along it if everything answers as linearised. What does not is
contact: points that come to touch, gaps whose pressure grows without bound, friction that gives way. Contact alone
is cheap to look at, so a step is made up to the share a at which

    phi(a) = (1 - a) g_0 . d + C(a) - C(0) - a C'(0),    C(a) = d . (gradient of contact at x_0 + a d),

the residual along it with everything but contact as foreseen, has no more to say: Matthies & Strang, Int. J. Numer.
Meth. Eng. 14, 1979, by false position (Illinois: Dowell & Jarratt, BIT 11, 1971). The residual itself would not
do: a thin sheet that turns stretches in a linearised step, and the stress of that stretch is not real.
"""

from __future__ import annotations

from collections.abc import Callable

from sim_core.solve.line_search import ENOUGH

TRIES = 12
"""Shorter steps that are tried."""

APART = 1e-3
"""Share of the step over which the slope of C is measured."""


def contact_share(along: Callable[[float], float], before: float) -> tuple[float, int]:
    """Share of a step to make, and how many were tried. ``along``: C at a share [J], which also goes there;
    ``before``: g_0 . d [J], negative. The system is left at some share of the step."""
    enough = ENOUGH * abs(before)
    start, near, end = along(0.0), along(APART), along(1.0)
    if end - start <= enough:
        return 1.0, 3
    slope = (near - start) / APART

    def phi(share: float, found: float) -> float:
        return (1.0 - share) * before + found - start - share * slope

    share, value = 1.0, phi(1.0, end)
    low, at_low, high, at_high = 0.0, before, 1.0, value
    tries, side = 0, 0
    while tries < TRIES and not (value <= enough and (tries == 0 or value >= -enough)):
        share = (low * at_high - high * at_low) / (at_high - at_low)
        share = min(max(share, 0.7 * low + 0.3 * high), 0.3 * low + 0.7 * high)
        value = phi(share, along(share))
        tries += 1
        if value > 0.0:
            high, at_high, at_low = share, value, at_low if side <= 0 else 0.5 * at_low
            side = 1
        else:
            low, at_low, at_high = share, value, at_high if side >= 0 else 0.5 * at_high
            side = -1
    return share, tries + 3
