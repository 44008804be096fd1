"""Stress relaxation of a gel: part of its stress fades while it is held.

One Prony branch on the deviatoric stress, F(t) / F(0) = 1 - g (1 - exp(-t / tau)) when held (Simo & Hughes,
Computational Inelasticity, box 10.4; :mod:`sim_core.energies.neo_hookean`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MechanicsMap
from sim_core.rigs import Gel, Rig

if TYPE_CHECKING:
    from sim_core.scene.scene import Values as SceneValues


class GelRelaxation(MechanicsMap):
    """A share of the stress of a gel that fades with a time constant."""

    name = "gel_relaxation"
    title = "the gel relaxes"
    words = (
        "The gel's stress fades while it is held deformed: a share g of its shear stress decays with the "
        "time constant tau (a Maxwell element beside the spring)."
    )
    signature = (
        "In a hold the measured force goes on falling, and in fast presses the gel is stiffer than in slow ones."
    )
    source = "Simo & Hughes, Computational Inelasticity, 1998, box 10.4"
    slot = "gel"
    follows = "sensor"
    passive = True
    needs = "a gel"
    twins = ("wrench_offset",)
    separated_by = "A press that is held, released and held again in air: a drift of the sensor goes on in air."
    parameters = (
        EffectParameter("share", "-", 0.0, 0.95, (0.25,), 0.0, False, 0.3, "share of the shear stress that fades"),
        EffectParameter(
            "tau_s", "s", 0.01, 100.0, (0.05, 0.25, 1.0), None, True, 2.0, "time constant", "duration_s",
            (0.01, 0.05, 0.25),
        ),
    )  # fmt: skip

    def targets(self, rig: Rig) -> tuple[str, ...]:
        return tuple(n for n, b in rig.bodies.items() if isinstance(b, Gel))

    def amend_values(self, rig: Rig, targets: tuple[str, ...], found: SceneValues, values: Values) -> None:
        for name in targets:
            found.terms[f"{name}.elastic"].update(relaxation_g=values["share"], relaxation_tau_s=values["tau_s"])
