"""Adhesion that forms on touch: surfaces that have touched hold on to each other, and attract nothing as they approach.

The attraction is that of :mod:`sim_core.effects.contact_adhesion`, times a bond beta that each point of the contact
remembers,

    p = beta p(g),    beta -> 1 where the surfaces touch,    beta -> 0 where they are the range apart

(the limit without rate of Raous, Cangemi & Cocu, Comput. Methods Appl. Mech. Eng. 177, 1999). On the way out it is a
cohesive zone; on the way in there is none, which is the hysteresis of adhesion that soft and rough surfaces show
(Israelachvili, Intermolecular and Surface Forces, 2011, 17.12). What it takes is dissipated: w for each unit of area
that is torn off.
"""

from __future__ import annotations

from sim_core.effects.base import EffectParameter
from sim_core.effects.contact_adhesion import ContactAdhesion
from sim_core.effects.scopes import Scope
from sim_core.rigs import Rigid


class ContactBonding(ContactAdhesion):
    """Contacts with rigid bodies that stick once they have touched."""

    name = "contact_bonding"
    title = "contacts hold on once they have touched"
    words = (
        "Surfaces that have touched hold on to each other: tearing them apart takes the work of adhesion for every "
        "square metre, and the force turns negative before they part. As they approach, nothing pulls them together."
    )
    signature = "On the way out the measured force is a pull; on the way in it is that of surfaces that do not stick."
    source = "Raous, Cangemi & Cocu, Comput. Methods Appl. Mech. Eng. 177, 1999; Israelachvili 2011, 17.12"
    scope = Scope(
        "a contact with a rigid body",
        lambda rig: tuple(c.name for c in rig.contacts if any(isinstance(rig.bodies[b], Rigid) for b in c.between)),
    )
    twins = ("contact_adhesion", "gel_relaxation")
    separated_by = "Slow approaches: a reversible attraction pulls surfaces together before they touch."
    parameters = (
        EffectParameter("work_j_m2", "J/m^2", 0.0, 10.0, (0.05, 0.5), 0.0, False, 0.5, "work of adhesion"),
        EffectParameter("range_m", "m", 1e-6, 1e-2, (1e-4,), None, True, 1.0, "distance over which surfaces hold on"),
    )
    bonds = True
