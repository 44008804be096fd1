"""Generalised strains of the elements of a body, as its material laws see them.

    membrane   eps = (F^T F - 1) / 2,           components 11, 22, twice 12
    bending    kappa_T = B_T (theta - theta_0)   likewise
    solid      E = (F^T F - 1) / 2              components 11, 22, 33, twice 23, 13, 12

with F = dx/dX in the material axes of :mod:`sim_core.energies.membrane`, and B the curvature operator of
:mod:`sim_core.energies.curvature`. The stiffness that laws see of a solid is that of shear, at small strain,

    D E = 2 mu (E - tr(E) / 3 1)

since what laws add to the pressure point by point would lock near incompressibility
(:mod:`sim_core.energies.neo_hookean_moduli`).
"""

from __future__ import annotations

import numpy as np

from sim_core.energies.bending import Bending
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.neo_hookean_moduli import MU
from sim_core.energies.term import Quantity

POINTS = 4
"""Quadrature points of an element of a gel."""

SHEAR = np.block([[2.0 * np.eye(3) - 2.0 / 3.0, np.zeros((3, 3))], [np.zeros((3, 3)), np.eye(3)]])
"""D / mu."""


class SheetStrain:
    """Strains ``(m, 3)`` of the m triangles of a sheet that its membrane or its bending term, ``own``, has."""

    components = 3

    def __init__(self, own: Membrane | Bending) -> None:
        self.own = own

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """Of the numbers of the body's own law those that its stiffness depends on."""
        elastic = [q for q in self.own.quantities if q.name in ("E_pa", "nu", "thickness_m")]
        return (*elastic, Quantity("anisotropy_ratio", "-"), Quantity("grain_angle_rad", "rad"))

    @property
    def areas(self) -> np.ndarray:
        """Areas of the triangles times the factors of their stiffness [m^2] ``(m,)``; changed in place."""
        return self.own.sizes

    @property
    def stiffness(self) -> np.ndarray:
        """Of the body's own law ``(m, 3, 3)``; changed in place."""
        return self.own.stiffness

    def stiffness_by(self, quantity: str) -> np.ndarray:
        """Derivative of :attr:`stiffness` by one of the body's numbers ``(m, 3, 3)``."""
        return self.own.stiffness_by(quantity)

    def at_points(self, values: np.ndarray) -> np.ndarray:
        """Values of the body's elements, each at all that it has strains of, ``(m,)``."""
        return values

    def of_elements(self, values: np.ndarray) -> np.ndarray:
        """Sums of values ``(m,)`` over the elements."""
        return values


class SolidStrain:
    """Strains ``(4 m, 6)`` at the quadrature points of the m elements of a gel, whose neo-Hookean term is ``own``; its
    attributes are those of :class:`SheetStrain`."""

    components = 6
    quantities: tuple[Quantity, ...] = (Quantity("E_pa", "Pa", power=1), Quantity("nu", "-"))

    def __init__(self, own: NeoHookean) -> None:
        self.own = own

    @property
    def areas(self) -> np.ndarray:
        """Volumes of the points [m^3] ``(4 m,)``, times the factors of their stiffness."""
        return self.own.sizes.reshape(-1)

    @property
    def stiffness(self) -> np.ndarray:
        return np.asarray(self.at_points(self.own.shear_moduli)[:, None, None] * SHEAR)

    def stiffness_by(self, quantity: str) -> np.ndarray:
        return np.asarray(self.at_points(self.own.moduli_by(quantity)[:, MU])[:, None, None] * SHEAR)

    def at_points(self, values: np.ndarray) -> np.ndarray:
        return np.repeat(values, POINTS)

    def of_elements(self, values: np.ndarray) -> np.ndarray:
        return np.asarray(values.reshape(-1, POINTS).sum(axis=1))


Strain = SheetStrain | SolidStrain


def strain_of(own: Membrane | Bending | NeoHookean) -> Strain:
    """The strains of the ``own`` term of a sheet or a gel."""
    return SolidStrain(own) if isinstance(own, NeoHookean) else SheetStrain(own)
