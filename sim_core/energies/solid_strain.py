"""Green strains at the quadrature points of a gel as the strain measure of material laws.

    E = (F^T F - 1) / 2,    F = dx/dX

components 11 22 33 and twice 23 13 12. The stiffness that laws see is that of shear, at small strain,

    D E = 2 mu (E - tr(E) / 3 1)

since what laws add to the pressure point by point would lock near incompressibility
(:mod:`sim_core.energies.neo_hookean_moduli`).
"""

from __future__ import annotations

import numpy as np

from sim_core.energies.grading import Grading
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.term import Quantity

POINTS = 4
"""Quadrature points of an element."""

SHEAR = np.block([[2.0 * np.eye(3) - 2.0 / 3.0, np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]])
"""D / mu."""


class SolidStrain:
    """Strains of the gel that a neo-Hookean term is of."""

    components = 6
    quantities: tuple[Quantity, ...] = (Quantity("E_pa", "Pa", power=1), Quantity("nu", "-"))

    def __init__(self, solid: NeoHookean) -> None:
        self._solid = solid

    @property
    def own(self) -> NeoHookean:
        """The term whose strains these are."""
        return self._solid

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
