"""A couple that follows the body: the moment M about a fixed axis on short lines of nodes.

    E = -M sum_k w_k phi_k,    dphi/db = -dphi/da = (axis x d) / |d|^2

phi_k is the angle about ``axis`` by which the line from node a to node b has turned, d its projection on the
plane normal to the axis, and sum_k w_k = 1. The forces on the two nodes are opposite, normal to the line and
turn with it; the work of the couple is M times the turn, however far (also beyond a full circle), so in plane
motion this is the end moment of a beam, and it derives from a potential. Choose lines normal to the axis: one that
is askew also twists the body.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.energies.term import Memoryless, counted


class Couple(Memoryless):
    """Term of one couple. ``lines``: int ``(k, 2)``, nodes a and b of each line; ``axis``: unit vector;
    ``shares``: part of the moment on each line ``(k,)``. Parameter: ``moment_nm`` [N m]."""

    def __init__(self, name: str, lines: np.ndarray, axis: np.ndarray, shares: np.ndarray) -> None:
        self.name = name
        self._a, self._b = np.asarray(lines).T
        self._axis = np.asarray(axis, dtype=float)
        self._shares = np.asarray(shares, dtype=float)
        self._moment = 0.0

    @property
    def lines(self) -> np.ndarray:
        """Nodes of the lines, int ``(k, 2)``."""
        return np.column_stack([self._a, self._b])

    @property
    def axis(self) -> np.ndarray:
        """Axis of the couple, a unit vector ``(3,)``."""
        return self._axis

    @property
    def moments(self) -> np.ndarray:
        """Moments on the lines [N m] ``(k,)``."""
        return self._moment * self._shares

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        self._moment = parameters["moment_nm"]
