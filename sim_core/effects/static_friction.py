"""Static above kinetic friction: a resting contact holds more than a sliding one.

    mu(v) = mu_k (1 + a exp(-(v / v_s)^2))

with the slip speed v of the last step (Bo & Pavelescu, Wear 82, 1982: the exponential form of Stribeck's curve without
its viscous part) and v_s fixed, since recordings hardly identify it jointly with a.
"""

from __future__ import annotations

import math

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import FrictionLaw
from sim_core.effects.scopes import FRICTION_CONTACTS

SLIP_SPEED_SCALE_M_S = 2e-3
"""Slip speed by which the static part has fallen to 1/e."""


def bump(pressure: float, speed: float, excess: float) -> float:
    """mu(v) / mu_k."""
    return 1.0 + excess * math.exp(-((speed / SLIP_SPEED_SCALE_M_S) ** 2))


class StaticFriction(FrictionLaw):
    """Contacts that hold more at rest than in motion."""

    name = "static_friction"
    title = "contacts stick before they slide"
    words = (
        "Friction is higher at rest than in motion: contacts hold up to (1 + a) times the sliding friction "
        "and then let go."
    )
    signature = "At the onset of sliding the measured tangential force overshoots, and in slow sliding it is jerky."
    source = "Bo & Pavelescu, Wear 82, 1982 (exponential model)"
    slot = "contact"
    passive = True
    scope = FRICTION_CONTACTS
    separated_by = "Slides at several speeds, each begun from rest after the same hold."
    parameters = (
        EffectParameter(
            "excess", "-", 0.0, 5.0, (0.1, 0.2, 0.4, 0.8), 0.0, False, 0.5, "static over kinetic friction, less one"
        ),
    )
    example = {"excess": 0.5}
    factor = Law(bump, order=1)
