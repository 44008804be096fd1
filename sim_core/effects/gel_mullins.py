"""Mullins softening of a gel: where it was deformed strongly once, it stays softer up to that deformation.

    S = -d(k) D E,    d(k) = a (1 - exp(-k / m)),    k = the largest q so far,    q^2 = E . D E / T

with D E = 2 mu (E - tr(E) / 3 1) and T = 3 mu, so that q is the strain of a bar; a share d of the shear stress at small
strain is lost (isotropic damage by the largest strain: Simo, Comput. Methods Appl. Mech. Eng. 60, 1987, eq. 2.9). In a
step from k the stress is the derivative of -T (d(k) q^2 / 2 + c(k)) where q <= k, and of -T int_0^q d(s) s ds beyond,

    int_0^q d(s) s ds = a [q^2 / 2 + m (q + m) exp(-q / m) - m^2],    c(k) = int_0^k d(s) s ds - d(k) k^2 / 2
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.effects.base import EffectParameter, Values
from sim_core.effects.gel_stiffening import Sheared
from sim_core.effects.hooks import MaterialLaw, Response, Strained
from sim_core.rigs import Gel, Rig


class GelMullins(MaterialLaw):
    """A gel that softens by its first deformation."""

    name = "gel_mullins"
    title = "the gel softens by its first press"
    words = "Bonds of the gel break where it is deformed more than ever before, and it stays softer below that strain."
    signature = "The first press to each depth is harder than all later ones, however long the gel rests in between."
    source = "Simo, Comput. Methods Appl. Mech. Eng. 60, 1987 (damage); Mullins, Rubber Chem. Technol. 42, 1969"
    slot = "gel"
    follows = "sensor"
    passive = True
    needs = "a gel"
    twins = ("gel_relaxation", "contact_adhesion")
    separated_by = "Presses of growing depth, each made twice, and again after ten minutes: relaxation recovers."
    parameters = (
        EffectParameter("share", "-", 0.0, 0.9, (0.3,), 0.0, False, 0.3, "share of the stress that is lost in the end"),
        EffectParameter("strain", "-", 1e-3, 10.0, (0.05, 0.3), None, True, 1.5, "strain by which most of it is lost"),
    )
    parts = ("solid",)
    lasting = ("largest",)
    example = {"share": 0.3, "strain": 0.05}

    def targets(self, rig: Rig) -> tuple[str, ...]:
        return tuple(n for n, b in rig.bodies.items() if isinstance(b, Gel))

    def state(self) -> Mapping[str, tuple[int, ...]]:
        return {"largest": ()}

    def respond(self, at: Strained, values: Values) -> Response:
        law, before = Sheared.of(at), at.state["largest"]
        size = np.sqrt(np.maximum(law.square, 0.0) / law.unit)
        worse, largest = size > before, np.maximum(size, before)
        lost, steeper = _lost(largest, values)
        spent = _integral(largest, values) - 0.5 * lost * largest**2
        energy = -law.unit * (0.5 * lost * size**2 + spent)
        growth = np.where(worse, steeper / (law.unit * np.where(worse, size, 1.0)), 0.0)
        outer = growth[:, None, None] * law.linear[:, :, None] * law.linear[:, None]
        return Response(
            energy, -lost[:, None] * law.linear, -lost[:, None, None] * at.stiffness - outer, {"largest": largest}
        )

    def push(
        self, at: Strained, change: Strained, values: Values, by: Values
    ) -> tuple[np.ndarray, Mapping[str, np.ndarray]]:
        law, before = Sheared.of(at), at.state["largest"]
        linear, square, unit = law.push(at, change)
        size = np.sqrt(np.maximum(law.square, 0.0) / law.unit)
        worse, largest = size > before, np.maximum(size, before)
        longer = (square - size**2 * unit) / (2.0 * law.unit * np.where(worse, size, 1.0))
        moved = np.where(worse, longer, change.state["largest"])
        lost, steeper = _lost(largest, values)
        scale = values["strain"]
        more = by["share"] * -np.expm1(-largest / scale) + steeper * (moved - largest / scale * by["strain"])
        return -lost[:, None] * linear - more[..., None] * law.linear, {"largest": moved}


def _lost(largest: np.ndarray, values: Values) -> tuple[np.ndarray, np.ndarray]:
    """d and its derivative by k."""
    left = np.exp(-largest / values["strain"])
    return values["share"] * (1.0 - left), values["share"] / values["strain"] * left


def _integral(q: np.ndarray, values: Values) -> np.ndarray:
    """int_0^q d(s) s ds."""
    m = values["strain"]
    return np.asarray(values["share"] * (0.5 * q**2 + m * (q + m) * np.exp(-q / m) - m**2))
