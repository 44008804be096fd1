"""A guide: a point of one body on a line through another, for slider joints.

With the point q and the line through g along d, all of them combinations of nodes (sums over the nodes of both bodies),

    E = k/2 |r x d|^2,    r = q - g

|d| = 1 but for the stretch of the body that carries the line, so r x d is how far q is off the line. The line belongs
to nodes, so force and moment of the two bodies on each other sum to zero.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.energies.affine import KAPPA_PA
from sim_core.energies.term import Buffers, Memoryless


class Guide(Memoryless):
    """Term of one slider. ``nodes``: int ``(n,)``; ``apart``, ``along``: weights ``(n,)`` of r and d, each of the sum
    zero; ``size_m``: of the body that is guided. The stiffness [N/m] is that of a cube of this size, 8 kappa size."""

    mirrored = True
    measured_at_rest = False

    def __init__(self, name: str, nodes: np.ndarray, apart: np.ndarray, along: np.ndarray, size_m: float) -> None:
        self.name = name
        self._nodes = np.asarray(nodes, dtype=np.int32)
        self._apart, self._along = apart, along
        self._stiffness = 8.0 * KAPPA_PA * size_m
        self._pairs = np.triu_indices(len(nodes))

    def blocks(self) -> np.ndarray:
        i, j = self._pairs
        return np.column_stack([self._nodes[i], self._nodes[j]])

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._buffers = buffers
        i, j = self._pairs
        row, column = np.divmod(np.arange(9), 3)
        self._kept = (i != j)[:, None] | (row <= column)
        self._slots = slots[self._kept]

    def _measure(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """r [m], d and r x d [m]."""
        x = self._buffers.x[self._nodes]
        r, d = self._apart @ x, self._along @ x
        return r, d, np.cross(r, d)

    def add_energy(self) -> None:
        off = self._measure()[2]
        self._buffers.energy[0] += 0.5 * self._stiffness * float(off @ off)

    def add_gradient(self) -> None:
        r, d, off = self._measure()
        by_r, by_d = self._stiffness * np.cross(d, off), self._stiffness * np.cross(off, r)
        np.add.at(self._buffers.gradient, self._nodes, np.outer(self._apart, by_r) + np.outer(self._along, by_d))

    def add_hessian(self, exact: bool) -> None:
        r, d, off = self._measure()
        i, j = self._pairs
        slopes = self._along[:, None, None] * _cross(r) - self._apart[:, None, None] * _cross(d)
        h = np.einsum("kai,kaj->kij", slopes[i], slopes[j])
        if exact:
            twist = self._along[i] * self._apart[j] - self._apart[i] * self._along[j]
            h += twist[:, None, None] * _cross(off)
        np.add.at(self._buffers.hessian, self._slots, self._stiffness * h.reshape(-1, 9)[self._kept])

    def configure(self, parameters: Mapping[str, float]) -> None:
        del parameters


def _cross(v: np.ndarray) -> np.ndarray:
    """The matrix of v x."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
