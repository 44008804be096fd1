"""Dead loads: forces that stay what they are, however the body moves.

    E = -s(t') f . sum_k w_k x_k

with the load f, weights w_k of the nodes (they sum to one for a force [N], to an area for a traction [Pa]), and the
value s of a time table at the end t' of the step. Its Hessian is zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.energies.term import Buffers, Internals, Memoryless, StepContext


class Schedule:
    """Values over time: linear between ``times`` [s], which increase, and held beyond them; 1 without any."""

    def __init__(self, times: np.ndarray, values: np.ndarray) -> None:
        self._times, self._values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)

    def at_end_of(self, step: StepContext) -> float:
        """The value at the end of a step."""
        if not len(self._times):
            return 1.0
        return float(np.interp(step.time + step.dt, self._times, self._values))


class DeadLoad(Memoryless):
    """Term of one load. ``nodes``: int ``(k,)``; ``weights``: ``(k,)`` [-] or [m^2]. Parameters: ``x``, ``y``, ``z`` of
    the load in the world, [N] or [Pa]."""

    mirrored = False
    measured_at_rest = False

    def __init__(self, name: str, nodes: np.ndarray, weights: np.ndarray, schedule: Schedule) -> None:
        self.name = name
        self._nodes, self._weights, self._schedule = nodes, weights, schedule
        self._load, self._now = np.zeros(3), 0.0

    def blocks(self) -> np.ndarray:
        return np.empty((0, 2), dtype=int)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        del slots
        self._buffers = buffers

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._load = np.array([parameters[axis] for axis in "xyz"])

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del internals
        self._now = self._schedule.at_end_of(step)

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> None:
        """Nothing: of the step it knows the time alone."""
        del step, internals, after

    def add_energy(self) -> None:
        resultant = self._weights @ self._buffers.x[self._nodes]
        self._buffers.energy[0] -= self._now * float(self._load @ resultant)

    def add_gradient(self) -> None:
        self._buffers.gradient[self._nodes] -= np.outer(self._now * self._weights, self._load)

    def add_hessian(self, exact: bool) -> None:
        del exact
