"""A mechanical system: nodes, masses, what is prescribed, and the terms of its incremental potential.

All nodes of all bodies are in one array. Components that are prescribed (clamps, driven bodies) are not unknowns, the
others are numbered; nodes that give way together share three unknowns, and embedded nodes
(:mod:`sim_core.solve.embedding`) have none of their own. The compiled core makes its steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from sim_core.energies.term import Internals, Term
from sim_core.solve.embedding import Embedding
from sim_core.solve.unknowns import Compliant, Unknowns


class System:
    """``nodes``: rest positions [m] ``(n, 3)``. ``mass``: csr ``(n, n)`` [kg]. ``prescribed``: bool ``(n, 3)``.
    ``gravity``: [m/s^2] ``(3,)``. ``inertia``: False makes every step a static equilibrium. ``compliant``: groups of
    prescribed nodes that give way together. ``second_order``: steps look back on the one before
    (:mod:`sim_core.solve.integrator`). ``embedding``: nodes that move with others; not prescribed."""

    def __init__(
        self,
        nodes: np.ndarray,
        mass: sp.csr_matrix,
        prescribed: np.ndarray,
        terms: Sequence[Term],
        gravity: np.ndarray,
        inertia: bool = True,
        compliant: Sequence[Compliant] = (),
        second_order: bool = False,
        embedding: Embedding | None = None,
    ) -> None:
        self.nodes = np.ascontiguousarray(nodes, dtype=float)
        self.mass = mass.tocsr()
        self.prescribed = prescribed
        self.terms = list(terms)
        self.gravity = np.asarray(gravity, dtype=float)
        self.inertia = inertia
        self.second_order = second_order
        self.embedding = embedding
        self.compliant = list(compliant)
        self.on_core: Any = None
        """Its steps on the compiled core (:mod:`sim_core.core.system`), once one was asked for."""
        self._unknowns = Unknowns(prescribed, compliant, embedding)
        self.loads: np.ndarray = np.zeros_like(self.nodes)
        """Dead nodal loads [N], ``(n, 3)``, on top of gravity."""

    @property
    def n_unknowns(self) -> int:
        """Free components, and three of each group that gives way."""
        return self._unknowns.count

    @property
    def springs(self) -> np.ndarray:
        """Stiffness of the compliant groups along the axes [N/m], ``(n_groups, 3)``."""
        return self._unknowns.spring.reshape(-1, 3)

    def embed(self, x: np.ndarray) -> None:
        """Write positions or motions ``(n, 3)`` of embedded nodes from those of the others, in place."""
        if self.embedding is not None:
            self.embedding.fill(x)

    def fold(self, gradient: np.ndarray) -> np.ndarray:
        """A nodal gradient ``(n, 3)`` with that of embedded nodes carried to those that they are embedded in."""
        return gradient if self.embedding is None else self.embedding.fold(gradient)

    @property
    def spread_matrix(self) -> sp.csr_matrix:
        """Changes of all components of nodes for changes of the unknowns ``(3 n, n_unknowns)``."""
        return self._unknowns.matrix()

    def reduced_mass(self) -> sp.csr_matrix:
        """Mass matrix over the unknowns [kg]."""
        spread = self.spread_matrix
        return (spread.T @ sp.kron(self.mass, sp.identity(3)) @ spread).tocsr()

    def set_mass(self, mass: sp.csr_matrix) -> None:
        """Replace the mass matrix [kg]."""
        self.mass = mass.tocsr()

    def set_compliance(self, compliance_m_per_n: Sequence[np.ndarray]) -> None:
        """Change the compliances of the compliant groups, in their order [m/N]."""
        self._unknowns.set_compliance(compliance_m_per_n)

    def initial_internals(self) -> dict[str, Internals]:
        """What the terms remember at first, by their names."""
        return {term.name: term.initial_internals() for term in self.terms}
