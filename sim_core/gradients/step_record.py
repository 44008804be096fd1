"""A step that was made: what it takes to have its end before oneself again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from sim_core.gradients.step import LinearStep
from sim_core.scene.scene import Frame, Scene
from sim_core.solve.integrator import step_context
from sim_core.solve.step import State


@dataclass(frozen=True)
class Made:
    """One step without subdivision: from ``before`` to ``after`` in ``dt`` [s]; at its end the mounts are at
    ``frames`` and the system has the ``unknowns``. ``linear``: the step linearised, if that was kept."""

    before: State
    after: State
    dt: float
    frames: Mapping[str, Frame]
    unknowns: np.ndarray
    linear: LinearStep | None = None

    def enter(self, scene: Scene) -> None:
        """Let the system hold the end of the step."""
        system, before = scene.system, self.before
        system.guard(True)
        targets = scene.targets(self.frames)
        system.x[:] = before.x
        system.set_targets(targets)
        step = step_context(before.x, before.v, self.dt, before.past, before.t)
        system.begin_step(replace(step, v_start=(self.after.x - before.x) / self.dt), before.internals)
        system.set_unknowns(self.unknowns)
        system.cover()

    def state_bytes(self) -> int:
        """Memory of the state at the end; that before is the step before's."""
        return size_of_state(self.after) + self.unknowns.nbytes

    def size_bytes(self) -> int:
        """Memory of the state and of the linearisation."""
        return self.state_bytes() + (self.linear.size_bytes() if self.linear else 0)


def size_of_state(state: State) -> int:
    """Memory of a state [B]."""
    internals = sum(a.nbytes for term in state.internals.values() for a in term.values())
    return state.x.nbytes + state.v.nbytes + internals
