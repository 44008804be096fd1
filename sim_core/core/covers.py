"""What the compiled core covers."""

from __future__ import annotations

from sim_core.contact.edges import EdgeContact
from sim_core.contact.rigid import RigidContact
from sim_core.contact.surface import SurfaceContact
from sim_core.core.mechanics import Mechanics
from sim_core.energies.affine import AffineShape
from sim_core.energies.air_drag import AirDragTerm
from sim_core.energies.bending import Bending
from sim_core.energies.couple import Couple
from sim_core.energies.dead_load import DeadLoad
from sim_core.energies.guide import Guide
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.pressure import Pressure
from sim_core.energies.strain_law import StrainLaws

ELEMENTS = (
    Membrane,
    Bending,
    NeoHookean,
    MassDamping,
    StrainLaws,
    AirDragTerm,
    DeadLoad,
    Pressure,
    RigidContact,
    SurfaceContact,
    EdgeContact,
    AffineShape,
    Guide,
    Couple,
)
"""Terms that the core has elements for: all that scenes of rigs are made of."""


def covers(scene: Mechanics) -> str | None:
    """Why a rollout is not for the compiled core, in a sentence; None where it is."""
    for term in scene.system.terms:
        if type(term) not in ELEMENTS:
            return f"The core has no elements for {term.name} ({type(term).__name__})."
    return None
