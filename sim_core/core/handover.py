"""Steps that the core's search gives up: made by the searches of :mod:`sim_core.solve`, halved if need be."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.errors import ConvergenceError
from sim_core.scene.scene import Frame, Scene
from sim_core.simulation import MAX_HALVINGS, Simulation
from sim_core.solve.report import NewtonSettings, StepReport
from sim_core.solve.step import State


class SlowSteps(Simulation):
    """Steps from a state of the core. ``parts``: lengths [s], frames and positions [m] ``(n, 3)`` at the ends of those
    that the last one was cut into."""

    def __init__(self, scene: Scene, settings: NewtonSettings) -> None:
        self.parts: list[tuple[float, Mapping[str, Frame], np.ndarray]] = []
        super().__init__(scene, settings, settle=False)

    def begin(self, state: State, frames: dict[str, Frame]) -> None:
        """Be in a state."""
        self.state, self.frames = state, frames
        self.parts = []

    def step(self, frames: Mapping[str, Frame], dt: float) -> StepReport:
        """As of any simulation, to the true frames of the mounts."""
        begin, target = self.frames, {**self.frames, **frames}
        try:
            return self._step(begin, target, dt, MAX_HALVINGS)
        except ConvergenceError as error:
            raise type(error)(f"{error.problem} {self._unmade(begin, target)}".strip(), error.remedy) from error

    def _advance(self, end: Mapping[str, Frame], dt: float) -> StepReport:
        report = super()._advance(end, dt)
        self.parts.append((dt, end, self.state.x))
        return report
