"""A rollout of a task that is made step by step, and what ends it early."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.commands import CommandChain
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation
from sim_core.tasks.measure import FORCE, Measure, Seen
from sim_core.tasks.schema import Stop

MOST_HALVINGS = 12
"""Steps that do not converge at once and are halved, in one rollout: what goes on so is violent, and slow."""


class EarlyStop(Exception):
    """A rollout ends before its time."""


class Watch:
    """Ends a rollout that does not count. ``steps``: so many were made; ``force_n``: largest force on a finger [N]."""

    def __init__(self, stop: Stop, fingers: Sequence[str], times: np.ndarray, touching: range) -> None:
        self._stop, self._fingers, self._times, self._touching = stop, fingers, times, touching
        self.steps, self.force_n = 0, 0.0

    def __call__(self, step: int, reading: Mapping[str, np.ndarray], halvings: int) -> None:
        self.steps = step
        now = max(float(np.linalg.norm(reading[f"{FORCE}{f}"][:3])) for f in self._fingers)
        self.force_n = max(self.force_n, now)
        at = f"at {self._times[step]:.3f} s"
        if not np.isfinite(now):
            raise EarlyStop(f"a force is not finite {at}")
        if now > self._stop.most_force_n:
            raise EarlyStop(f"a finger bears {now:.3g} N {at}, more than {self._stop.most_force_n:g}")
        if step in self._touching and now < self._stop.least_force_n:
            raise EarlyStop(f"no finger bears {self._stop.least_force_n:g} N {at}")
        if halvings > MOST_HALVINGS:
            raise EarlyStop(f"more than {MOST_HALVINGS} steps were halved {at}")


class Episode:
    """One rollout after another in one scene. ``watch``: of the present one; ``at``: number of the time at which it is;
    ``readings``: at all times so far."""

    def __init__(self, simulation: Simulation, times: np.ndarray) -> None:
        self.simulation, self._times = simulation, times
        self._commands = CommandChain(simulation.scene.rig)
        self.at = 0
        self.readings: list[dict[str, np.ndarray]] = []

    def begin(self, poses: Mapping[str, PoseTrajectory], watch: Watch) -> None:
        """Back to rest, where the poses begin."""
        self.watch = watch
        self.simulation.reset(self._commands.begin(self._frames(poses, 0)))
        self.at, self.readings = 0, [self.simulation.read()]

    def advance(self, poses: Mapping[str, PoseTrajectory], to: int) -> None:
        """On to the time number ``to``, along poses at all times. Raises ``ConvergenceError``, :class:`EarlyStop`."""
        for k in range(self.at + 1, to + 1):
            dt = float(self._times[k] - self._times[k - 1])
            self.simulation.step(self._commands.advance(self._frames(poses, k), dt), dt)
            self.at = k
            self.readings.append(self.simulation.read())
            self.watch(k, self.readings[-1], self.simulation.halvings)

    @staticmethod
    def _frames(poses: Mapping[str, PoseTrajectory], k: int) -> dict[str, Frame]:
        return {name: frame_of(p.positions[k], p.quaternions[k]) for name, p in poses.items()}

    def outputs(self) -> dict[str, np.ndarray]:
        """Readings of all channels so far, ``(n, ...)``."""
        return {channel: np.stack([r[channel] for r in self.readings]) for channel in self.readings[0]}

    def seen(self, measure: Measure) -> Seen:
        """What the reward is made of, as far as the rollout has come."""
        return measure.seen(self._times[: self.at + 1], self.outputs(), self.simulation.state.internals)
