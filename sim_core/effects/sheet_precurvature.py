"""Curvature of a sheet at rest: nothing strains it where it is curved, and it is flat only when it is held so.

    psi(kappa) = -kappa . D kappa_0:    M = D (kappa - kappa_0)

with the bending stiffness D and the curvatures kappa_0 at rest along x and y of the sheet, and its twist (Timoshenko &
Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed., sec. 14: a plate with initial curvature). Paper curls, and what
was rolled stays so. A curvature along x is positive where the ends of least and greatest x rise towards the sheet's z.
"""

from __future__ import annotations

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import StrainAtRest
from sim_core.rigs import Rig, Sheet

NAMES = ("x_per_m", "y_per_m", "twist_per_m")


class SheetPrecurvature(StrainAtRest):
    """A sheet that is curled."""

    name = "sheet_precurvature"
    title = "the sheet is curled"
    words = "The sheet is not flat at rest: it is curved, or twisted, alike all over, where nothing holds it."
    signature = "The sheet is off its place in the same direction all the time, also before anything touches it."
    source = "Timoshenko & Woinowsky-Krieger, Theory of Plates and Shells, 2nd ed. (initial curvature)"
    slot = "sheet"
    passive = True
    needs = "a sheet"
    twins = ("gravity_direction", "sheet_density", "tool_offset")
    separated_by = "The same motion with the sheet turned over: what is curled changes its sign, weight does not."
    parameters = tuple(
        EffectParameter(n, "1/m", -1e3, 1e3, (0.5,), 0.0, False, 1.0, words)
        for n, words in zip(NAMES, ("curvature along x", "curvature along y", "twist"), strict=True)
    )
    parts = ("bending",)
    example = {"x_per_m": 0.4, "y_per_m": -0.3, "twist_per_m": 0.2}

    def targets(self, rig: Rig) -> tuple[str, ...]:
        return tuple(n for n, b in rig.bodies.items() if isinstance(b, Sheet))

    def strain_at_rest(self, values: Values) -> np.ndarray:
        return np.array([values["x_per_m"], values["y_per_m"], 2.0 * values["twist_per_m"]])
