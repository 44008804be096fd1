"""Internal friction of a sheet in bending: fibres slide on each other once they are bent far enough.

A spring of g times the bending stiffness D in series with a slider, parallel to the sheet's own law: the curvature z of
the spring follows that of the sheet until it has the size y, and is dragged along from there on,

    z' = z_t min(1, y / n(z_t)),    z_t = z + kappa' - kappa,    n(z)^2 = z . D z / T,    T = 1 / (D^-1)_11
    moment added: g D z',    w = g T n^2 / 2    n <= y,    g T (y n - y^2 / 2)    n > y,    n = n(z_t)

the projection onto |z| <= y in the metric of D (Prandtl's element; Brokate & Sprekels, Hysteresis and Phase
Transitions, 1996, sec. 2.3). The loop that a strip makes in moment and curvature has the half height g B y, whatever
its speed. Several instances, by labels, are the model of Prandtl and Ishlinskii."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import SHEETS
from sim_core.effects.sheet_stiffening import uniaxial


def prandtl(e: Any, e_0: Any, d: Any, spring: Any, share: float, slip_curvature_per_m: float) -> Any:
    """The incremental energy, w less that of the spring at the start, and z'."""
    tried = spring + e - e_0
    unit, y = uniaxial(d), slip_curvature_per_m
    square = tried.dot(d @ tried) / unit
    size = math.sqrt(square)
    slides = size > y
    energy = share * unit * (y * size - 0.5 * y**2 if slides else 0.5 * square)
    new = (y / size if slides else 1.0) * tried
    return energy - 0.5 * share * spring.dot(d @ spring), new


class BendingFriction(MaterialLaw):
    """A sheet whose fibres rub on each other as it bends."""

    name = "bending_friction"
    title = "the sheet rubs within itself as it bends"
    words = "Fibres of the sheet slide on each other in a bend: it takes more moment to bend it than it gives back."
    signature = "Bent to and fro the sheet makes a loop in force and deflection that is the same at every speed."
    source = "Brokate & Sprekels, Hysteresis and Phase Transitions, 1996, sec. 2.3 (Prandtl's element)"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("bending_plasticity", "viscoelastic_sheet", "hand_backlash")
    separated_by = "Small loops at two speeds: friction makes the same loop in both, and a loop however small the bend."
    parameters = (
        EffectParameter("share", "-", 0.0, 20.0, (0.3,), 0.0, False, 0.5, "stiffness of the spring over the sheet's"),
        EffectParameter(
            "slip_curvature_per_m", "1/m", 1e-2, 1e4, (0.5, 2.0, 8.0), None, True, 1.5, "curvature at which it slides"
        ),
    )
    parts = ("bending",)
    lasting = ("spring",)
    example = {"share": 0.5, "slip_curvature_per_m": 0.5}
    formula = MaterialFormula(prandtl)

    def state(self) -> Mapping[str, tuple[int, ...]]:
        return {"spring": (3,)}
