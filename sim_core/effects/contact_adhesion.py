"""Adhesion at contacts: surfaces that touch attract each other over a short distance, and resist being pulled apart.

With the work of adhesion w [J/m^2], the range d [m] and s = g / d, energy and attraction per area are

    psi(g) = -w (1 - s)^2 (1 + 2 s),    p(g) = -6 w / d s (1 - s)    0 <= s <= 1
    psi(g) = -w,                        p(g) = 0                      s < 0
    psi(g) = 0,                         p(g) = 0                      s > 1

so pulling apart a unit of area takes w, and the greatest attraction, 3 w / (2 d), is at half the range: a cohesive zone
(Xu & Needleman, Modelling Simul. Mater. Sci. Eng. 1, 1993; in place of their exponential a cubic of finite range). A
rigid sphere of radius R is pulled off with 2 pi w R where the range is long beside the indentation (DMT) and 3/2 pi w R
where it is short (JKR; Maugis, J. Colloid Interface Sci. 150, 1992).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import Normal, NormalLaw
from sim_core.rigs import Rig


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
    needs = "a contact"
    twins = ("wrench_offset", "gel_relaxation")
    separated_by = "Presses to several depths: the greatest pull is the same for all of them."
    parameters = (
        EffectParameter("work_j_m2", "J/m^2", 0.0, 10.0, (0.05, 0.5), 0.0, False, 0.2, "work of adhesion"),
        EffectParameter("range_m", "m", 1e-6, 1e-2, (1e-4,), None, True, 1.0, "distance over which surfaces attract"),
    )

    def targets(self, rig: Rig) -> tuple[str, ...]:
        return tuple(c.name for c in rig.contacts)

    def reach(self, values: Values) -> float:
        return values["range_m"] if values["work_j_m2"] > 0.0 else 0.0

    def normal(self, gap: np.ndarray, values: Values) -> Normal:
        work, span = values["work_j_m2"], values["range_m"]
        s = np.clip(gap / span, 0.0, 1.0)
        inside = (gap > 0.0) & (gap < span)
        energy = -work * (1.0 - s) ** 2 * (1.0 + 2.0 * s)
        slope = np.where(inside, 6.0 * work / span**2 * (1.0 - 2.0 * s), 0.0)
        return Normal(energy, -6.0 * work / span * s * (1.0 - s), slope)

    def normal_by(self, gap: np.ndarray, values: Values) -> Mapping[str, np.ndarray]:
        work, span = values["work_j_m2"], values["range_m"]
        s = np.clip(gap / span, 0.0, 1.0)
        by_range = np.where((gap > 0.0) & (gap < span), 6.0 * work / span**2 * s * (2.0 - 3.0 * s), 0.0)
        return {"work_j_m2": -6.0 / span * s * (1.0 - s), "range_m": by_range}
