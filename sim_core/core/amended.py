"""Laws that a rollout on the core lacks, followed along its path: what they would change in the forces of each step.

A second record of the same nodes, with a memory of its own, is led along the path (include/responses.hpp).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.core.rollout import CoreRollout
from sim_core.core.slopes import NumberSlopes
from sim_core.core.state import CoreState
from sim_core.energies.term import Internals
from sim_core.permanent_state import PermanentState, lasting
from sim_core.scene.scene import Scene
from sim_core.solve.report import NewtonSettings


class Followed(CoreState):
    """A scene with laws that a ``rollout`` lacks, as it is configured now, led along the path of that. ``column``: that
    is to answer to what they change in the forces, None where none is. ``left``, ``kept``: what bodies keep of an
    earlier rollout of the baseline, and of one that the scene itself was led along."""

    def __init__(
        self,
        scene: Scene,
        rollout: CoreRollout,
        column: int | None,
        left: PermanentState | None,
        kept: Mapping[str, Internals],
    ) -> None:
        self._whole_scene = scene
        scene.targets(rollout.frames(0))  # turns rigid bodies
        super().__init__(scene, NewtonSettings(), NumberSlopes(), np.zeros(0, dtype=int))
        self._array("rotation")[:] = np.concatenate([np.zeros(0), *(t.rotation_target.ravel() for t in self.contacts)])
        for internals in (left.internals if left is not None else {}, kept):
            self.put_internals(internals)
        rollout.lead(self, column)

    def lasting(self) -> dict[str, Internals]:
        """Internal variables that last, as they are now, by term."""
        names, state = lasting(self._whole_scene), self.state_now(0.0)
        return {term: {name: state.internals[term][name] for name in own} for term, own in names.items()}
