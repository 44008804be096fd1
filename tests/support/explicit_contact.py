"""Rigs whose contacts have constants of their own, where a test is about derivatives and not about the defaults."""

from __future__ import annotations

from sim_core.rigs import Rig

RANGE_M, STIFFNESS_PA_PER_M = 3e-5, 5e9


def explicit_contact(rig: Rig) -> Rig:
    """The rig with a range and a stiffness at each contact, which then follow neither cells nor moduli."""
    given = {"range_m": RANGE_M, "stiffness_pa_per_m": STIFFNESS_PA_PER_M}
    return rig.model_copy(update={"contacts": tuple(c.model_copy(update=given) for c in rig.contacts)})
