"""What the compiled core covers; all else runs on :mod:`sim_core.solve`."""

from __future__ import annotations

from sim_core.contact.edges import EdgeContact
from sim_core.contact.rigid import RigidContact
from sim_core.contact.surface import SurfaceContact
from sim_core.core.layout import layout_of
from sim_core.core.library import load
from sim_core.energies.bending import Bending
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.permanent_state import PermanentState
from sim_core.scene.scene import Scene

WIDEST = 160
"""Width of the factor's rows up to which the core is the faster path where its factor is the envelope, whose flops grow
with the square of that: at 125 entries it was 2.1 times as fast as the other path, at 177 1.1 times
(docs/design/compiled_core.md)."""


def covers(scene: Scene, *, keep_states: bool = False, left: PermanentState | None = None) -> str | None:
    """Why a rollout is not for the compiled core, in a sentence; None where it is. ``keep_states``, ``left``: as of
    :func:`sim_core.simulate.simulate`."""
    if keep_states:
        return "Pressures and slip at all instants are asked for, which the core does not keep."
    if left is not None:
        return "Bodies carry what an earlier rollout has left, which the core does not know."
    loaded = load()
    if loaded.functions is None:
        return loaded.lack
    for term in scene.system.terms:
        if type(term) not in (Membrane, Bending, NeoHookean, MassDamping, RigidContact, SurfaceContact, EdgeContact):
            return f"The core has no elements for {term.name} ({type(term).__name__})."
        if isinstance(term, Bending) and term.initial_internals():
            return f"The core has no plastic flow, which {term.name} has."
        if isinstance(term, NeoHookean) and term.relaxes:
            return f"The core has no relaxation, which {term.name} has."
        if isinstance(term, Membrane | Bending | NeoHookean) and term.grading is not None and term.grading.changes:
            return f"The core has no stiffness that changes in time, as that of {term.name} does."
        if isinstance(term, RigidContact | SurfaceContact | EdgeContact) and term.laws.amended:
            return f"The core does not have the laws that effects add to {term.name}."
    if scene.system.embedding is not None or scene.compliant:
        return "The core has no joints and no end effectors that give way."
    if not scene.all_held:
        return "The core has no bodies that nothing holds."
    width = layout_of(scene).width
    if width > WIDEST and not loaded.supernodes:
        return f"Without MKL the core's factor has rows of up to {WIDEST} entries, and here {width:.0f} are needed."
    return None
