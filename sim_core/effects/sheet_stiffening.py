"""Strain stiffening of a sheet: the more it is stretched, the stiffer it is.

    psi(e) = a Q^2 / (4 T),    Q = e . D e,    stress a Q D e / T

with the membrane stiffness D and T = 1 / (D^-1)_11 = E h, so that a strip that is pulled by the strain e bears E h e
(1 + a e^2). It is the next term of the energy in even powers, in place of the exponential of tissues and fabrics (Fung,
Biomechanics, 2nd ed., sec. 7.11), and convex for a >= 0.
"""

from __future__ import annotations

from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import SHEETS


def stretched(e: Any, d: Any, coefficient: float) -> Any:
    """psi(e)."""
    square = e.dot(d @ e)
    return 0.25 * coefficient * square**2 / uniaxial(d)


def uniaxial(d: Any) -> Any:
    """T = 1 / (D^-1)_11."""
    minor = d[1, 1] * d[2, 2] - d[1, 2] * d[2, 1]
    first = d[1, 0] * d[2, 2] - d[1, 2] * d[2, 0]
    second = d[1, 0] * d[2, 1] - d[1, 1] * d[2, 0]
    return d[0, 0] - (d[0, 1] * first - d[0, 2] * second) / minor


class SheetStiffening(MaterialLaw):
    """A sheet that stretches easily at first."""

    name = "sheet_stiffening"
    title = "the sheet stiffens as it is stretched"
    words = (
        "Threads and fibres straighten as the sheet is stretched: its stiffness grows with the square of the strain."
    )
    signature = (
        "Tension rises more steeply than simulated where the sheet is stretched most, and agrees at small strain."
    )
    source = "Fung, Biomechanics, 2nd ed., 1993, sec. 7.11 (first term of the exponential)"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("sheet_thickness", "sheet_orthotropy")
    separated_by = "Pulls to several strains: a modulus scales the force at all of them alike."
    parameters = (
        EffectParameter("coefficient", "-", 1e-2, 1e14, (10.0, 1e4), 0.0, True, 4.0, "relative stiffening at strain 1"),
    )
    parts = ("membrane",)
    example = {"coefficient": 1e10}
    formula = MaterialFormula(stretched)
