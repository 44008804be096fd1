"""Which components of the nodes are unknown, and what moves with each unknown.

Components that are free are numbered first. Prescribed components of nodes that give way together share one deflection
along each axis, numbered after them. Embedded nodes (:mod:`sim_core.solve.embedding`) have no unknowns of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sim_core.solve.embedding import Embedding


@dataclass(frozen=True)
class Compliant:
    """Prescribed components of nodes that give way together by a translation. ``nodes``: ``(k,)``;
    ``compliance_m_per_n``: along the world axes ``(3,)``, all positive."""

    nodes: np.ndarray
    compliance_m_per_n: np.ndarray


class Unknowns:
    """``prescribed``: bool ``(n, 3)``; ``compliant``: groups that give way; ``embedding``: nodes that move with others.

    ``spring``: stiffness of the groups along the axes [N/m] ``(3 n_groups,)``.
    """

    def __init__(self, prescribed: np.ndarray, compliant: Sequence[Compliant], embedding: Embedding | None) -> None:
        self._embedding = embedding
        free = ~prescribed
        if embedding is not None:
            free[embedding.nodes] = False
        own = np.flatnonzero(free.ravel())
        self._number = np.full(prescribed.size, -1)
        self._number[own] = np.arange(len(own))
        for k, group in enumerate(compliant):
            for axis in range(3):
                held = group.nodes[prescribed[group.nodes, axis]]
                self._number[3 * held + axis] = len(own) + 3 * k + axis
        self._moved = np.flatnonzero(self._number >= 0)
        self.count = len(own) + 3 * len(compliant)
        self._groups = len(compliant)
        self.set_compliance([group.compliance_m_per_n for group in compliant])

    def set_compliance(self, compliance_m_per_n: Sequence[np.ndarray]) -> None:
        """Compliances of the groups, in their order [m/N]."""
        if len(compliance_m_per_n) != self._groups:
            raise ValueError("one compliance a group")
        self.spring = np.concatenate([1.0 / c for c in compliance_m_per_n] or [np.empty(0)])

    def matrix(self) -> sp.csr_matrix:
        """Changes of all components for changes of the unknowns ``(3 n, count)``."""
        size = len(self._number)
        moved = (np.ones(len(self._moved)), (self._moved, self._number[self._moved]))
        own = sp.csr_matrix(moved, shape=(size, self.count))
        if self._embedding is None:
            return own
        return sp.csr_matrix(sp.kron(self._embedding.matrix(), sp.identity(3)) @ own)
