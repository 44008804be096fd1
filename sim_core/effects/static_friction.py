"""Static above kinetic friction: a resting contact holds more than a sliding one."""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.effects.effect import Effect, EffectParameter
from sim_core.rigs import Rig
from sim_core.scene.scene import Values

SLIP_SPEED_SCALE_M_S = 2e-3
"""Slip speed by which the static part has fallen to 1/e."""


class StaticFriction(Effect):
    """mu(v) = mu_k (1 + a exp(-(v/v_s)^2)) (:mod:`sim_core.contact.law`)."""

    name = "static_friction"
    title = "contacts stick before they slide"
    slot = "contact"
    words = (
        "Friction is higher at rest than in motion: contacts hold up to (1 + a) times the sliding friction "
        "and then let go."
    )
    parameters = (
        EffectParameter(
            "excess", "-", 0.0, 5.0, (0.1, 0.2, 0.4, 0.8), 0.0, False, 0.5, "static over kinetic friction, less one"
        ),
    )

    def applies(self, rig: Rig) -> bool:
        return any(c.friction > 0.0 for c in rig.contacts)

    def amend_values(self, rig: Rig, values: Values, given: Mapping[str, float]) -> None:
        for name, terms in values.terms.items():
            if name.startswith("contact."):
                terms.update(static_excess=given["excess"], slip_speed_scale_m_s=SLIP_SPEED_SCALE_M_S)
