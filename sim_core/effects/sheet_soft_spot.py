"""Soft spot of a sheet: a place where it is softer, or stiffer, in stretching and in bending.

f(X) = 1 - a exp(-r^2 / (2 s^2)),    r^2 = (x - x_0)^2 + (y - y_0)^2

a factor on the stiffness at the place X of the flat sheet: the field of a modulus in one bump (Avril et al.,
Experimental Mechanics 48, 2008, sec. 5: identification of stiffness fields). Spots are wider than an element of the
mesh."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter, RecordingScales
from sim_core.effects.hooks import FieldMap
from sim_core.effects.scopes import SHEETS
from sim_core.rigs import Rig, Sheet


def spot(x: float, y: float, z: float, t: float, depth: float, x_m: float, y_m: float, radius_m: float) -> float:
    """f."""
    return 1.0 - depth * math.exp(-0.5 * ((x - x_m) ** 2 + (y - y_m) ** 2) / radius_m**2)


class SheetSoftSpot(FieldMap):
    """A sheet with a weak place."""

    name = "sheet_soft_spot"
    title = "the sheet has a soft spot"
    words = "In one place the sheet is softer, or stiffer, than elsewhere: it is thin, damp, damaged or printed there."
    signature = "Forces and shapes are off only while the spot is bent or stretched, wherever the finger is."
    source = "Avril et al., Experimental Mechanics 48, 2008 (stiffness fields)"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("sheet_crease", "sheet_stiffness_gradient", "end_effector_compliance")
    separated_by = "The same motion with the sheet shifted, or turned round: the spot moves with it."
    parameters = (
        EffectParameter("depth", "-", -20.0, 0.95, (0.3,), 0.0, False, 0.3, "share by which it is softer there"),
        EffectParameter("x_m", "m", -10.0, 10.0, (0.0,), None, False, 0.02, "middle along x"),
        EffectParameter("y_m", "m", -10.0, 10.0, (0.0,), None, False, 0.02, "middle along y"),
        EffectParameter("radius_m", "m", 1e-4, 10.0, (0.01,), None, True, 0.7, "s"),
    )
    parts = ("membrane", "bending")
    example = {"depth": 0.4, "x_m": -0.01, "y_m": 0.003, "radius_m": 0.012}
    formula = Law(spot, order=1)

    def variants(self, rig: Rig, scales: RecordingScales | None = None) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """Spots of a fifth of its size, in the middle of the sheet and around it."""
        sheets = [body for body in rig.bodies.values() if isinstance(body, Sheet)]
        return tuple(spread_over(body.shape.bounds(), self.parameters) for body in sheets[:1])


def spread_over(bounds: np.ndarray, parameters: tuple[EffectParameter, ...]) -> dict[str, tuple[float, ...]]:
    """Starting values for spots in a box with these corners [m] ``(2, 3)``."""
    middle, size = bounds.mean(axis=0), np.ptp(bounds, axis=0)
    x, y = (tuple(float(middle[k] + s * size[k]) for s in (0.0, -0.25, 0.25)) for k in range(2))
    own = {p.name: p.typical for p in parameters}
    return {**own, "x_m": x, "y_m": y, "radius_m": (0.2 * float(np.sqrt(size[0] * size[1])),)}
