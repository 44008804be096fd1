"""Shapes of gels that the rig describes: blocks, discs, hollow domes, and halves and quarters of them.

Cells are quadratic tetrahedra, five for each of the hexahedra that ``cells`` counts. ``graded`` makes the hexahedra
narrower towards a place, in proportion from one to the next; ``refine`` cuts those in boxes until their edges are short
enough. Both spend cells where the fields are steep, under an indenter say, and both may be combined.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_core.rigs.fields import Cells3, FloatArray, Length, Sizes, Strict, Text, trouble
from sim_core.rigs.regions import RefinedBox

Ratio = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-3, le=1e3)]


class Grading(Strict):
    """Cells that are narrower (ratio below 1) or wider (above 1) towards a place than farthest from it."""

    towards: Text = Field(description="a face, or a middle plane or axis of the shape")
    ratio: Ratio = Field(description="width of the cells there over that of those farthest from it")


class _GelShape(Strict):
    """What all of them have. Sizes, cells and the origin are those of the whole body, whatever symmetry leaves out.

    ``symmetry``: axes normal to planes of symmetry through the origin. Only the part with positive coordinates is
    simulated, its nodes on those planes stay in them, and the forces on it are those on the part.
    """

    faces_of_whole: ClassVar[tuple[str, ...]] = ()
    places: ClassVar[tuple[str, ...]] = ()

    cells: Cells3
    graded: tuple[Grading, ...] = Field(default=(), description="places towards which cells get narrower or wider")
    refine: tuple[RefinedBox, ...] = Field(
        default=(), description="boxes in which cells are cut until their edges are short enough"
    )
    symmetry: tuple[Literal["x", "y"], ...] = Field(
        default=(),
        description="axes normal to planes of symmetry; only the part with positive coordinates is simulated",
    )

    @model_validator(mode="after")
    def _mesh_is_possible(self) -> _GelShape:
        if len(set(self.symmetry)) < len(self.symmetry):
            raise trouble("names an axis twice.", "Name each axis once.", "symmetry")
        for axis, count in zip("xy", self.across(), strict=True):
            if axis in self.symmetry and count % 2:
                raise trouble(
                    f"asks for half of the body along {axis}, where the whole has {count} cells.",
                    "Give the whole an even number of cells, so that the plane of symmetry lies between two.",
                    "symmetry",
                )
        seen: set[str] = set()
        for index, grading in enumerate(self.graded):
            if grading.towards not in self.places:
                raise trouble(
                    f"is {grading.towards!r}, which is no place of a {self.shape_name()}.",
                    f"Choose one of: {', '.join(self.places)}.",
                    "graded",
                    index,
                    "towards",
                )
            if grading.towards in seen:
                raise trouble(f"names {grading.towards} twice.", "Keep one of the two.", "graded", index, "towards")
            seen.add(grading.towards)
        low, high = self.bounds()
        for index, region in enumerate(self.refine):
            box = region.box()
            if (box[0] > high).any() or (box[1] < low).any():
                raise trouble(
                    "misses the body, which reaches "
                    + ", ".join(f"from {a:g} to {b:g} m along {k}" for k, a, b in zip("xyz", low, high, strict=True))
                    + ".",
                    "The box is in the body's own rest coordinates, in m.",
                    "refine",
                    index,
                )
        return self

    def shape_name(self) -> str:
        return str(getattr(self, "type", "shape"))

    def across(self) -> tuple[int, int]:
        """Number of cells of the whole along x and y through its middle."""
        return self.cells[0], self.cells[1]

    def whole_bounds(self) -> FloatArray:
        """Corners of the box around the whole body [m], shape ``(2, 3)``."""
        raise NotImplementedError

    def bounds(self) -> FloatArray:
        """Corners of the box around it [m], shape ``(2, 3)``."""
        bounds = self.whole_bounds()
        for axis in self.cut:
            bounds[0, axis] = 0.0
        return bounds

    @property
    def cut(self) -> tuple[int, ...]:
        """Axes normal to planes of symmetry: 0 for x, 1 for y."""
        return tuple("xy".index(axis) for axis in self.symmetry)

    @property
    def faces(self) -> tuple[str, ...]:
        """Names of the faces that the simulated part has of the whole."""
        return tuple(f for f in self.faces_of_whole if f not in {f"{axis}_min" for axis in self.symmetry})

    @property
    def ratios(self) -> dict[str, float]:
        """Ratio of widths by place."""
        return {grading.towards: grading.ratio for grading in self.graded}


class Block(_GelShape):
    """A solid cuboid of gel."""

    faces_of_whole: ClassVar[tuple[str, ...]] = ("bottom", "top", "x_min", "x_max", "y_min", "y_max")
    places: ClassVar[tuple[str, ...]] = (*faces_of_whole, "x_middle", "y_middle", "z_middle")

    type: Literal["block"]
    size_m: Sizes = Field(description="extents along local x, y, z in m")
    cells: Cells3 = Field(description="number of cells along x, y, z")

    def whole_bounds(self) -> FloatArray:
        """Corners of the box around the whole body [m], shape ``(2, 3)``."""
        half = np.array(self.size_m) / 2
        return np.array([-half, half])


class Disc(_GelShape):
    """A solid disc or cylinder of gel about local z, such as the pad of a sensor."""

    faces_of_whole: ClassVar[tuple[str, ...]] = ("bottom", "top", "side")
    places: ClassVar[tuple[str, ...]] = (*faces_of_whole, "axis", "z_middle")

    type: Literal["disc"]
    radius_m: Length = Field(description="radius in m")
    height_m: Length = Field(description="extent along local z in m")
    cells: Cells3 = Field(
        description="number of cells along a side of the square core, from core to rim, along the height"
    )

    def across(self) -> tuple[int, int]:
        """Number of cells of the whole along x and y through its middle, the rings on both sides left out."""
        return self.cells[0], self.cells[0]

    def whole_bounds(self) -> FloatArray:
        """Corners of the box around the whole body [m], shape ``(2, 3)``."""
        half = np.array([self.radius_m, self.radius_m, self.height_m / 2])
        return np.array([-half, half])


class Dome(_GelShape):
    """A half ball of gel, apex at +z, with a concentric half-ball cavity, like a tactile fingertip.

    The origin is the centre of the ball; ``base`` is the flat ring at z = 0, ``outer`` the skin,
    ``inner`` the wall of the cavity. A marker in the cavity is the tip of a pin that stands on that wall, along the
    radius, and moves and turns with it.
    """

    faces_of_whole: ClassVar[tuple[str, ...]] = ("base", "outer", "inner")
    places: ClassVar[tuple[str, ...]] = ("outer", "inner")

    type: Literal["dome"]
    radius_m: Length = Field(description="outer radius in m")
    cavity_radius_m: Length = Field(description="radius of the cavity in m")
    cells: Cells3 = Field(description="number of cells along the cap, from cap to rim, and through the wall")

    @model_validator(mode="after")
    def _has_wall(self) -> Dome:
        if self.cavity_radius_m >= self.radius_m:
            raise trouble(
                f"is {self.cavity_radius_m:g}, but must be less than radius_m ({self.radius_m:g}).",
                "Reduce it: the difference is the thickness of the skin.",
                "cavity_radius_m",
            )
        return self

    def across(self) -> tuple[int, int]:
        """Number of cells of the whole along x and y through its middle, the rings on both sides left out."""
        return self.cells[0], self.cells[0]

    def whole_bounds(self) -> FloatArray:
        """Corners of the box around the whole body [m], shape ``(2, 3)``."""
        r = self.radius_m
        return np.array([[-r, -r, 0.0], [r, r, r]])
