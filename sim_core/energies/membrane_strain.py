"""Green strains of a sheet's triangles as the strain measure of material laws: chain rule from nodes, and back.

    eps = (F^T F - 1) / 2,    d eps[v] = sym(F^T V),    d2 eps[v, w] = sym(V^T W),    F = dx/dX, V = dv/dX

in the material axes of :mod:`sim_core.energies.membrane`, components 11, 22, twice 12.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from sim_core.energies.grading import Grading
from sim_core.energies.linearised import axes_of, placed
from sim_core.energies.membrane import PAIRS, Membrane, as_strain, as_stress
from sim_core.energies.term import Buffers, Quantity


class MembraneStrain:
    """Strains of the sheet that a membrane term is of."""

    components = 3
    quantities: tuple[Quantity, ...] = (
        Quantity("E_pa", "Pa", power=1),
        Quantity("nu", "-"),
        Quantity("thickness_m", "m", power=1),
        Quantity("anisotropy_ratio", "-"),
        Quantity("grain_angle_rad", "rad"),
    )

    def __init__(self, sheet: Membrane) -> None:
        self._sheet = sheet
        self._triangles = sheet.triangles
        self._upper = np.array([[i != j or a <= b for a in range(3) for b in range(3)] for i, j in PAIRS])

    @property
    def areas(self) -> np.ndarray:
        return self._sheet.areas

    @property
    def whole_areas(self) -> np.ndarray:
        return self._sheet.whole_areas

    @property
    def stiffness(self) -> np.ndarray:
        return self._sheet.stiffness

    @property
    def grading(self) -> Grading | None:
        return self._sheet.grading

    def stiffness_by(self, quantity: str) -> np.ndarray:
        return self._sheet.stiffness_by(quantity)

    def at_points(self, values: np.ndarray) -> np.ndarray:
        return values

    def of_elements(self, values: np.ndarray) -> np.ndarray:
        return values

    def blocks(self) -> np.ndarray:
        return self._sheet.blocks()

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._buffers = buffers
        self._kept = np.broadcast_to(self._upper, (len(self._triangles), *self._upper.shape)).reshape(-1, 9)
        self._slots = slots[self._kept]

    @property
    def here(self) -> np.ndarray:
        return self._buffers.x

    def strains(self) -> np.ndarray:
        return self._sheet.strains_at(self._buffers.x)

    def strains_at(self, x: np.ndarray) -> np.ndarray:
        return self._sheet.strains_at(x)

    def foreseen(self, strains: np.ndarray, move: np.ndarray) -> np.ndarray:
        slope = self._sheet.slopes(move)[0]
        return np.asarray(strains - as_strain(0.5 * slope.swapaxes(-1, -2) @ slope))

    def along(self, vectors: np.ndarray) -> np.ndarray:
        f, v = (self._sheet.slopes(x)[0] for x in (self._buffers.x, vectors))
        return as_strain(f.swapaxes(-1, -2) @ v)

    def by_positions(self, x: np.ndarray) -> sp.csr_matrix:
        count = len(self._triangles)
        rows = np.arange(3 * count).reshape(count, 3)
        slopes = self._sheet.by_positions(x)
        return placed((slopes, rows, axes_of(self._triangles)), shape=(3 * count, x.size)).tocsr()

    def add_gradient(self, stress: np.ndarray) -> None:
        slope = self._sheet.slopes(self._buffers.x)[0]
        force = self._sheet.hats() @ (as_stress(stress) @ slope.swapaxes(-1, -2))
        np.add.at(self._buffers.gradient, self._triangles, force)

    def add_hessian(self, stress: np.ndarray, tangent: np.ndarray, exact: bool) -> None:
        """Of the stress the tension alone unless ``exact``, as of the sheet's own."""
        s = as_stress(stress)
        if not exact:
            values, axes = np.linalg.eigh(s)
            s = (axes * np.maximum(values, 0.0)[:, None]) @ axes.swapaxes(-1, -2)
        slope, hats = self._sheet.by_positions(self._buffers.x), self._sheet.hats()
        whole = (slope.transpose(0, 2, 1) @ (self.areas[:, None, None] * tangent) @ slope).reshape(-1, 3, 3, 3, 3)
        geometric = self.areas[:, None, None] * (hats @ s @ hats.swapaxes(-1, -2))
        i, j = np.array(PAIRS).T
        blocks = whole[:, i, :, j, :].swapaxes(0, 1) + geometric[:, i, j, None, None] * np.eye(3)
        np.add.at(self._buffers.hessian, self._slots, blocks.reshape(-1, 9)[self._kept])

    def by_rest(self, weights: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Derivative by Dm^-1 ``(m, 2, 2)`` of the strains at ``x`` with these weights ``(m, 3)``."""
        f, sides = self._sheet.slopes(x)
        return np.asarray(sides.swapaxes(-1, -2) @ f @ as_stress(weights))

    def by_rest_angles(self, weights: np.ndarray) -> np.ndarray:
        """Stretching knows no angles."""
        return np.zeros(1)

    def along_by_rest(self, weights: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """The same of the changes of the strains along nodal vectors, at the positions at hand."""
        (f, sides), (v, moved), s = self._sheet.slopes(self._buffers.x), self._sheet.slopes(vectors), as_stress(weights)
        return np.asarray(sides.swapaxes(-1, -2) @ v @ s + moved.swapaxes(-1, -2) @ f @ s)
