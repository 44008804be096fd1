"""Boxes in a body's local rest coordinates: what a clamp holds, what is refined, what is a face."""

from __future__ import annotations

import numpy as np
from pydantic import Field, model_validator

from sim_core.rigs.fields import FloatArray, Interval, Length, Strict, trouble


class Region(Strict):
    """A box in a body's local rest coordinates; an absent axis is not bounded."""

    x_m: Interval | None = Field(default=None, description="lower and upper bound along local x; left out: not bounded")
    y_m: Interval | None = Field(default=None, description="lower and upper bound along local y; left out: not bounded")
    z_m: Interval | None = Field(default=None, description="lower and upper bound along local z; left out: not bounded")

    @model_validator(mode="after")
    def _ordered(self) -> Region:
        for key in ("x_m", "y_m", "z_m"):
            interval = getattr(self, key)
            if interval is not None and interval[0] > interval[1]:
                raise trouble(f"is [{interval[0]:g}, {interval[1]:g}].", "Write [lower, upper].", key)
        return self

    def box(self) -> FloatArray:
        """Lower and upper corner [m], infinite where not bounded, shape ``(2, 3)``."""
        box = np.array([[-np.inf] * 3, [np.inf] * 3])
        for axis, interval in enumerate((self.x_m, self.y_m, self.z_m)):
            if interval is not None:
                box[:, axis] = interval
        return box

    def contains(self, points: FloatArray) -> np.ndarray:
        """Which local rest points [m] of shape ``(n, 3)`` lie inside (border included): bool ``(n,)``."""
        lower, upper = self.box()
        slack = 1e-9
        return np.asarray(((points >= lower - slack) & (points <= upper + slack)).all(axis=1))


class RefinedBox(Region):
    """A box in which the edges of all cells are at most ``edge_m`` long; around it they grow by themselves."""

    edge_m: Length = Field(description="longest edge of the cells that reach into the box, in m")
