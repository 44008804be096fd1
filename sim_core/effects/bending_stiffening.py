"""Stiffening of a sheet in bending: the more it is bent, the stiffer it is.

    psi(kappa) = a Q^2 / (4 T),    Q = kappa . D kappa,    moment a Q D kappa / T

with the bending stiffness D and T = 1 / (D^-1)_11, so that a strip of curvature kappa bears B kappa (1 + a kappa^2):
the next even power of the energy, as of fabrics whose yarns lock (Clapp, Peng, Ghosh & Eischen, Int. J. Clothing Sci.
Tech. 2, 1990)."""

from __future__ import annotations

from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import SHEETS
from sim_core.effects.sheet_stiffening import stretched


def bent(e: Any, d: Any, coefficient_m2: float) -> Any:
    """psi(kappa)."""
    return stretched(e, d, coefficient_m2)


class BendingStiffening(MaterialLaw):
    """A sheet that bends easily at first."""

    name = "bending_stiffening"
    title = "the sheet stiffens as it is bent"
    words = "The sheet resists strong bends more than in proportion: its stiffness grows with the square of curvature."
    signature = "Forces rise more steeply than simulated where the sheet is bent most, and agree in gentle bends."
    source = "Clapp, Peng, Ghosh & Eischen, Int. J. Clothing Sci. Tech. 2, 1990"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("sheet_stiffening", "sheet_thickness")
    separated_by = "The same deflection at two free lengths: the shorter one is bent more strongly."
    parameters = (
        EffectParameter("coefficient_m2", "m^2", 1e-9, 100.0, (1e-3,), 0.0, True, 3.0, "stiffening at curvature 1/m"),
    )
    parts = ("bending",)
    example = {"coefficient_m2": 0.01}
    formula = MaterialFormula(bent)
