"""Stress relaxation of the gel: part of its shear stress fades with one time constant."""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.effects.effect import Effect, EffectParameter
from sim_core.rigs import Gel, Rig
from sim_core.scene.scene import Values


class GelRelaxation(Effect):
    """One Prony branch on the deviatoric stress: F(t)/F(0) = 1 - g (1 - exp(-t/tau)) when held."""

    name = "gel_relaxation"
    title = "the gel relaxes"
    slot = "gel"
    words = (
        "The gel's stress fades while it is held deformed: a share g of its shear stress decays with the "
        "time constant tau (a Maxwell element beside the spring)."
    )
    parameters = (
        EffectParameter("share", "-", 0.0, 0.95, (0.25,), 0.0, False, 0.3, "share of the shear stress that fades"),
        EffectParameter("tau_s", "s", 0.01, 100.0, (0.05, 0.25, 1.0), None, True, 2.0, "time constant"),
    )

    def applies(self, rig: Rig) -> bool:
        return any(isinstance(b, Gel) for b in rig.bodies.values())

    def amend_values(self, rig: Rig, values: Values, given: Mapping[str, float]) -> None:
        for name, body in rig.bodies.items():
            if isinstance(body, Gel):
                values.terms[f"{name}.elastic"].update(relaxation_g=given["share"], relaxation_tau_s=given["tau_s"])
