"""Which components of the nodes are unknown, and what moves with each unknown.

Components that are free are numbered first. Prescribed components of nodes that give way together share one deflection
along each axis, numbered after them. Embedded nodes (:mod:`sim_core.solve.embedding`) have no unknowns of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.solve.embedding import Embedding


@dataclass(frozen=True)
class Compliant:
    """Prescribed components of nodes that give way together by a translation. ``nodes``: ``(k,)``;
    ``compliance_m_per_n``: along the world axes ``(3,)``, all positive."""

    nodes: np.ndarray
    compliance_m_per_n: np.ndarray


class Unknowns:
    """``prescribed``: bool ``(n, 3)``; ``compliant``: groups that give way; ``embedding``: nodes that move with others.

    ``number``: unknown of each component, int ``(3 n,)``, -1 where none; ``deflection``: how far the groups have given
    way [m] ``(3 n_groups,)``; ``spring``: the stiffness against it [N/m].
    """

    def __init__(self, prescribed: np.ndarray, compliant: Sequence[Compliant], embedding: Embedding | None) -> None:
        self._embedding = embedding
        free = ~prescribed
        if embedding is not None:
            free[embedding.nodes] = False
        self._own = np.flatnonzero(free.ravel())
        self.number = np.full(prescribed.size, -1)
        self.number[self._own] = np.arange(len(self._own))
        for k, group in enumerate(compliant):
            for axis in range(3):
                held = group.nodes[prescribed[group.nodes, axis]]
                self.number[3 * held + axis] = len(self._own) + 3 * k + axis
        self._yielding = np.flatnonzero(self.number >= len(self._own))
        self._yielding_by = self.number[self._yielding] - len(self._own)
        self._moved = np.flatnonzero(self.number >= 0)
        self.deflection = np.zeros(3 * len(compliant))
        self.set_compliance([group.compliance_m_per_n for group in compliant])

    def set_compliance(self, compliance_m_per_n: Sequence[np.ndarray]) -> None:
        """Compliances of the groups, in their order [m/N]."""
        if 3 * len(compliance_m_per_n) != len(self.deflection):
            raise ValueError("one compliance a group")
        self.spring = np.concatenate([1.0 / c for c in compliance_m_per_n] or [np.empty(0)])

    @property
    def count(self) -> int:
        return len(self._own) + len(self.deflection)

    def read(self, x: np.ndarray) -> np.ndarray:
        """Copy of the unknowns where nodes are at ``x`` [m] ``(n, 3)``: free components, then deflections."""
        return np.concatenate([x.reshape(-1)[self._own], self.deflection])

    def write(self, values: np.ndarray, x: np.ndarray) -> None:
        """Take the unknowns, and write the free components into ``x``."""
        x.reshape(-1)[self._own] = values[: len(self._own)]
        if self.deflection.size:
            self.deflection[:] = values[len(self._own) :]

    def give_way(self, targets: np.ndarray, x: np.ndarray) -> None:
        """Write into ``x`` what follows: groups that give way from their ``targets`` [m] ``(n, 3)``, embedded nodes."""
        if self.deflection.size:
            given = targets.reshape(-1)[self._yielding]
            x.reshape(-1)[self._yielding] = given + self.deflection[self._yielding_by]
        self.embed(x)

    def embed(self, x: np.ndarray) -> None:
        """Write positions or motions ``(n, 3)`` of embedded nodes from those of the others, in place."""
        if self._embedding is not None:
            self._embedding.fill(x)

    def fold(self, gradient: np.ndarray) -> np.ndarray:
        """A nodal gradient ``(n, 3)`` with that of embedded nodes carried to those that they are embedded in."""
        return gradient if self._embedding is None else self._embedding.fold(gradient)

    def gather(self, gradient: np.ndarray) -> np.ndarray:
        """Sums of a nodal gradient over what each unknown moves; a new array."""
        flat = self.fold(gradient).reshape(-1)
        if not self.deflection.size:
            return np.asarray(flat[self._own])
        return np.bincount(self.number[self._moved], weights=flat[self._moved], minlength=self.count)

    def spread(self, direction: np.ndarray) -> np.ndarray:
        """Change of all nodes ``(n, 3)`` for a change of the unknowns."""
        out = np.zeros(len(self.number))
        out[self._moved] = direction[self.number[self._moved]]
        moves = out.reshape(-1, 3)
        self.embed(moves)
        return moves

    def pull(self, forces: np.ndarray) -> None:
        """Add the springs' forces [N] to those on the unknowns, in place."""
        forces[len(self._own) :] += self.spring * self.deflection

    def stiffen(self, diagonal: np.ndarray) -> None:
        """Add the springs' stiffness [N/m] to the diagonal over the unknowns, in place."""
        diagonal[len(self._own) :] += self.spring

    def spring_energy(self) -> float:
        """Energy of the springs [J]."""
        return 0.5 * float(self.spring @ self.deflection**2)
