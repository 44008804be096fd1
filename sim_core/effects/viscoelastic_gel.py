"""Viscoelastic gel: Maxwell elements parallel to its own law, as many as are named.

    dz/dt = dE/dt - z / tau,    S = g D z,    D E = 2 mu (E - tr(E) / 3 1)

of Green strains E, in each step as of :mod:`sim_core.effects.viscoelastic_sheet`: finite linear viscoelasticity of
shear (Coleman & Noll, Rev. Mod. Phys. 33, 1961). The modulus of the rig is that in slow motion. Several relaxation
times are several instances, by labels: ``viscoelastic_gel@pad#fast``, ``viscoelastic_gel@pad#slow``."""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import GELS
from sim_core.effects.viscoelastic_sheet import maxwell


class ViscoelasticGel(MaterialLaw):
    """A gel with Maxwell elements parallel to its stiffness."""

    name = "viscoelastic_gel"
    title = "the gel creeps"
    words = "The gel is stiffer in fast motion than in slow one: a share on top of its shear stiffness fades in time."
    signature = "Forces of fast presses are too small, fade in holds, and agree in slow presses."
    source = "Coleman & Noll, Rev. Mod. Phys. 33, 1961 (finite linear viscoelasticity)"
    slot = "gel"
    follows = "sensor"
    passive = True
    scope = GELS
    twins = ("gel_relaxation", "gel_viscosity", "wrench_warm_up")
    separated_by = "Presses at speeds a decade apart, each held for long: each branch shows at one of them."
    parameters = (
        EffectParameter("share", "-", 0.0, 20.0, (0.3,), 0.0, False, 0.5, "stiffness that fades over that which stays"),
        EffectParameter(
            "tau_s", "s", 1e-3, 1e4, (0.05, 1.0), None, True, 2.0, "time constant", "duration_s", (0.01, 0.2)
        ),
    )
    parts = ("solid",)
    example = {"share": 0.5, "tau_s": 0.1}
    formula = MaterialFormula(maxwell)

    def state(self) -> Mapping[str, tuple[int, ...]]:
        return {"spring": (6,)}
