"""Stiffening of a gel: the more it is sheared, the stiffer it is.

    psi(E) = a Q^2 / (4 T),    Q = E . D E,    S = a Q D E / T,    D E = 2 mu (E - tr(E) / 3 1),    T = 3 mu

of Green strains E, so that an incompressible bar that is pulled by a small strain e bears 3 mu e (1 + a e^2) beside its
own law's higher powers: the quadratic term of Yeoh (Rubber Chem. Technol. 66, 1993), in the invariant of Green's
strain, which is convex for a >= 0."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MaterialLaw, Response, Strained
from sim_core.materials.elastic import applied
from sim_core.rigs import Gel, Rig


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
    needs = "a gel"
    twins = ("gel_soft_spot", "tool_offset", "end_effector_compliance")
    separated_by = "Deep presses of a flat and of a sharp tip: the sharp one strains the gel more at the same force."
    parameters = (
        EffectParameter("coefficient", "-", 1e-3, 1e4, (0.5, 5.0), 0.0, True, 2.0, "relative stiffening at strain 1"),
    )
    parts = ("solid",)
    example = {"coefficient": 300.0}

    def targets(self, rig: Rig) -> tuple[str, ...]:
        return tuple(n for n, b in rig.bodies.items() if isinstance(b, Gel))

    def state(self) -> Mapping[str, tuple[int, ...]]:
        return {}

    def respond(self, at: Strained, values: Values) -> Response:
        a, law = values["coefficient"], Sheared.of(at)
        share = (a / law.unit)[:, None]
        outer = law.linear[:, :, None] * law.linear[:, None]
        tangent = share[..., None] * (law.square[:, None, None] * at.stiffness + 2.0 * outer)
        return Response(0.25 * a * law.square**2 / law.unit, share * law.square[:, None] * law.linear, tangent, {})

    def push(
        self, at: Strained, change: Strained, values: Values, by: Values
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        a, law = values["coefficient"], Sheared.of(at)
        linear, square, unit = law.push(at, change)
        own = law.square[:, None] * law.linear / law.unit[:, None]
        more = (law.square[:, None] * linear + square[..., None] * law.linear) / law.unit[:, None]
        return by["coefficient"] * own + a * (more - own * (unit / law.unit)[..., None]), {}


@dataclass(frozen=True)
class Sheared:
    """D E ``(n, 6)``, Q and T ``(n,)``."""

    linear: np.ndarray
    square: np.ndarray
    unit: np.ndarray

    @staticmethod
    def of(at: Strained) -> Sheared:
        """Of what a law of a solid sees."""
        linear = applied(at.stiffness, at.strain)
        return Sheared(linear, (linear * at.strain).sum(axis=-1), 3.0 * at.stiffness[..., 3, 3])

    def push(self, at: Strained, change: Strained) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Changes of the three."""
        linear = applied(change.stiffness, at.strain) + applied(at.stiffness, change.strain)
        square = (self.linear * change.strain + linear * at.strain).sum(axis=-1)
        return linear, square, 3.0 * change.stiffness[..., 3, 3]
