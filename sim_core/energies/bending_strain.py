"""Curvatures of a sheet's triangles as the strain measure of material laws.

    kappa_T = B_T (theta - theta_0)

with the curvature operator B of :mod:`sim_core.energies.curvature`, as in :mod:`sim_core.energies.bending`.
"""

from __future__ import annotations

import numpy as np

from sim_core.energies.bending import Bending
from sim_core.energies.grading import Grading
from sim_core.energies.term import Quantity


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

    @property
    def own(self) -> Bending:
        """The term whose strains these are."""
        return self._sheet

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

    def by_rest_angles(self, weights: np.ndarray) -> np.ndarray:
        """Derivative by the rest angles ``(n_hinges,)`` of curvatures with the weights ``(m, 3)``."""
        return np.asarray(-(self._transposed @ weights.ravel()))
