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
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sim_core.energies.linearised import Linearised
from sim_core.energies.term import Buffers, Internals, Memoryless, Quantity, StepContext


@dataclass(frozen=True)
class MassDampingAlong:
    """Work ``along`` nodal vectors of M v', and what is ``beside`` it of the elements' own alpha, per density."""

    along: float
    beside: float
    alpha: float
    density: float

    def work(self) -> np.ndarray:
        """Work of the forces dE/dx of the whole body."""
        return np.array([self.density * self.by_density()])

    def by(self, quantity: str) -> np.ndarray:
        """Derivative by a number of the whole body."""
        ways = {"mass_damping_per_s": self.by_mass_damping, "density": self.by_density}
        return np.array([ways[quantity]()])

    def by_mass_damping(self) -> float:
        """Derivative of the work of the forces by alpha."""
        return self.density * self.along

    def by_density(self) -> float:
        """Derivative of the work of the forces by the density."""
        return self.alpha * self.along + self.beside


class MassDamping(Memoryless):
    """Term of one body. ``unit_mass``: csr over its nodes, per unit of density; ``offset``: index of the first of them
    among all nodes; ``loose``: bool, those that nothing holds. Parameters: ``mass_damping_per_s`` alpha [1/s] and
    ``density`` in the unit that goes with the mass."""

    mirrored = True
    measured_at_rest = False
    quantities: tuple[Quantity, ...] = (Quantity("mass_damping_per_s", "1/s"), Quantity("density", "kg/m^3"))

    def __init__(self, name: str, unit_mass: sp.csr_matrix, offset: int, loose: np.ndarray) -> None:
        self.name = name
        self._keep = sp.diags(loose.astype(float))
        self._nodes = slice(offset, offset + len(loose))
        upper = sp.triu(self._kept(unit_mass)).tocoo()
        self._upper = upper.row, upper.col
        self._alpha = self._density = self._factor = 0.0
        self.set_unit_mass(unit_mass)

    def set_unit_mass(self, unit_mass: sp.csr_matrix, more: sp.csr_matrix | None = None) -> None:
        """Take another mass per unit of density, of the same pattern. ``more``: sum over the elements of their masses
        times what their alpha is above that which is configured [1/s]; None: nothing."""
        plain, beside = self._kept(unit_mass), None if more is None else self._kept(more)
        self._plain = plain, self._upper_of(plain)
        self._beside = None if beside is None else (beside, self._upper_of(beside))
        self._renew()

    def _kept(self, matrix: sp.csr_matrix) -> sp.csr_matrix:
        """What is between nodes that nothing holds."""
        kept = (self._keep @ matrix @ self._keep).tocsr()
        kept.eliminate_zeros()
        return kept

    def _upper_of(self, matrix: sp.csr_matrix) -> np.ndarray:
        """Entries of the upper half."""
        return np.asarray(matrix[self._upper]).ravel() if len(self._upper[0]) else np.zeros(0)

    def _renew(self) -> None:
        """Bring the matrix, its upper half and the strength up to date."""
        if self._beside is None:
            (self._matrix, self._upper_values), self._strength = self._plain, self._density * self._alpha
        else:
            both = zip(self._plain, self._beside, strict=True)
            self._matrix, self._upper_values = (self._alpha * a + b for a, b in both)
            self._strength = self._density
        self._factor = 0.0

    @property
    def matrix(self) -> sp.csr_matrix:
        """What damps, alpha M, between the nodes of the body [kg/s] ``(k, k)``."""
        return self._strength * self._matrix

    def matrix_by(self, quantity: str) -> sp.csr_matrix:
        """Derivative of :attr:`matrix` by ``mass_damping_per_s`` or ``density``."""
        (mass, _), more = self._plain, self._beside
        if quantity == "mass_damping_per_s":
            return self._density * mass
        return self._alpha * mass if more is None else self._alpha * mass + more[0]

    def blocks(self) -> np.ndarray:
        return np.column_stack(self._upper) + self._nodes.start

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._buffers, self._diagonal = buffers, slots[:, [0, 4, 8]]
        self._base = np.zeros_like(buffers.x)

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._alpha, self._density = parameters["mass_damping_per_s"], parameters["density"]
        self._renew()

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del internals
        self._base[:] = step.x_base
        self._factor = self._strength / step.tau

    def _force(self) -> tuple[np.ndarray, np.ndarray]:
        """Motion since the base [m], and force [N], of the body's nodes ``(k, 3)``."""
        move = self._buffers.x[self._nodes] - self._base[self._nodes]
        return move, self._factor * (self._matrix @ move)

    def force_by(self, quantity: str, step: StepContext) -> np.ndarray:
        """Derivative of dE/dx ``(n, 3)`` at the end of a step by ``mass_damping_per_s`` or ``density``."""
        out = np.zeros_like(self._buffers.x)
        speed = (self._buffers.x[self._nodes] - step.x_base[self._nodes]) / step.tau
        out[self._nodes] = self.matrix_by(quantity) @ speed
        return out

    def along(self, vectors: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals) -> MassDampingAlong:
        """What forces along nodal ``vectors`` ``(n, 3)`` know of the damping's numbers at the end of a step."""
        del kept, internals
        (mass, _), more, moved = self._plain, self._beside, vectors[self._nodes]
        speed = (self._buffers.x[self._nodes] - step.x_base[self._nodes]) / step.tau
        beside = 0.0 if more is None else float(np.vdot(more[0] @ speed, moved))
        return MassDampingAlong(float(np.vdot(mass @ speed, moved)), beside, self._alpha, self._density)

    def add_energy(self) -> None:
        if self._factor > 0.0:
            move, force = self._force()
            self._buffers.energy[0] += 0.5 * float(np.vdot(move, force))

    def add_gradient(self) -> None:
        if self._factor > 0.0:
            self._buffers.gradient[self._nodes] += self._force()[1]

    def add_hessian(self, exact: bool) -> None:
        del exact
        if self._factor > 0.0:
            np.add.at(self._buffers.hessian, self._diagonal, self._factor * self._upper_values[:, None])

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised | None:
        """Derivatives by the positions that the velocity is measured from."""
        del internals, after
        if self._factor == 0.0:
            return None
        entries = self._matrix.tocoo()
        axes = np.arange(3)[:, None]
        rows, columns = ((3 * (self._nodes.start + index) + axes).ravel() for index in (entries.row, entries.col))
        values = np.tile(-self._factor * entries.data, 3)
        now, before = step.weights
        matrix = sp.csr_matrix((values, (rows, columns)), shape=(self._base.size,) * 2)
        return Linearised(force_start=now * matrix, force_past=None if step.x_past is None else before * matrix)
