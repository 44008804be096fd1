"""What bodies keep when a rollout ends: the set of a sheet that yielded, the softening of a gel that was pressed.

Rates and whatever relaxes is gone by the time that the next recording of the same bodies begins; internal variables
that a term or an effect calls ``lasting`` are as they were, in bodies that something holds. A sheet that has a set
begins in the shape in which it ended, carried along with its hands: put flat, it would be bent back, and might yield
anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim_core.energies.linearised import places
from sim_core.energies.term import Internals
from sim_core.rigs import Sheet

if TYPE_CHECKING:
    from sim_core.scene.scene import Frame, Scene
    from sim_core.solve.step import State


@dataclass(frozen=True)
class PermanentState:
    """``internals``: lasting internal variables by term; ``x`` [m] ``(n, 3)``: where all nodes were when the mounts
    were at ``frames``; ``shaped``: bodies that begin in that shape. ``by_internals``: derivatives of these internal
    variables by p parameters, ``(..., p)``, ``by_x`` ``(n, 3, p)``: of the positions; None where there are none."""

    internals: Mapping[str, Internals]
    x: np.ndarray
    frames: Mapping[str, Frame]
    shaped: frozenset[str]
    by_internals: Mapping[str, Internals] | None = None
    by_x: np.ndarray | None = None

    def along(self, columns: np.ndarray, count: int) -> PermanentState:
        """The same with its derivatives as ``columns`` of ``count``, zero by others."""

        def widened(by: np.ndarray) -> np.ndarray:
            out = np.zeros((*by.shape[:-1], count))
            out[..., columns] = by
            return out

        if self.by_internals is None or self.by_x is None:
            return self
        by = {term: {name: widened(v) for name, v in own.items()} for term, own in self.by_internals.items()}
        return replace(self, by_internals=by, by_x=widened(self.by_x))


def lasting(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Names of the internal variables that last, by term; terms without any are left out, and so are those of bodies
    that nothing holds: where and how these lie when the next rollout begins is unknown."""
    named = {term.name: getattr(term, "lasting", ()) if _held(scene, term.name) else () for term in scene.system.terms}
    virgin = {term.name: term.initial_internals() for term in scene.system.terms if named[term.name]}
    kept = {term: tuple(name for name in named[term] if name in own) for term, own in virgin.items()}
    return {term: names for term, names in kept.items() if names}


def _held(scene: Scene, term: str) -> bool:
    body = term.split(".")[0]
    return body in scene.bodies and bool(scene.held(body).any())


def permanent_state(
    scene: Scene,
    state: State,
    frames: Mapping[str, Frame],
    by_memory: Mapping[str, np.ndarray] | None = None,
    by_x: np.ndarray | None = None,
) -> PermanentState | None:
    """What is left at a state, with the mounts at ``frames``; None where nothing lasts. ``by_memory``: derivatives of
    all internal variables, flattened ``(q, p)`` by term, ``by_x`` ``(n, 3, p)``: of the positions."""
    names = lasting(scene)
    if not names:
        return None
    internals = {term: {n: state.internals[term][n] for n in own} for term, own in names.items()}
    by = None
    if by_memory is not None:
        at = {term: places(state.internals[term]) for term in names}
        by = {term: {n: by_memory[term][at[term][n]] for n in own} for term, own in names.items()}
    bodies = {term.split(".")[0] for term in names}
    shaped = frozenset(name for name in bodies if isinstance(scene.rig.bodies.get(name), Sheet))
    return PermanentState(internals, state.x, dict(frames), shaped, by, by_x)
