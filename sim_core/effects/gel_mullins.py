"""Mullins softening of a gel: where it was deformed strongly once, it stays softer up to that deformation.

    S = -d(k) D E,    d(k) = a (1 - exp(-k / m)),    k = the largest q so far,    q^2 = E . D E / T

with D E = 2 mu (E - tr(E) / 3 1) and T = 3 mu, so that q is the strain of a bar; a share d of the shear stress at small
strain is lost (isotropic damage by the largest strain: Simo, Comput. Methods Appl. Mech. Eng. 60, 1987, eq. 2.9). In a
step from k the stress is the derivative of -T (d(k) q^2 / 2 + c(k)) where q <= k, and of -T int_0^q d(s) s ds beyond,

    int_0^q d(s) s ds = a [q^2 / 2 + m (q + m) exp(-q / m) - m^2],    c(k) = int_0^k d(s) s ds - d(k) k^2 / 2
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from sim_core.core.material import MaterialFormula
from sim_core.effects.base import EffectParameter
from sim_core.effects.hooks import MaterialLaw
from sim_core.effects.scopes import GELS


def damaged(e: Any, d: Any, largest: float, share: float, strain: float) -> Any:
    """The incremental energy, and k."""
    unit = 3.0 * d[3, 3]
    square = max(0.0, e.dot(d @ e) / unit)
    size = math.sqrt(square)
    lost = -share * math.expm1(-largest / strain)
    stored = 0.5 * lost * (square - largest**2) + dissipated(largest, share, strain)
    return -unit * (dissipated(size, share, strain) if size > largest else stored), max(size, largest)


def dissipated(q: float, share: float, strain: float) -> float:
    """int_0^q d(s) s ds."""
    return share * (0.5 * q**2 + strain * (q + strain) * math.exp(-q / strain) - strain**2)


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
    scope = GELS
    twins = ("gel_relaxation", "contact_adhesion")
    separated_by = "Presses of growing depth, each made twice, and again after ten minutes: relaxation recovers."
    parameters = (
        EffectParameter("share", "-", 0.0, 0.9, (0.3,), 0.0, False, 0.3, "share of the stress that is lost in the end"),
        EffectParameter("strain", "-", 1e-3, 10.0, (0.05, 0.3), None, True, 1.5, "strain by which most of it is lost"),
    )
    parts = ("solid",)
    lasting = ("largest",)
    example = {"share": 0.3, "strain": 0.05}
    formula = MaterialFormula(damaged)

    def state(self) -> Mapping[str, tuple[int, ...]]:
        return {"largest": ()}
