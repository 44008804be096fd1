"""Stribeck friction: it falls from rest to slow sliding and rises again with speed.

    mu(v) = mu_k (1 + a exp(-v / v_s) + v / v_v)

with the slip speed v of the last step: Tustin's exponential and a viscous part (Armstrong-Helouvry, Dupont & Canudas de
Wit, Automatica 30, 1994, eq. 7). The viscosity is given as 1 / v_v.
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import FrictionFactor, FrictionLaw, Sliding
from sim_core.rigs import Rig


class StribeckFriction(FrictionLaw):
    """Contacts whose friction depends on how fast they slide."""

    name = "stribeck_friction"
    title = "friction depends on the speed of sliding"
    words = "Friction falls from its value at rest as sliding begins, and rises again in proportion to the speed."
    signature = "The ratio of tangential to normal force in slides differs from one speed to another."
    source = "Armstrong-Helouvry, Dupont & Canudas de Wit, Automatica 30, 1994"
    slot = "contact"
    passive = True
    needs = "a contact with friction"
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

    def targets(self, rig: Rig) -> tuple[str, ...]:
        return tuple(c.name for c in rig.contacts if c.friction > 0.0)

    def friction(self, at: Sliding, values: Values) -> FrictionFactor:
        excess, scale, viscous = values["excess"], values["speed_m_s"], values["viscous_s_m"]
        fade = np.exp(-at.speed / scale)
        by = {"excess": fade, "speed_m_s": excess * fade * at.speed / scale**2, "viscous_s_m": at.speed}
        value = 1.0 + excess * fade + viscous * at.speed
        return FrictionFactor(value, np.zeros_like(fade), viscous - excess * fade / scale, by)
