"""Stiffening of a gel: the more it is sheared, the stiffer it is.

    psi(E) = a Q^2 / (4 T),    Q = E . D E,    S = a Q D E / T,    D E = 2 mu (E - tr(E) / 3 1),    T = 3 mu

of Green strains E, so that an incompressible bar that is pulled by a small strain e bears 3 mu e (1 + a e^2) in
addition to its own law's higher powers: the quadratic term of Yeoh (Rubber Chem. Technol. 66, 1993), in the invariant
of Green's strain, which is convex for a >= 0."""

from __future__ import annotations

from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import GELS


def sheared(e: Any, d: Any, coefficient: float) -> Any:
    """psi(E)."""
    square = e.dot(d @ e)
    return 0.25 * coefficient * square**2 / (3.0 * d[3, 3])


class GelStiffening(MaterialLaw):
    """A gel that stiffens in large deformation."""

    name = "gel_stiffening"
    title = "the gel stiffens as it is deformed"
    words = "The chains of the gel straighten as it is deformed: its stiffness grows with the square of the strain."
    signature = "Forces rise more steeply with depth than simulated, and agree in shallow presses."
    source = "Yeoh, Rubber Chem. Technol. 66, 1993 (second term)"
    slot = "gel"
    follows = "sensor"
    passive = True
    scope = GELS
    twins = ("gel_soft_spot", "tool_offset", "end_effector_compliance")
    separated_by = "Deep presses of a flat and of a sharp tip: the sharp one strains the gel more at the same force."
    parameters = (
        EffectParameter("coefficient", "-", 1e-3, 1e4, (0.5, 5.0), 0.0, True, 2.0, "relative stiffening at strain 1"),
    )
    parts = ("solid",)
    example = {"coefficient": 300.0}
    formula = MaterialFormula(sheared)
