"""Adhesion at contacts: surfaces that touch attract each other over a short distance, and resist being pulled apart.

With the work of adhesion w [J/m^2], the range d [m] and s = g / d, energy and attraction per area are

    psi(g) = -w (1 - s)^2 (1 + 2 s),    p(g) = -6 w / d s (1 - s)    0 <= s <= 1
    psi(g) = -w,                        p(g) = 0                      s < 0
    psi(g) = 0,                         p(g) = 0                      s > 1

so pulling apart a unit of area takes w, and the greatest attraction, 3 w / (2 d), is at half the range: a cohesive zone
(Xu & Needleman, Modelling Simul. Mater. Sci. Eng. 1, 1993; in place of their exponential a cubic of finite range). A
rigid sphere of radius R is pulled off with 2 pi w R where the range is long compared with the indentation (DMT) and 3/2
pi w R where it is short (JKR; Maugis, J. Colloid Interface Sci. 150, 1992).
"""

from __future__ import annotations

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import NormalLaw
from sim_core.effects.scopes import CONTACTS


def cohesion(gap: float, work_j_m2: float, range_m: float) -> float:
    """psi(g) [J/m^2]."""
    s = min(1.0, max(0.0, gap / range_m))
    return -work_j_m2 * (1.0 - s) ** 2 * (1.0 + 2.0 * s)


class ContactAdhesion(NormalLaw):
    """Contacts that stick."""

    name = "contact_adhesion"
    title = "contacts stick together"
    words = (
        "Surfaces that touch attract each other: pulling them apart takes the work of adhesion for every square metre, "
        "and the force turns negative before they part."
    )
    signature = "On the way out the measured force is a pull, and contact ends later than it began."
    source = "Xu & Needleman, Modelling Simul. Mater. Sci. Eng. 1, 1993 (cohesive zone); Maugis 1992 (sphere)"
    slot = "contact"
    passive = True
    scope = CONTACTS
    twins = ("wrench_offset", "gel_relaxation")
    separated_by = "Presses to several depths: the greatest pull is the same for all of them."
    parameters = (
        EffectParameter("work_j_m2", "J/m^2", 0.0, 10.0, (0.05, 0.5), 0.0, False, 0.2, "work of adhesion"),
        EffectParameter("range_m", "m", 1e-6, 1e-2, (1e-4,), None, True, 1.0, "distance over which surfaces attract"),
    )
    example = {"work_j_m2": 0.5, "range_m": 0.0002}
    energy = Law(cohesion)

    def reach(self, values: Values) -> float:
        return values["range_m"] if values["work_j_m2"] > 0.0 else 0.0
