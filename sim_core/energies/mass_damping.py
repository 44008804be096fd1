"""Damping by mass (the first half of Rayleigh damping): a force against the motion of a body in the world.

    E = alpha / (2 tau) (x' - x_b)^T M (x' - x_b),    force -alpha M v',    v' = (x' - x_b) / tau

x_b and tau are those of the integrator (:mod:`sim_core.solve.integrator`), so the force is that of the velocity at
the end of the step. M is the mass between nodes that nothing holds; those that a mount carries feel nothing. Momentum
falls like exp(-alpha t), also that of a body in free flight; a vibration of the angular frequency w is damped by the
ratio alpha / (2 w). Rayleigh, The Theory of Sound, 2nd ed., sec. 81.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from sim_core.energies.linearised import Linearised
from sim_core.energies.term import Buffers, Internals, Memoryless, StepContext


class MassDamping(Memoryless):
    """Term of one body. ``unit_mass``: csr over its nodes, per unit of density; ``offset``: index of the first of them
    among all nodes; ``loose``: bool, those that nothing holds. Parameters: ``mass_damping_per_s`` alpha [1/s] and
    ``density`` in the unit that goes with the mass."""

    mirrored = True

    def __init__(self, name: str, unit_mass: sp.csr_matrix, offset: int, loose: np.ndarray) -> None:
        self.name = name
        self._keep = sp.diags(loose.astype(float))
        self._nodes = slice(offset, offset + len(loose))
        self.set_unit_mass(unit_mass)
        self._strength = self._factor = 0.0

    def set_unit_mass(self, unit_mass: sp.csr_matrix) -> None:
        """Take another mass per unit of density, of the same pattern."""
        self._matrix = (self._keep @ unit_mass @ self._keep).tocsr()
        self._matrix.eliminate_zeros()
        upper = sp.triu(self._matrix).tocoo()
        self._pairs = np.column_stack([upper.row, upper.col]) + self._nodes.start
        self._upper = upper.data

    def blocks(self) -> np.ndarray:
        return self._pairs

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._buffers, self._diagonal = buffers, slots[:, [0, 4, 8]]
        self._base = np.zeros_like(buffers.x)

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._strength = parameters["mass_damping_per_s"] * parameters["density"]
        self._factor = 0.0

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del internals
        self._base[:] = step.x_base
        self._factor = self._strength / step.tau

    def _force(self) -> tuple[np.ndarray, np.ndarray]:
        """Motion since the base [m], and force [N], of the body's nodes ``(k, 3)``."""
        move = self._buffers.x[self._nodes] - self._base[self._nodes]
        return move, self._factor * (self._matrix @ move)

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
            np.add.at(self._buffers.hessian, self._diagonal, self._factor * self._upper[:, None])

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
