"""Gradient of a gel's stiffness: it gets stiffer from one side to the other, or towards its bond.

f(X) = exp(g_x x + g_y y + g_z z)

a factor on the modulus at the place X of the gel at rest, in its own frame, 1 at the origin: of a cure from one side
(Kloxin et al., Advanced Materials 22, 2010), or a pressed mould.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import FieldMap
from sim_core.rigs import Gel, Rig

NAMES = ("x_per_m", "y_per_m", "z_per_m")


class GelStiffnessGradient(FieldMap):
    """A gel that is stiffer on one side."""

    name = "gel_stiffness_gradient"
    title = "the gel is stiffer on one side"
    words = "The stiffness of the gel grows from one side to the other, or through it, by a constant share a length."
    signature = "Presses in the middle lean to one side, and the same press is harder on one side of the sensor."
    source = "Kloxin et al., Advanced Materials 22, 2010 (gradients of cure)"
    slot = "gel"
    follows = "sensor"
    passive = True
    needs = "a gel"
    twins = ("gel_soft_spot", "tool_offset", "wrench_frame")
    separated_by = "The same tip pressed into both sides of the sensor."
    parameters = tuple(
        EffectParameter(n, "1/m", -1e4, 1e4, (20.0,), 0.0, False, 50.0, f"growth of the stiffness along {n[0]}")
        for n in NAMES
    )
    parts = ("solid",)
    example = {"x_per_m": 60.0, "y_per_m": -40.0, "z_per_m": 80.0}

    def targets(self, rig: Rig) -> tuple[str, ...]:
        return tuple(n for n, b in rig.bodies.items() if isinstance(b, Gel))

    def factor(self, places: np.ndarray, time: float, values: Values) -> np.ndarray:
        return np.asarray(np.exp(places @ np.array([values[n] for n in NAMES])))

    def factor_by(self, places: np.ndarray, time: float, values: Values) -> Mapping[str, np.ndarray]:
        f = self.factor(places, time, values)
        return {n: f * places[:, k] for k, n in enumerate(NAMES)}
