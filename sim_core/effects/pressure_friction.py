"""Friction that depends on pressure: a soft surface grips less for each newton, the harder it is pressed.

mu(p) = mu (1 + p / p_0)^-a

with the contact pressure p at the start of a step: a power of the load, a up to 1/3 for rubber whose contacts are those
of smooth asperities (Schallamach, Proc. Phys. Soc. B 65, 1952), and the coefficient of the rig where pressure is small.
"""

from __future__ import annotations

import math

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import FrictionLaw
from sim_core.effects.scopes import FRICTION_CONTACTS


def schallamach(pressure: float, speed: float, exponent: float, pressure_pa: float) -> float:
    """mu(p) / mu."""
    return math.pow(1.0 + max(pressure, 0.0) / pressure_pa, -exponent)


class PressureFriction(FrictionLaw):
    """Contacts whose coefficient of friction falls with pressure."""

    name = "pressure_friction"
    title = "friction depends on pressure"
    words = "The coefficient of friction falls, or rises, as a power of the contact pressure."
    signature = "The ratio of tangential to normal force in slides falls with the normal force."
    source = "Schallamach, Proc. Phys. Soc. B 65, 1952"
    slot = "contact"
    passive = True
    scope = FRICTION_CONTACTS
    twins = ("stribeck_friction", "contact_adhesion")
    separated_by = "Slides under four loads at one speed: adhesion leaves friction at zero load, a power does not."
    parameters = (
        EffectParameter("exponent", "-", -1.0, 1.0, (0.2,), 0.0, False, 0.3, "power by which it falls"),
        EffectParameter("pressure_pa", "Pa", 1.0, 1e8, (1e3, 1e4), None, True, 2.0, "pressure from which on it does"),
    )
    example = {"exponent": 0.3, "pressure_pa": 1000.0}
    factor = Law(schallamach, order=1)
