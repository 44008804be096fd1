"""Curvatures of a sheet's triangles as the strain measure of material laws: chain rule from nodes, and back.

    kappa_T = B_T (theta - theta_0),    L_T = B_T dtheta/dx

with the curvature operator B of :mod:`sim_core.energies.curvature`, as in :mod:`sim_core.energies.bending`, whose
kernels these are, too.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from sim_core.energies import bending_kernels as kernels
from sim_core.energies.bending import Bending
from sim_core.energies.grading import Grading
from sim_core.energies.term import Buffers, Quantity
from sim_core.kernels import BoundKernel


class BendingStrain:
    """Curvatures of the sheet that a bending term is of."""

    components = 3
    quantities: tuple[Quantity, ...] = (
        Quantity("E_pa", "Pa", power=1),
        Quantity("nu", "-"),
        Quantity("thickness_m", "m", power=3),
        Quantity("anisotropy_ratio", "-"),
        Quantity("grain_angle_rad", "rad"),
    )

    def __init__(self, sheet: Bending) -> None:
        self._sheet, self._transposed = sheet, sheet.operator.T
        hinges = len(sheet.hinge_nodes)
        self._moment, self._g = np.zeros(hinges), np.zeros((hinges, 12))
        self._tangent = np.zeros((len(sheet.areas), 3, 3))

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
        self._x = buffers.x
        around, hinge = self._sheet.stencils, self._sheet.hinge_nodes
        inner, outer = np.split(slots, [int(around.start[-1])])
        scratch = np.zeros((3 * int(around.nodes.max(initial=0)), 6))
        self._gradient = BoundKernel(kernels.gradient, buffers.x, hinge, self._moment, buffers.gradient)
        self._gradients = BoundKernel(kernels.gradients, buffers.x, hinge, self._g)
        self._gauss_newton = BoundKernel(
            kernels.gauss_newton,
            *(self._g, around.first, around.around, around.b, around.place, around.nodes, self._sheet.areas),
            *(self._tangent, around.start, np.ascontiguousarray(inner), scratch, buffers.hessian),
        )
        self._curved = BoundKernel(
            kernels.curved, buffers.x, hinge, self._moment, np.ascontiguousarray(outer), buffers.hessian
        )

    @property
    def here(self) -> np.ndarray:
        return self._x

    def strains(self) -> np.ndarray:
        return self._sheet.curvatures()

    def strains_at(self, x: np.ndarray) -> np.ndarray:
        return self._sheet.curvatures_at(x)

    def foreseen(self, strains: np.ndarray, move: np.ndarray) -> np.ndarray:
        return strains

    def along(self, vectors: np.ndarray) -> np.ndarray:
        return self._sheet.curving(vectors)

    def by_positions(self, x: np.ndarray) -> sp.csr_matrix:
        return self._sheet.by_positions(x)

    def _bear(self, stress: np.ndarray) -> None:
        """Take the moments on the hinges of stresses times areas."""
        self._moment[:] = self._transposed @ stress.ravel()

    def add_gradient(self, stress: np.ndarray) -> None:
        self._bear(stress)
        self._gradient()

    def add_hessian(self, stress: np.ndarray, tangent: np.ndarray, exact: bool) -> None:
        self._tangent[:] = tangent
        self._gradients()
        self._gauss_newton()
        if exact:
            self._bear(self.areas[:, None] * stress)
            self._curved()

    def by_operator(self, weights: np.ndarray, x: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Derivative by the operator's entries at ``pairs`` of triangles and hinges, int ``(2, k)``, of the curvatures
        at ``x`` with the weights ``(m, 3)``, ``(k, 3)``."""
        triangle, hinge = pairs
        return np.asarray(weights[triangle] * self._sheet.deviations_at(x)[hinge, None])

    def along_by_operator(self, weights: np.ndarray, vectors: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """The same of the changes of the curvatures along nodal vectors, at the positions at hand."""
        triangle, hinge = pairs
        return np.asarray(weights[triangle] * self._sheet.turning(vectors)[hinge, None])

    def by_rest_angles(self, weights: np.ndarray) -> np.ndarray:
        """Derivative by the rest angles ``(n_hinges,)`` of curvatures with the weights ``(m, 3)``."""
        return np.asarray(-(self._transposed @ weights.ravel()))
