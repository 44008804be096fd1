"""Shapes of rigid and affine bodies: balls, cylinders, boxes and half spaces.

Every shape has its origin at its own centre and lies in local rest coordinates [m].
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_core.rigs.fields import FloatArray, Length, Sizes, Strict, trouble

EdgeRadius = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-5, le=1.0)]

EDGE_RADIUS_M = 2e-4
"""Radius of the rounding of edges and rims of rigid bodies where the rig gives none [m]."""


def _check_edge(edge: float | None, most: float, bound: str) -> None:
    """Refuse a rounding that does not leave the faces any extent."""
    if edge is not None and edge >= most:
        raise trouble(
            f"is {edge:g}, but must be less than {bound} ({most:g}).",
            "Reduce it: what it leaves of the faces is flat.",
            "edge_radius_m",
        )


class Sphere(Strict):
    """A ball about its centre."""

    type: Literal["sphere"]
    radius_m: Length = Field(description="radius in m")

    def bounds(self) -> FloatArray:
        """Corners of the box around it [m], shape ``(2, 3)``."""
        return np.outer([-self.radius_m, self.radius_m], np.ones(3))


class Cylinder(Strict):
    """A solid cylinder along local z, such as a drum, or a punch with flat ends.

    ``edge_radius_m``: rims of rigid cylinders are rounded for contact, as those of real ones are; the flat ends are
    smaller than ``radius_m`` by as much. The default is 0.2 mm, at most half the radius and a quarter of the length.
    """

    type: Literal["cylinder"]
    radius_m: Length = Field(description="radius in m")
    length_m: Length = Field(description="extent along local z in m")
    edge_radius_m: EdgeRadius | None = Field(
        default=None,
        description="radius of the rounding of its rims for contact in m; left out: 0.2 mm, at most half the radius "
        "and a quarter of the length",
    )

    @model_validator(mode="after")
    def _edge_fits(self) -> Cylinder:
        _check_edge(self.edge_radius_m, min(self.radius_m, 0.5 * self.length_m), "the radius and half the length")
        return self

    @property
    def edge_radius(self) -> float:
        """Radius of the rounding of its rims [m]."""
        return self.edge_radius_m or min(EDGE_RADIUS_M, 0.5 * self.radius_m, 0.25 * self.length_m)

    def bounds(self) -> FloatArray:
        """Corners of the box around it [m], shape ``(2, 3)``."""
        return np.outer([-1.0, 1.0], [self.radius_m, self.radius_m, 0.5 * self.length_m])


class Box(Strict):
    """A solid cuboid.

    ``edge_radius_m``: edges of rigid boxes are rounded for contact, as those of real ones are. The default is 0.2 mm,
    at most a quarter of the smallest extent.
    """

    type: Literal["box"]
    size_m: Sizes = Field(description="extents along local x, y, z in m")
    edge_radius_m: EdgeRadius | None = Field(
        default=None,
        description="radius of the rounding of its edges for contact in m; left out: 0.2 mm, at most a quarter of the "
        "smallest extent",
    )

    @model_validator(mode="after")
    def _edge_fits(self) -> Box:
        _check_edge(self.edge_radius_m, 0.5 * min(self.size_m), "half the smallest extent")
        return self

    @property
    def edge_radius(self) -> float:
        """Radius of the rounding of its edges [m]."""
        return self.edge_radius_m or min(EDGE_RADIUS_M, 0.25 * min(self.size_m))

    def bounds(self) -> FloatArray:
        """Corners of the box around it [m], shape ``(2, 3)``."""
        half = np.array(self.size_m) / 2
        return np.array([-half, half])


class Plane(Strict):
    """The half space below local z = 0; its outward normal is local +z."""

    type: Literal["plane"]
