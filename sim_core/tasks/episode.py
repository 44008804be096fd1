"""A rollout of a task that is made step by step, and what ends it early."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from sim_core.commands import CommandChain
from sim_core.rigs.limits import HandLimits
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame
from sim_core.sensing.observe import frame_of
from sim_core.simulate import Simulation
from sim_core.tasks.measure import FORCE, Measure, Seen
from sim_core.tasks.schema import Stop

MOST_HALVINGS = 12
"""Steps that do not converge at once and are halved, in one rollout: what goes on so is violent, and slow."""


def frames_at(poses: Mapping[str, PoseTrajectory], k: int) -> dict[str, Frame]:
    """Frames of end effectors at one of the samples of their poses."""
    return {name: frame_of(p.positions[k], p.quaternions[k]) for name, p in poses.items()}


class EarlyStop(Exception):
    """A rollout ends before its time."""


class Watch:
    """Ends a rollout that does not count. ``limits`` of fingers; ``touching``: steps in which one of them has to bear
    something; ``middle``: of observed points [m] ``(3,)``, by their name and the readings; ``tops``: corners of the box
    around each rigid body that they have to stay over ``(2, 3)`` [m]. ``steps``: so many were made; ``force_n``:
    largest force on a finger [N]."""

    def __init__(
        self,
        stop: Stop,
        limits: Mapping[str, HandLimits],
        times: np.ndarray,
        touching: range,
        middle: Callable[[str, Mapping[str, np.ndarray]], np.ndarray],
        tops: Mapping[str, np.ndarray],
    ) -> None:
        self._stop, self._limits, self._times, self._touching = stop, limits, times, touching
        self._middle, self._tops = middle, tops
        self.steps, self.force_n = 0, 0.0

    def __call__(self, step: int, reading: Mapping[str, np.ndarray], halvings: int) -> None:
        self.steps = step
        at, forces = f"at {self._times[step]:.3f} s", [0.0]
        for finger, limit in self._limits.items():
            wrench = reading[f"{FORCE}{finger}"]
            force, torque = float(np.linalg.norm(wrench[:3])), float(np.linalg.norm(wrench[3:]))
            if not np.isfinite(force + torque):
                raise EarlyStop(f"a force is not finite {at}")
            most = min(self._stop.most_force_n, limit.max_force_n)
            forces.append(force)
            self.force_n = max(self.force_n, force)
            if force > most:
                raise EarlyStop(f"a finger bears {force:.3g} N {at}, more than {most:g}")
            if torque > limit.max_torque_nm:
                raise EarlyStop(f"a finger bears {torque:.3g} N m {at}, more than {limit.max_torque_nm:g}")
        now = max(forces)
        if step in self._touching and now < self._stop.least_force_n:
            raise EarlyStop(f"no finger bears {self._stop.least_force_n:g} N {at}")
        for name, body in self._stop.over.items():
            middle, (low, high) = self._middle(name, reading), self._tops[body]
            if (middle[:2] < low[:2]).any() or (middle[:2] > high[:2]).any() or middle[2] < high[2]:
                raise EarlyStop(f"{name} leaves {body} {at}")
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
        """Back to the start, where the poses begin."""
        self.watch = watch
        self.simulation.reset(self._commands.begin(frames_at(poses, 0)))
        self.at, self.readings = 0, [self.simulation.read()]

    def advance(self, poses: Mapping[str, PoseTrajectory], to: int, look: Callable[[int], None]) -> None:
        """On to the time number ``to``, along poses at all times, with a ``look`` after each step. Raises
        ``ConvergenceError``, :class:`EarlyStop`."""
        for k in range(self.at + 1, to + 1):
            dt = float(self._times[k] - self._times[k - 1])
            self.simulation.step(self._commands.advance(frames_at(poses, k), dt), dt)
            self.at = k
            self.readings.append(self.simulation.read())
            self.watch(k, self.readings[-1], self.simulation.halvings)
            look(k)

    def outputs(self, every: int = 1) -> dict[str, np.ndarray]:
        """Readings of all channels so far, at every so manieth time, ``(n, ...)``."""
        return {channel: np.stack([r[channel] for r in self.readings[::every]]) for channel in self.readings[0]}

    def seen(self, measure: Measure, every: int = 1) -> Seen:
        """What the reward is made of, as far as the rollout has come."""
        return measure.seen(self._times[: self.at + 1 : every], self.outputs(every), self.simulation.state.internals)
