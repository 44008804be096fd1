"""Soft layer between surfaces: asperities, dust or a film bear load before the surfaces themselves meet.

    psi(g) = p_0 d / 3 (1 - g / d)^3,    p(g) = p_0 (1 - g / d)^2    g < d;    0 beyond

with the layer's thickness d and the pressure p_0 that closes the gap. Random roughness gives p_0 exp(-g / u) (Persson,
Phys. Rev. Lett. 99, 125502, 2007); in place of the exponential a square of finite range, which is next to it over d = 3
u. The layer has no friction of its own."""

from __future__ import annotations

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import NormalLaw
from sim_core.effects.scopes import CONTACTS


def layer(gap: float, pressure_pa: float, thickness_m: float) -> float:
    """psi(g) [J/m^2]."""
    return pressure_pa * thickness_m / 3.0 * max(0.0, 1.0 - gap / thickness_m) ** 3


class SoftLayer(NormalLaw):
    """Contacts with something soft in between."""

    name = "soft_layer"
    title = "a soft layer lies between the surfaces"
    words = "Roughness, dust or a film between the surfaces bears load before they meet, and is soon pressed flat."
    signature = "Contact begins earlier and more gently than simulated, and agrees once it is firm."
    source = "Persson, Phys. Rev. Lett. 99, 125502, 2007 (exponential of random roughness)"
    slot = "contact"
    passive = True
    scope = CONTACTS
    twins = ("tool_offset", "gel_relaxation")
    separated_by = "Presses to several depths: a layer matters at small loads alone, an offset at all of them."
    parameters = (
        EffectParameter("pressure_pa", "Pa", 0.0, 1e8, (1e3, 1e4), 0.0, False, 5e3, "pressure that closes the gap"),
        EffectParameter("thickness_m", "m", 1e-6, 1e-2, (1e-4, 5e-4), None, True, 1.0, "thickness of the layer"),
    )
    example = {"pressure_pa": 500.0, "thickness_m": 0.0005}
    energy = Law(layer)

    def reach(self, values: Values) -> float:
        return values["thickness_m"] if values["pressure_pa"] > 0.0 else 0.0
