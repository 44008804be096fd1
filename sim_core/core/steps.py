"""A scene that is stepped from Python on the compiled core, one step a call."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sim_core.core.mounts import mount_row
from sim_core.core.rollout import Chunk, CoreRollout
from sim_core.core.state import KeptState
from sim_core.permanent_state import PermanentState
from sim_core.scene.offset import with_offsets
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.instants import Instants, read_all
from sim_core.solve.report import NewtonSettings, StepReport
from sim_core.solve.step import State


class CoreSteps(CoreRollout):
    """A rollout whose next instant is given with each step. ``mounts``: where they are now, offsets of end effectors
    against their poses included. What a step needs is in the core's memory; the rest is worked out when it is asked
    for."""

    def __init__(
        self,
        scene: Scene,
        settings: NewtonSettings,
        frames: Mapping[str, Frame],
        left: PermanentState | None,
        balanced: bool,
        begin: State | None = None,
    ) -> None:
        super().__init__(scene, {}, np.zeros(1), settings)
        self.mounts = with_offsets(scene.rig, {**scene.start, **frames})
        self.places = mount_row(self.mounts)[None]
        self._take(self.settle(left=left, balanced=balanced) if begin is None else self.begin(begin))
        self._state: State | None = None

    def _make(self) -> None:
        super()._make()
        self.keep_forces()

    @property
    def t(self) -> float:
        """Time since the start [s]."""
        return float(self.times[-1])

    def _take(self, chunk: Chunk) -> None:
        self.now: Instants = chunk.at
        self.press(chunk)

    def frames(self, k: int) -> dict[str, Frame]:
        """True frames of the mounts at an instant; at the last one those that were given."""
        return dict(self.mounts) if k == len(self.times) - 1 else super().frames(k)

    def advance(self, frames: Mapping[str, Frame], dt: float) -> StepReport:
        """A step of ``dt`` [s] in which mounts go to ``frames``, as commanded, and the others stay. Where it fails the
        state is that before."""
        before = self.kept()
        self.mounts = {**self.mounts, **with_offsets(self.scene.rig, frames)}
        self.places = np.stack([self.places[-1], mount_row(self.mounts)])
        self.times = np.array([self.t, self.t + dt])
        self.counts, self.reports = self.counts[:0], []
        try:
            for chunk in self.run():
                self._take(chunk)
        except Exception:
            self.go_back(before)
            raise
        self._state = None
        return self.reports[-1]

    def kept(self) -> tuple[Any, ...]:
        """The present, to go back to by :meth:`go_back`, as often as wanted."""
        return KeptState(self), self.mounts, self.places, self.times, self._state, self._seen, self.now

    def go_back(self, before: tuple[Any, ...]) -> None:
        """Be where this was kept: what follows is the same bit for bit."""
        kept, self.mounts, self.places, self.times, self._state, self._seen, self.now = before
        kept.put_back()

    def read(self) -> dict[str, np.ndarray]:
        """Readings of all channels now."""
        return {channel: value[0] for channel, value in read_all(self.observer, self.scene.rig, self.now).items()}

    def put(self, state: State) -> None:
        """Be in a state with the time, the past and the pairs in contact of the present one."""
        self.put_state(state)
        self._state = None

    @property
    def state(self) -> State:
        """The state now, as :mod:`sim_core.solve` has it."""
        if self._state is None:
            self._state = self.state_now(self.t - self.began)
        return self._state
