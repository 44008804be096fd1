"""Damping by mass (the first half of Rayleigh damping): a force against the motion of a body in the world.

    E = alpha / (2 tau) (x' - x_b)^T M (x' - x_b),    force -alpha M v',    v' = (x' - x_b) / tau

x_b and tau are those of the integrator (:mod:`sim_core.solve.integrator`), so the force is that of the velocity at
the end of the step. M is the mass between nodes that nothing holds; those that a mount carries feel nothing. Momentum
falls like exp(-alpha t), also that of a body in free flight; a vibration of the angular frequency w is damped by the
ratio alpha / (2 w). Rayleigh, The Theory of Sound, 2nd ed., sec. 81. Where alpha differs from element to element, the
sum over elements of alpha_e M_e is in place of alpha M.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from sim_core.energies.term import Memoryless, Quantity, counted


class MassDamping(Memoryless):
    """Term of one body. ``unit_mass``: csr over its nodes, per unit of density; ``offset``: index of the first of them
    among all nodes; ``loose``: bool, those that nothing holds. Parameters: ``mass_damping_per_s`` alpha [1/s] and
    ``density`` in the unit that goes with the mass."""

    quantities: tuple[Quantity, ...] = (Quantity("mass_damping_per_s", "1/s"), Quantity("density", "kg/m^3"))

    def __init__(self, name: str, unit_mass: sp.csr_matrix, offset: int, loose: np.ndarray) -> None:
        self.name = name
        self._keep = sp.diags(loose.astype(float))
        self._nodes = slice(offset, offset + len(loose))
        self._alpha = self._density = 0.0
        self.set_unit_mass(unit_mass)

    def set_unit_mass(self, unit_mass: sp.csr_matrix, more: sp.csr_matrix | None = None) -> None:
        """Take another mass per unit of density, of the same pattern. ``more``: sum over the elements of their masses
        times what their alpha is above that which is configured [1/s]; None: nothing."""
        self._plain, self._more = self._kept(unit_mass), None if more is None else self._kept(more)

    def _kept(self, matrix: sp.csr_matrix) -> sp.csr_matrix:
        """What is between nodes that nothing holds."""
        kept = (self._keep @ matrix @ self._keep).tocsr()
        kept.eliminate_zeros()
        return kept

    @property
    def nodes(self) -> np.ndarray:
        """Nodes of the body among all ``(k,)``."""
        return np.arange(self._nodes.start, self._nodes.stop)

    @property
    def matrix(self) -> sp.csr_matrix:
        """What damps, alpha M, between the nodes of the body [kg/s] ``(k, k)``."""
        return self._density * self._per_density()

    def matrix_by(self, quantity: str) -> sp.csr_matrix:
        """Derivative of :attr:`matrix` by ``mass_damping_per_s`` or ``density``."""
        return self._density * self._plain if quantity == "mass_damping_per_s" else self._per_density()

    def _per_density(self) -> sp.csr_matrix:
        """alpha M over the density."""
        damped = self._alpha * self._plain
        return damped if self._more is None else damped + self._more

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        self._alpha, self._density = parameters["mass_damping_per_s"], parameters["density"]
