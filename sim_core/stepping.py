"""A scene that is stepped from Python, under end-effector motion, and what its sensors would read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_core.contact_wrenches import contact_wrenches
from sim_core.core.steps import CoreSteps
from sim_core.errors import ConfigError
from sim_core.permanent_state import PermanentState, permanent_state
from sim_core.scene.scene import Frame, Scene
from sim_core.scene.solid_range import LeastVolume
from sim_core.scene.strain_range import check_strains_at
from sim_core.sensing.observe import Observer
from sim_core.solve.report import NewtonSettings, StepReport
from sim_core.solve.step import State


@dataclass(frozen=True)
class Snapshot:
    """A simulation as it was."""

    steps: CoreSteps
    kept: tuple[Any, ...]
    halvings: int


class Simulation:
    """A scene being stepped.

    ``settle``: begin in equilibrium, where everything is held. ``left``: what an earlier rollout has left of the
    bodies, which are virgin without. ``begin``: the state in which it begins instead. ``halvings``: how often a step
    was halved since the last reset.
    """

    def __init__(
        self,
        scene: Scene,
        settings: NewtonSettings | None = None,
        settle: bool = True,
        left: PermanentState | None = None,
        begin: State | None = None,
    ) -> None:
        self.scene, self.left, self.begin = scene, left, begin
        self.observer = Observer(scene)
        self._settings, self._settle = settings or NewtonSettings(), settle
        self._system = scene.system
        self.halvings = 0
        self.reset()

    def reset(self, frames: Mapping[str, Frame] | None = None) -> None:
        """Back to the start poses (or nominal ``frames``): at rest, in equilibrium when everything is held, or in the
        state :attr:`begin`."""
        self._check_scene()
        self.halvings = 0
        self._steps = CoreSteps(self.scene, self._settings, frames or {}, self.left, self._settle, self.begin)

    def snapshot(self) -> Snapshot:
        """The present, to go back to by :meth:`restore`, as often as wanted, after a reset too."""
        return Snapshot(self._steps, self._steps.kept(), self.halvings)

    def restore(self, snapshot: Snapshot) -> None:
        """Go back to a snapshot of this simulation: what follows is the same bit for bit."""
        self._check_scene()
        self._steps, self.halvings = snapshot.steps, snapshot.halvings
        self._steps.go_back(snapshot.kept)

    def refresh(self) -> None:
        """Go on from the present state with the numbers that the scene has now: materials that :meth:`Scene.use` has
        changed, loads and gravity."""
        self._check_scene()
        self._steps.renew()

    def step(self, frames: Mapping[str, Frame], dt: float) -> StepReport:
        """Move the mounts to nominal ``frames`` within ``dt`` [s]; the step is halved where it does not converge.

        Raises:
            ConvergenceError: no part of the step was found; the state is that before.
        """
        self._check_scene()
        report = self._steps.advance(frames, dt)
        check_strains_at(self.scene, np.array([self._steps.t]), self._steps.now.x)
        self.halvings += report.parts - 1
        return report

    def _check_scene(self) -> None:
        """Raise if the scene was built anew since the simulation was made."""
        if self._system is not self.scene.system:
            raise ConfigError(
                "A body of the scene was given another shape at rest since the simulation was made.",
                "Make another simulation.",
            )

    @property
    def state(self) -> State:
        """Time [s], positions [m] and velocities [m/s] ``(n, 3)`` of nodes, and what bodies and contacts remember. One
        that is put has the time, the past and the pairs in contact of the present one."""
        return self._steps.state

    @state.setter
    def state(self, state: State) -> None:
        self._steps.put(state)

    @property
    def frames(self) -> dict[str, Frame]:
        """Where the mounts are now, offsets of end effectors against their poses included."""
        return self._steps.mounts

    @property
    def least_volumes(self) -> dict[str, LeastVolume]:
        """Where each gel was pressed most since the last reset."""
        return self._steps.least_volumes

    def actual_frames(self) -> dict[str, Frame]:
        """Frames of the mounts with what compliant ones have given way."""
        return self._steps.actual_frames(len(self._steps.times) - 1)

    def permanent_state(self) -> PermanentState | None:
        """What bodies keep of what has happened to them; None where they keep nothing."""
        return permanent_state(self.scene, self.state, self.frames)

    def read(self) -> dict[str, np.ndarray]:
        """Readings of all channels now."""
        return self._steps.read()

    def reactions(self) -> np.ndarray:
        """Force [N] ``(N, 3)`` in the world that nodes which are held, or pinned by joints, exert on what holds them:
        what the terms do, weight and inertia, and what those pass on that are embedded in them."""
        return np.asarray(self._steps.now.force[0])

    def contact_forces(self) -> dict[str, np.ndarray]:
        """Force [N] ``(N, 3)`` in the world that each declared contact exerts now on every node of the scene, friction
        included; that on a rigid body is at its nodes. Those of ``scene.bodies[name].nodes`` sum to the force on a
        body."""
        return self._steps.pair_forces()

    def contact_wrenches(self) -> dict[str, np.ndarray]:
        """Force [N] and torque [N m] ``(6,)`` of each declared contact now on the first body that it names, in the
        world and about its origin (:func:`sim_core.contact_wrenches.contact_wrenches`)."""
        return contact_wrenches(self.scene, self.state.x, self.contact_forces())
