"""Green strains at the quadrature points of a gel as the strain measure of material laws: from nodes, and back.

    E = (F^T F - 1) / 2,    dE[v] = sym(F^T V),    d2E[v, w] = sym(V^T W),    F = dx/dX, V = dv/dX

components 11 22 33 and twice 23 13 12. The stiffness that laws see is that of shear, at small strain,

    D E = 2 mu (E - tr(E) / 3 1)

since what laws add to the pressure point by point would lock near incompressibility
(:mod:`sim_core.energies.neo_hookean_moduli`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from sim_core.energies.grading import Grading
from sim_core.energies.linearised import axes_of, placed
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.neo_hookean_rest import as_tensors
from sim_core.energies.term import Buffers, Quantity

if TYPE_CHECKING:
    from sim_core.energies.strain_law import RestWeights

POINTS, NODES = 4, 10
"""Quadrature points and nodes of an element."""

PAIRS = tuple((a, b) for a in range(NODES) for b in range(a, NODES))
"""Pairs of the nodes of an element, each once."""

SHEAR = np.block([[2.0 * np.eye(3) - 2.0 / 3.0, np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]])
"""D / mu."""

FIRST, SECOND = [0, 1, 2, 1, 0, 0], [0, 1, 2, 2, 2, 1]
"""Axes of the components."""


class SolidStrain:
    """Strains of the gel that a neo-Hookean term is of."""

    components = 6
    quantities: tuple[Quantity, ...] = (Quantity("E_pa", "Pa", power=1), Quantity("nu", "-"))

    def __init__(self, solid: NeoHookean) -> None:
        self._solid = solid
        upper = [[i != j or a <= b for a in range(3) for b in range(3)] for i, j in PAIRS]
        self._kept = np.broadcast_to(np.array(upper), (len(solid.tets), len(PAIRS), 9)).reshape(-1, 9)

    @property
    def areas(self) -> np.ndarray:
        """Volumes of the points [m^3] ``(4 m,)``, times the factors of their stiffness."""
        return self._solid.weights.reshape(-1)

    @property
    def whole_areas(self) -> np.ndarray:
        """Volumes of the points [m^3] ``(4 m,)``."""
        return self._solid.whole_weights.reshape(-1)

    @property
    def stiffness(self) -> np.ndarray:
        return np.asarray(self.at_points(self._solid.shear_moduli)[:, None, None] * SHEAR)

    @property
    def grading(self) -> Grading | None:
        return self._solid.grading

    def stiffness_by(self, quantity: str) -> np.ndarray:
        return np.asarray(self.at_points(self._solid.shear_moduli_by(quantity))[:, None, None] * SHEAR)

    def at_points(self, values: np.ndarray) -> np.ndarray:
        return np.repeat(values, POINTS)

    def of_elements(self, values: np.ndarray) -> np.ndarray:
        return np.asarray(values.reshape(-1, POINTS).sum(axis=1))

    def blocks(self) -> np.ndarray:
        return self._solid.tets[:, np.array(PAIRS)].reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._buffers, self._slots = buffers, slots[self._kept]

    @property
    def here(self) -> np.ndarray:
        return self._buffers.x

    def _deformation(self, x: np.ndarray) -> np.ndarray:
        """F at ``x``, ``(4 m, 3, 3)``."""
        return np.asarray(np.eye(3) + self._solid.displacement_gradients(x))

    def _slope(self, vectors: np.ndarray) -> np.ndarray:
        """V of nodal vectors, ``(4 m, 3, 3)``."""
        there = np.repeat(vectors[self._solid.tets], POINTS, axis=0)
        return np.asarray(there.swapaxes(-1, -2) @ self._solid.gradients)

    def strains(self) -> np.ndarray:
        return self.strains_at(self._buffers.x)

    def strains_at(self, x: np.ndarray) -> np.ndarray:
        h = self._solid.displacement_gradients(x)
        return _components(0.5 * (h + h.swapaxes(-1, -2) + h.swapaxes(-1, -2) @ h))

    def foreseen(self, strains: np.ndarray, move: np.ndarray) -> np.ndarray:
        slope = self._slope(move)
        return np.asarray(strains - _components(0.5 * slope.swapaxes(-1, -2) @ slope))

    def along(self, vectors: np.ndarray) -> np.ndarray:
        return _components(self._deformation(self._buffers.x).swapaxes(-1, -2) @ self._slope(vectors))

    def _blocks_at(self, x: np.ndarray) -> np.ndarray:
        """Derivative of the strains of each point by the nodes of its element, ``(4 m, 6, 30)``."""
        f, g = self._deformation(x), self._solid.gradients
        straight = np.einsum("pik,pak->pkai", f[:, :, FIRST], g[:, :, SECOND])
        crossed = np.einsum("pik,pak->pkai", f[:, :, SECOND], g[:, :, FIRST])
        crossed[:, :3] = 0.0
        return np.asarray((straight + crossed).reshape(len(f), self.components, 3 * NODES))

    def by_positions(self, x: np.ndarray) -> sp.csr_matrix:
        blocks = self._blocks_at(x)
        rows = np.arange(self.components * len(blocks)).reshape(len(blocks), self.components)
        axes = np.repeat(axes_of(self._solid.tets), POINTS, axis=0)
        return placed((blocks, rows, axes), shape=(rows.size, x.size)).tocsr()

    def add_gradient(self, stress: np.ndarray) -> None:
        first_piola = self._deformation(self._buffers.x) @ as_tensors(stress)
        force = self._solid.gradients @ first_piola.swapaxes(-1, -2)
        whole = force.reshape(-1, POINTS, NODES, 3).sum(axis=1)
        np.add.at(self._buffers.gradient, self._solid.tets, whole)

    def add_hessian(self, stress: np.ndarray, tangent: np.ndarray, exact: bool) -> None:
        """Of the stress the tension alone unless ``exact``, as of a membrane."""
        s, count = as_tensors(stress), len(self._solid.tets)
        if not exact:
            values, axes = np.linalg.eigh(s)
            s = (axes * np.maximum(values, 0.0)[:, None]) @ axes.swapaxes(-1, -2)
        slope, g, w = self._blocks_at(self._buffers.x), self._solid.gradients, self.areas[:, None, None]
        whole = (slope.swapaxes(-1, -2) @ (w * tangent) @ slope).reshape(count, POINTS, NODES, 3, NODES, 3).sum(axis=1)
        borne = (w * (g @ s @ g.swapaxes(-1, -2))).reshape(count, POINTS, NODES, NODES).sum(axis=1)
        i, j = np.array(PAIRS).T
        blocks = whole[:, i, :, j, :].swapaxes(0, 1) + borne[:, i, j, None, None] * np.eye(3)
        np.add.at(self._buffers.hessian, self._slots, blocks.reshape(-1, 9)[self._kept])

    def by_rest(self, weights: RestWeights, vectors: np.ndarray, x_start: np.ndarray) -> np.ndarray:
        """Y of all quadrature points ``(m, 4, 3, 3)``, as of :mod:`sim_core.energies.neo_hookean_rest`, for a step
        from ``x_start`` with these weights, along nodal vectors."""
        now, then, v = self._deformation(self._buffers.x), self._deformation(x_start), self._slope(vectors)
        end, start, along = (as_tensors(w) for w in (weights.end, weights.start, weights.along))
        sheared = now.swapaxes(-1, -2) @ v
        out = (weights.by_area * self.whole_areas)[:, None, None] * np.eye(3)
        out = out - now.swapaxes(-1, -2) @ now @ end - then.swapaxes(-1, -2) @ then @ start
        out = out - (sheared + sheared.swapaxes(-1, -2)) @ along
        return np.asarray(out.reshape(-1, POINTS, 3, 3))

    def by_rest_angles(self, weights: np.ndarray) -> np.ndarray:
        """A solid has no hinges."""
        return np.zeros(0)


def _components(tensors: np.ndarray) -> np.ndarray:
    """Components of the symmetric parts of tensors ``(p, 3, 3)``, ``(p, 6)``."""
    found = tensors[:, FIRST, SECOND] + tensors[:, SECOND, FIRST]
    found[:, :3] *= 0.5
    return np.asarray(found)
