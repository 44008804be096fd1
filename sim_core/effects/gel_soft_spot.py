"""Soft spot of a gel: a column through it that is softer, or stiffer, than the rest.

f(X) = 1 - a exp(-r^2 / (2 s^2)),    r^2 = (x - x_0)^2 + (y - y_0)^2

a factor on the modulus at the place X of the gel at rest, as of a bubble, a cure that is not even, or a worn skin
(Avril et al., Experimental Mechanics 48, 2008, sec. 5: identification of stiffness fields)."""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.effects.base import EffectParameter, RecordingScales
from sim_core.effects.hooks import FieldMap
from sim_core.effects.scopes import GELS
from sim_core.effects.sheet_soft_spot import SheetSoftSpot, spread_over
from sim_core.rigs import Gel, Rig


class GelSoftSpot(FieldMap):
    """A gel with a weak place."""

    name = "gel_soft_spot"
    title = "the gel has a soft spot"
    words = "In one place the gel is softer, or stiffer, than elsewhere: it has a bubble, or was cured unevenly."
    signature = "Forces and markers are off only where the spot is pressed, in the same place of the sensor."
    source = "Avril et al., Experimental Mechanics 48, 2008 (stiffness fields)"
    slot = "gel"
    follows = "sensor"
    passive = True
    scope = GELS
    twins = ("gel_stiffness_gradient", "tool_offset", "camera_distortion")
    separated_by = "The same tip pressed into five places of the sensor."
    parameters = (
        EffectParameter("depth", "-", -20.0, 0.95, (0.3,), 0.0, False, 0.3, "share by which it is softer there"),
        EffectParameter("x_m", "m", -10.0, 10.0, (0.0,), None, False, 5e-3, "middle along x"),
        EffectParameter("y_m", "m", -10.0, 10.0, (0.0,), None, False, 5e-3, "middle along y"),
        EffectParameter("radius_m", "m", 1e-4, 10.0, (3e-3,), None, True, 0.7, "s"),
    )
    parts = ("solid",)
    example = {"depth": 0.4, "x_m": 0.002, "y_m": -0.001, "radius_m": 0.003}
    formula = SheetSoftSpot.formula

    def variants(self, rig: Rig, scales: RecordingScales | None = None) -> tuple[Mapping[str, tuple[float, ...]], ...]:
        """Spots of a fifth of its size, in the middle of the gel and around it."""
        gels = [body for body in rig.bodies.values() if isinstance(body, Gel)]
        return tuple(spread_over(body.shape.bounds(), self.parameters) for body in gels[:1])
