"""Dead loads: forces that stay what they are, however the body moves.

    E = -s(t') f . sum_k w_k x_k

with the load f, weights w_k of the nodes (they sum to one for a force [N], to an area for a traction [Pa]), and the
value s of a time table at the end t' of the step. Its Hessian is zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.energies.term import Memoryless, counted


class Schedule:
    """Values over time: linear between ``times`` [s], which increase, and held beyond them; 1 without any."""

    def __init__(self, times: np.ndarray, values: np.ndarray) -> None:
        self.times, self.values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)


class DeadLoad(Memoryless):
    """Term of one load. ``nodes``: int ``(k,)``; ``weights``: ``(k,)`` [-] or [m^2]. Parameters: ``x``, ``y``, ``z`` of
    the ``load`` in the world, [N] or [Pa]."""

    def __init__(self, name: str, nodes: np.ndarray, weights: np.ndarray, schedule: Schedule) -> None:
        self.name = name
        self.nodes, self.weights, self.schedule = nodes, weights, schedule
        self.load = np.zeros(3)

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        self.load = np.array([parameters[axis] for axis in "xyz"])

    def load_by(self, quantity: str) -> np.ndarray:
        """Derivative of the load by a parameter ``(3,)``."""
        return np.array([float(axis == quantity) for axis in "xyz"])
