"""Viscoelastic sheet: in stretching and in bending, part of its stress needs time to fade.

A Maxwell element (a spring of g times the sheet's stiffness D and a dashpot, time constant tau) parallel to the sheet's
own law, with the strain z of its spring as internal variable:

    dz/dt = de/dt - z / tau,    stress added: g D z

for Green strains e of the membrane and for curvatures alike. In a step of dt, in which e changes evenly,

    z' = a z + b (e' - e),    a = exp(-dt / tau),    b = (1 - a) tau / dt

(Simo & Hughes, Computational Inelasticity, 1998, box 10.4, where b is taken at the middle of the step), and the stress
is the derivative of the incremental energy g / (2 b) (z' . D z' - a^2 z . D z), zero where nothing moves. E is the
modulus in slow motion. With the energy g/2 z . D z of the spring, work less storage in a step is

    g / 2 [(2 / b - 1) z' . D z' - (2 a / b) z' . D z + z . D z] >= 0    as a^2 <= 1 - (1 - b)^2

at any step, share and number of elements: it is passive without a condition. Several branches are several instances.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import SHEETS


def maxwell(e: Any, e_0: Any, d: Any, spring: Any, dt: float, share: float, tau_s: float) -> Any:
    """The incremental energy, and z'."""
    ratio = dt / tau_s
    a, b = math.exp(-ratio), -math.expm1(-ratio) / ratio
    new = a * spring + b * (e - e_0)
    return 0.5 * share / b * (new.dot(d @ new) - a * a * spring.dot(d @ spring)), new


class ViscoelasticSheet(MaterialLaw):
    """A sheet with a Maxwell element parallel to its stiffness."""

    name = "viscoelastic_sheet"
    title = "the sheet creeps"
    words = (
        "The sheet is stiffer in fast motion than in slow one: a share g on top of its stiffness, in stretching and in "
        "bending, fades with the time constant tau."
    )
    signature = (
        "After a fast bend the sheet goes on moving while its clamps rest; bent to and fro it lags behind the model."
    )
    source = "Simo & Hughes, Computational Inelasticity, 1998, box 10.4"
    slot = "sheet"
    follows = "object"
    passive = True
    scope = SHEETS
    twins = ("bending_plasticity", "air_drag")
    separated_by = "A bend that is held and released: what creeps comes back in time, what yielded does not."
    parameters = (
        EffectParameter("share", "-", 0.0, 20.0, (0.3,), 0.0, False, 0.5, "stiffness that fades over that which stays"),
        EffectParameter(
            "tau_s", "s", 1e-3, 1e4, (0.05, 0.25, 1.0), None, True, 2.0, "time constant", "duration_s",
            (0.01, 0.05, 0.25),
        ),
    )  # fmt: skip
    parts = ("membrane", "bending")
    example = {"share": 0.5, "tau_s": 0.1}
    formula = MaterialFormula(maxwell)

    def state(self) -> Mapping[str, tuple[int, ...]]:
        return {"spring": (3,)}
