"""Green strains of a sheet's triangles as the strain measure of material laws.

    eps = (F^T F - 1) / 2,    F = dx/dX

in the material axes of :mod:`sim_core.energies.membrane`, components 11, 22, twice 12.
"""

from __future__ import annotations

import numpy as np

from sim_core.energies.grading import Grading
from sim_core.energies.membrane import Membrane
from sim_core.energies.term import Quantity


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

    @property
    def own(self) -> Membrane:
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
