"""Viscosity of a gel (Kelvin-Voigt): stress in proportion to the rate of strain, in addition to the elastic one.

    S = S_e(C) + beta dS_e/dt

added to what the rig says for beta (Christensen, Theory of Viscoelasticity, 2nd ed., sec. 1.3;
:mod:`sim_core.energies.neo_hookean`): the viscosity is beta times the shear modulus.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MaterialMap
from sim_core.effects.scopes import GELS


class GelViscosity(MaterialMap):
    """A gel that resists being deformed quickly."""

    name = "gel_viscosity"
    title = "the gel is viscous"
    words = (
        "The gel resists fast deformation, with a stress proportional to the rate of strain that ends with the motion."
    )
    signature = "The force is too small while the finger presses in, too large while it draws back, and right in holds."
    source = "Christensen, Theory of Viscoelasticity, 2nd ed., 1982, sec. 1.3 (Kelvin-Voigt)"
    slot = "gel"
    follows = "sensor"
    passive = True
    scope = GELS
    twins = ("stream_delay", "gel_relaxation", "wrench_low_pass")
    separated_by = (
        "The same press on a soft and on a hard object: a late clock scales with the stiffness, viscosity does not."
    )
    parameters = (
        EffectParameter(
            "beta_s", "s", 0.0, 10.0, (2e-3, 2e-2), 0.0, False, 0.02, "viscous over elastic modulus", "sampling_s",
            (0.2, 2.0),
        ),
    )  # fmt: skip
    example = {"beta_s": 0.02}

    def amend_material(self, material: Any, values: Values) -> Mapping[str, float]:
        return {"stiffness_damping_s": material.stiffness_damping_s + values["beta_s"]}
