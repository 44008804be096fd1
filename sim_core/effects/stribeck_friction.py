"""Stribeck friction: it falls from rest to slow sliding and rises again with speed.

    mu(v) = mu_k (1 + a exp(-v / v_s) + v / v_v)

with the slip speed v of the last step: Tustin's exponential and a viscous part (Armstrong-Helouvry, Dupont & Canudas de
Wit, Automatica 30, 1994, eq. 7). The viscosity is given as 1 / v_v.
"""

from __future__ import annotations

import math

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import FrictionLaw
from sim_core.effects.scopes import FRICTION_CONTACTS


def tustin(pressure: float, speed: float, excess: float, speed_m_s: float, viscous_s_m: float) -> float:
    """mu(v) / mu_k."""
    return 1.0 + excess * math.exp(-speed / speed_m_s) + viscous_s_m * speed


class StribeckFriction(FrictionLaw):
    """Contacts whose friction depends on how fast they slide."""

    name = "stribeck_friction"
    title = "friction depends on the speed of sliding"
    words = "Friction falls from its value at rest as sliding begins, and rises again in proportion to the speed."
    signature = "The ratio of tangential to normal force in slides differs from one speed to another."
    source = "Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30, 1994"
    slot = "contact"
    passive = True
    scope = FRICTION_CONTACTS
    twins = ("static_friction", "pressure_friction")
    separated_by = "Slides at four speeds, a decade apart, under the same load."
    parameters = (
        EffectParameter("excess", "-", 0.0, 5.0, (0.3,), 0.0, False, 0.5, "static over kinetic friction, less one"),
        EffectParameter(
            "speed_m_s", "m/s", 1e-6, 1.0, (2e-3, 2e-2), None, True, 1.5, "speed by which the excess falls to 1/e",
            "speed_m_s", (0.05, 0.5),
        ),
        EffectParameter("viscous_s_m", "s/m", 0.0, 1e4, (1.0,), 0.0, False, 5.0, "rise with speed"),
    )  # fmt: skip
    example = {"excess": 0.4, "speed_m_s": 0.02, "viscous_s_m": 2.0}
    factor = Law(tustin, order=1)
