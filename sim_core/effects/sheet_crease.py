"""Crease of a sheet: a line along which it was folded once, and bends more easily since.

f(X) = 1 - a exp(-d^2 / (2 w^2)),    d = x cos phi + y sin phi - c

a factor on the bending stiffness at the place X of the flat sheet, with the distance d from a line whose normal is
turned by phi from x, and w half its width (Lechenault, Thiria & Adda-Bedia, Phys. Rev. Lett. 112, 244301, 2014, whose
hinge has the compliance that is missing here along the line, spread over its width). Creases are wider than an element
of the mesh. Below zero, a is a seam, or a line of glue."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from sim_core.core.pointwise import Law
from sim_core.effects.base import EffectParameter, RecordingScales, Values
from sim_core.effects.hooks import FieldMap
from sim_core.effects.scopes import SHEETS
from sim_core.rigs import Rig, Sheet


def creased(
    x: float, y: float, z: float, t: float, softening: float, offset_m: float, angle_rad: float, width_m: float
) -> float:
    """f."""
    away = math.cos(angle_rad) * x + math.sin(angle_rad) * y - offset_m
    return 1.0 - softening * math.exp(-0.5 * (away / width_m) ** 2)


class SheetCrease(FieldMap):
    """A sheet with a line of weakness."""

    name = "sheet_crease"
    title = "the sheet has a crease"
    words = "Along a line the sheet bends more easily, or less, than elsewhere: it was folded there, or has a seam."
    signature = "Bends concentrate along a line, and forces jump as the finger crosses it."
    source = "Lechenault, Thiria & Adda-Bedia, Phys. Rev. Lett. 112, 244301, 2014"
    slot = "sheet"
    passive = True
    scope = SHEETS
    twins = ("sheet_soft_spot", "bending_plasticity")
    separated_by = "Presses on a grid across the line: a crease acts all along it, a spot in one place."
    parameters = (
        EffectParameter("softening", "-", -20.0, 0.98, (0.4,), 0.0, False, 0.4, "share by which it is softer there"),
        EffectParameter("offset_m", "m", -10.0, 10.0, (0.0,), None, False, 0.02, "c"),
        EffectParameter("angle_rad", "rad", -1.6, 1.6, (0.0,), None, False, 0.8, "phi"),
        EffectParameter("width_m", "m", 1e-4, 1.0, (0.005,), None, True, 0.7, "w"),
    )
    parts = ("bending",)
    example = {"softening": 0.5, "offset_m": -0.005, "angle_rad": 0.3, "width_m": 0.008}
    formula = Law(creased, order=1)

    def variants(self, rig: Rig, scales: RecordingScales | None = None) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """Creases across x and across y, in the middle of the sheet and off it, a twentieth of its size wide."""
        found = []
        for bounds in [body.shape.bounds() for body in rig.bodies.values() if isinstance(body, Sheet)][:1]:
            middle, size = bounds.mean(axis=0), np.ptp(bounds, axis=0)
            for axis, angle in enumerate((0.0, 0.5 * np.pi)):
                offsets = tuple(float(middle[axis] + s * size[axis]) for s in (0.0, -0.25, 0.25))
                own = {p.name: p.typical for p in self.parameters}
                found.append(
                    {**own, "offset_m": offsets, "angle_rad": (angle,), "width_m": (0.05 * float(size[axis]),)}
                )
        return tuple(found)

    def equivalents(self, values: Values) -> tuple[Values, ...]:
        """The normal turned round."""
        turned = {**values, "offset_m": -values["offset_m"]}
        return tuple({**turned, "angle_rad": values["angle_rad"] + s * np.pi} for s in (-1.0, 1.0))
