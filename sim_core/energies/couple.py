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

from sim_core.energies.term import Buffers, Internals, Memoryless, StepContext


class Couple(Memoryless):
    """Term of one couple. ``lines``: int ``(k, 2)``, nodes a and b of each line; ``axis``: unit vector;
    ``shares``: part of the moment on each line ``(k,)``. Parameter: ``moment_nm`` [N m]."""

    mirrored = False
    measured_at_rest = False

    def __init__(self, name: str, lines: np.ndarray, axis: np.ndarray, shares: np.ndarray) -> None:
        self.name = name
        self._a, self._b = np.asarray(lines).T
        self._axis = np.asarray(axis, dtype=float)
        self._cross = np.cross(self._axis, np.eye(3)).T  # axis x d = cross @ d
        self._shares = np.asarray(shares, dtype=float)
        self._moment = 0.0

    def blocks(self) -> np.ndarray:
        pairs = ((self._a, self._a), (self._a, self._b), (self._b, self._a), (self._b, self._b))
        return np.stack([np.column_stack(pair) for pair in pairs], axis=1).reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._buffers, self._slots = buffers, slots
        self._start = self._lines(buffers.x)

    def _lines(self, x: np.ndarray) -> np.ndarray:
        d = x[self._b] - x[self._a]
        return np.asarray(d - np.outer(d @ self._axis, self._axis))

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._moment = parameters["moment_nm"]

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del internals
        self._start = self._lines(step.x_start)

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> None:
        """Nothing: where turns are counted from is a constant of the energy."""
        del step, internals, after

    def add_energy(self) -> None:
        """Turns are counted from the start of the step, so that a line may turn on and on; where they are counted from
        is a constant of the step, and neither force nor stiffness depends on it: there is nothing to linearise."""
        d = self._lines(self._buffers.x)
        sine = np.einsum("kj,kj->k", self._start @ self._cross.T, d)
        cosine = np.einsum("kj,kj->k", self._start, d)
        self._buffers.energy[0] -= self._moment * float(self._shares @ np.arctan2(sine, cosine))

    def add_gradient(self) -> None:
        d = self._lines(self._buffers.x)
        force = (self._moment * self._shares / np.einsum("kj,kj->k", d, d))[:, None] * (d @ self._cross.T)
        np.add.at(self._buffers.gradient, self._b, -force)
        np.add.at(self._buffers.gradient, self._a, force)

    def add_hessian(self, exact: bool) -> None:
        """d2phi/dd2 = -(d (axis x d)^T + (axis x d) d^T) / |d|^4, one positive and one negative value: none of it
        unless ``exact``."""
        if not exact:
            return
        d = self._lines(self._buffers.x)
        across = d @ self._cross.T
        second = np.einsum("ki,kj->kij", d, across)
        second = (second + second.transpose(0, 2, 1)) / (np.einsum("kj,kj->k", d, d) ** 2)[:, None, None]
        block = (self._moment * self._shares)[:, None, None] * second
        values = np.stack([block, -block, -block, block], axis=1).reshape(-1, 9)
        np.add.at(self._buffers.hessian, self._slots, values)
