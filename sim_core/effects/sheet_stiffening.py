"""Strain stiffening of a sheet: the more it is stretched, the stiffer it is.

    psi(e) = a Q^2 / (4 T),    Q = e . D e,    stress a Q D e / T

with the membrane stiffness D and T = 1 / (D^-1)_11 = E h, so that a strip that is pulled by the strain e bears E h e
(1 + a e^2). It is the next term of the energy in even powers, in place of the exponential of tissues and fabrics (Fung,
Biomechanics, 2nd ed., sec. 7.11), and convex for a >= 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.hooks import MaterialLaw, Response, Strained
from sim_core.materials.elastic import applied
from sim_core.rigs import Rig, Sheet


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
    needs = "a sheet"
    twins = ("sheet_thickness", "sheet_orthotropy")
    separated_by = "Pulls to several strains: a modulus scales the force at all of them alike."
    parameters = (
        EffectParameter("coefficient", "-", 1e-2, 1e14, (10.0, 1e4), 0.0, True, 4.0, "relative stiffening at strain 1"),
    )
    parts = ("membrane",)
    example = {"coefficient": 1e10}

    def targets(self, rig: Rig) -> tuple[str, ...]:
        return tuple(n for n, b in rig.bodies.items() if isinstance(b, Sheet))

    def state(self) -> Mapping[str, tuple[int, ...]]:
        return {}

    def respond(self, at: Strained, values: Values) -> Response:
        a, law = values["coefficient"], Stretched.of(at)
        share = (a / law.unit)[:, None]
        tangent = share[..., None] * (
            law.square[:, None, None] * at.stiffness + 2.0 * law.linear[:, :, None] * law.linear[:, None]
        )
        return Response(0.25 * a * law.square**2 / law.unit, share * law.square[:, None] * law.linear, tangent, {})

    def push(
        self, at: Strained, change: Strained, values: Values, by: Values
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        a, law = values["coefficient"], Stretched.of(at)
        linear = applied(change.stiffness, at.strain) + applied(at.stiffness, change.strain)
        square = (law.linear * change.strain + linear * at.strain).sum(axis=-1)
        own = law.square[:, None] * law.linear / law.unit[:, None]
        more = law.square[:, None] * linear + square[..., None] * law.linear
        less = own * (law.unit_along(change.stiffness) / law.unit)[..., None]
        return by["coefficient"] * own + a * (more / law.unit[:, None] - less), {}


@dataclass(frozen=True)
class Stretched:
    """D e ``(n, 3)``, Q and T ``(n,)`` of elements with the compliances D^-1 ``(n, 3, 3)``."""

    linear: np.ndarray
    square: np.ndarray
    unit: np.ndarray
    compliance: np.ndarray

    @staticmethod
    def of(at: Strained, strain: np.ndarray | None = None) -> Stretched:
        """Of what a law sees, or of another ``strain`` in its place."""
        e = at.strain if strain is None else strain
        compliance, linear = np.linalg.inv(at.stiffness), applied(at.stiffness, e)
        return Stretched(linear, (e * linear).sum(axis=-1), 1.0 / compliance[..., 0, 0], compliance)

    def unit_along(self, stiffness: np.ndarray) -> np.ndarray:
        """Change of T along changes of D ``(..., n, 3, 3)``."""
        first = self.compliance[..., 0]
        return np.asarray(self.unit**2 * (first * applied(stiffness, first)).sum(axis=-1))
