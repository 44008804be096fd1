"""Electrostatic attraction: charged surfaces pull at each other before they touch.

    psi(g) = -p_0 d / 3 (1 - g / d)^3,    p(g) = -p_0 (1 - g / d)^2    0 <= g <= d;    p(g) = -p_0    g < 0

with the attraction p_0 of closed surfaces and its range d. A capacitor with a layer of the thickness d_0 at the voltage
V has p_0 / (1 + g / d_0)^2, p_0 = epsilon V^2 / (2 d_0^2) (Jackson, Classical Electrodynamics, 3rd ed., sec. 1.11); in
place of the inverse square one of finite range, next to it over d = 3 d_0."""

from __future__ import annotations

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import NormalLaw
from sim_core.effects.scopes import CONTACTS


def attraction(gap: float, pressure_pa: float, range_m: float) -> float:
    """psi(g) [J/m^2]."""
    left = min(1.0, max(0.0, 1.0 - gap / range_m))
    return -pressure_pa * range_m / 3.0 * left**3 + pressure_pa * min(gap, 0.0)


class ElectrostaticAttraction(NormalLaw):
    """Contacts that attract over a distance."""

    name = "electrostatic_attraction"
    title = "charged surfaces attract"
    words = "Charged surfaces pull at each other from a distance, the more the nearer they are."
    signature = "Light sheets move towards the finger, and the force is a pull, before there is contact."
    source = "Jackson, Classical Electrodynamics, 3rd ed., 1999, sec. 1.11"
    slot = "contact"
    follows = "session"
    passive = True
    scope = CONTACTS
    twins = ("contact_adhesion", "air_drag")
    separated_by = "A slow approach that ends short of contact, before and after the surfaces were ionised or grounded."
    parameters = (
        EffectParameter("pressure_pa", "Pa", 0.0, 1e5, (20.0, 200.0), 0.0, False, 100.0, "attraction without a gap"),
        EffectParameter("range_m", "m", 1e-5, 5e-2, (1e-3,), None, True, 1.0, "distance from which on there is none"),
    )
    example = {"pressure_pa": 60.0, "range_m": 0.001}
    energy = Law(attraction)

    def reach(self, values: Values) -> float:
        return values["range_m"] if values["pressure_pa"] > 0.0 else 0.0
