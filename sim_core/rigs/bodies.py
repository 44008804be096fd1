"""Sheets, gels, rigid and affine bodies of a rig: shapes and materials.

Every shape has its origin at its own centre and lies in local rest coordinates [m].
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from sim_core.errors import ConfigError
from sim_core.geometry.polygons import area_of, crossing_edges, in_polygon
from sim_core.materials.presets import preset_values
from sim_core.rigs.fields import (
    Cells2,
    Coordinate,
    FloatArray,
    Length,
    Name,
    Point2,
    Pose,
    Strict,
    Text,
    Vector,
    describe,
    trouble,
)
from sim_core.rigs.gel_shapes import Block, Disc, Dome
from sim_core.rigs.mesh_shapes import GelFile, SheetFile
from sim_core.rigs.rigid_shapes import Box, Cylinder, Plane, Sphere

WORLD = "world"
Modulus = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1.0, le=1e13)]
Density = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1.0, le=3e4)]
Thickness = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=1e-7, le=0.02)]
MassDamping = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=1e4)]
StiffnessDamping = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0, le=10.0)]
Poisson = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=-1.0, lt=0.5)]
PoissonOfSheet = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=-1.0, le=0.5)]


class _Material(Strict):
    quantities: ClassVar[tuple[str, ...]] = ()

    @classmethod
    def prepare(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Fill in what a named preset says and the rig file does not."""
        if data.get("preset") is None:
            return data
        try:
            values = preset_values(data["preset"])
        except ConfigError as error:
            raise trouble(f"is {describe(data['preset'])}. {error.problem}", error.remedy, "preset") from None
        return {**{key: value for key, value in values.items() if key in cls.quantities}, **data}


class _Damped(_Material):
    """Rayleigh damping: forces -alpha M v on what nothing holds, v in the world, and beta times the rate of the
    elastic forces, which is zero while the body moves rigidly. A vibration of the angular frequency w is damped by
    the ratio alpha / (2 w) + beta w / 2."""

    quantities: ClassVar[tuple[str, ...]] = ("mass_damping_per_s", "stiffness_damping_s")

    mass_damping_per_s: MassDamping = Field(default=0.0, description="force over momentum, against motion, in 1/s")
    stiffness_damping_s: StiffnessDamping = Field(default=0.0, description="stress over its elastic rate, in s")


class SheetMaterial(_Damped):
    """Isotropic linear elasticity of a thin sheet."""

    quantities: ClassVar[tuple[str, ...]] = ("E_pa", "nu", "thickness_m", "density_kg_m3", *_Damped.quantities)

    preset: Text | None = Field(
        default=None, description="name of a material, whose values hold where a key is left out"
    )
    E_pa: Modulus = Field(description="Young's modulus in Pa")
    nu: PoissonOfSheet = Field(description="Poisson's ratio")
    thickness_m: Thickness = Field(description="thickness of the sheet in m")
    density_kg_m3: Density = Field(description="mass per volume in kg/m^3")


class GelMaterial(_Damped):
    """Isotropic hyperelasticity of a soft block; ``E_pa`` and ``nu`` hold at small strain."""

    quantities: ClassVar[tuple[str, ...]] = ("E_pa", "nu", "density_kg_m3", *_Damped.quantities)

    preset: Text | None = Field(
        default=None, description="name of a material, whose values hold where a key is left out"
    )
    E_pa: Modulus = Field(description="Young's modulus in Pa")
    nu: Poisson = Field(description="Poisson's ratio")
    density_kg_m3: Density = Field(description="mass per volume in kg/m^3")


class AffineMaterial(_Material):
    """What an affine body is made of; all of them are as stiff as each other."""

    quantities: ClassVar[tuple[str, ...]] = ("density_kg_m3",)

    preset: Text | None = Field(
        default=None, description="name of a material, whose density holds where the key is left out"
    )
    density_kg_m3: Density = Field(description="mass per volume in kg/m^3")


class Fold(Strict):
    """A bend of a sheet at rest, about a line along local y; what lies beyond it (larger x) turns towards +z.

    ``over_m``: length of the arc over which the angle is spread; without it, a crease.
    """

    at_m: Coordinate = Field(description="place of the line along local x in m")
    angle_deg: Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-180.0, le=180.0)] = Field(
        description="by how much it turns in deg"
    )
    over_m: Length | None = Field(
        default=None, description="length of the arc over which the angle is spread; left out: a crease"
    )


class Rectangle(Strict):
    """A rectangle: length along local x, width along local y.

    ``folds``: where it is bent at rest, without stretch; the end of least x stays where it is. Places on the sheet
    (clamps, points) are those on the flat sheet.
    """

    type: Literal["rectangle"]
    length_m: Length = Field(description="extent along local x in m")
    width_m: Length = Field(description="extent along local y in m")
    cells: Cells2 = Field(description="number of cells along x and y")
    pattern: Literal["regular", "crossed", "irregular"] = Field(
        default="regular", description="how cells are cut into triangles"
    )
    folds: tuple[Fold, ...] = Field(default=(), description="bends of the sheet at rest")

    @model_validator(mode="after")
    def _folds_fit(self) -> Rectangle:
        if self.folds and self.pattern == "irregular":
            raise trouble("has folds, which need lines of nodes.", "Write 'pattern: crossed'.", "pattern")
        end = -0.5 * self.length_m
        for index, fold in sorted(enumerate(self.folds), key=lambda item: item[1].at_m):
            half = 0.5 * (fold.over_m or 0.0)
            if fold.at_m - half < end or fold.at_m + half >= 0.5 * self.length_m or fold.at_m <= -0.5 * self.length_m:
                raise trouble(
                    f"reaches from {fold.at_m - half:g} to {fold.at_m + half:g} m, beyond the sheet's end or into "
                    "another fold.",
                    "Move it, or shorten its arc; x = 0 is the middle of the sheet.",
                    "folds",
                    index,
                )
            end = fold.at_m + half
        return self

    def bounds(self) -> FloatArray:
        """Corners of the box around it [m], shape ``(2, 3)``."""
        half = np.array([self.length_m, self.width_m, 0.0]) / 2
        return np.array([-half, half])


class Outline(Strict):
    """A flat sheet of any outline, with holes; coordinates are local, the origin is where they say.

    A ring of corners may repeat the first one at its end, as rings of GIS and CAD files do.
    """

    type: Literal["outline"]
    polygon_m: tuple[Point2, ...] = Field(min_length=3, description="corners of the outline, x and y in m")
    holes_m: tuple[Annotated[tuple[Point2, ...], Field(min_length=3)], ...] = Field(
        default=(), description="rings of corners of holes, x and y"
    )
    edge_m: Length = Field(description="wanted length of the mesh edges in m")

    @field_validator("polygon_m", mode="after")
    @classmethod
    def _open(cls, ring: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        return ring[:-1] if len(ring) > 3 and ring[0] == ring[-1] else ring

    @field_validator("holes_m", mode="after")
    @classmethod
    def _open_holes(
        cls, rings: tuple[tuple[tuple[float, float], ...], ...]
    ) -> tuple[tuple[tuple[float, float], ...], ...]:
        return tuple(ring[:-1] if len(ring) > 3 and ring[0] == ring[-1] else ring for ring in rings)

    @model_validator(mode="after")
    def _has_area(self) -> Outline:
        for path, polygon in [(("polygon_m",), self.polygon_m)] + [
            (("holes_m", index), hole) for index, hole in enumerate(self.holes_m)
        ]:
            if area_of(np.array(polygon)) < 1e-12:
                raise trouble("encloses no area.", "Give the corners in order around the outline.", *path)
        extent = np.ptp(np.array(self.polygon_m), axis=0)
        if self.edge_m > extent.max():
            raise trouble(
                f"is {self.edge_m:g}, longer than the outline ({extent.max():g} m).",
                "Choose a fraction of the outline's extent.",
                "edge_m",
            )
        return self

    @model_validator(mode="after")
    def _simple(self) -> Outline:
        rings: list[tuple[tuple[str | int, ...], str, FloatArray]] = [
            (("polygon_m",), "the outline", np.array(self.polygon_m))
        ]
        rings += [(("holes_m", k), f"hole {k}", np.array(hole)) for k, hole in enumerate(self.holes_m)]
        for path, _, ring in rings:
            doubled = np.flatnonzero((ring == np.roll(ring, -1, axis=0)).all(axis=1))
            if len(doubled):
                k = int(doubled[0])
                following = (k + 1) % len(ring)
                raise trouble(
                    f"has corner {k} and corner {following} at the same place, {ring[k].tolist()} m.",
                    "Leave out one of the two.",
                    *path,
                )
            crossing = crossing_edges(ring, ring)
            if crossing is not None:
                raise trouble(
                    f"crosses itself: the edges from corner {crossing[0]} and from corner {crossing[1]} meet.",
                    "Give the corners in order around the outline.",
                    *path,
                )
        for k, (path, _, ring) in enumerate(rings[1:], 1):
            for other, (_, name, around) in enumerate(rings[:k]):
                inside = bool(in_polygon(ring[:1], around)[0])
                if crossing_edges(ring, around) is not None or inside != (other == 0):
                    where = "is not inside of" if other == 0 else "is not apart from"
                    raise trouble(f"{where} {name}.", "Let holes be inside of the outline and apart.", *path)
        return self

    def bounds(self) -> FloatArray:
        """Corners of the box around it [m], shape ``(2, 3)``."""
        corners = np.pad(np.array(self.polygon_m), ((0, 0), (0, 1)))
        return np.array([corners.min(axis=0), corners.max(axis=0)])


class Sheet(Strict):
    """A thin shell. Its pose is in the base frame; it lies in its local xy plane at rest.

    ``law``: of stretching. ``st_venant_kirchhoff``, linear in Green strain, is for paper, card and cloth, which stretch
    by less than 20 %; ``neo_hookean`` for rubber films at any stretch, which keep their volume (``nu: 0.5``). Bending
    is linear in curvature, with the thickness at rest.
    """

    type: Literal["sheet"]
    shape: Annotated[Rectangle | Outline | SheetFile, Field(discriminator="type")] = Field(
        description="rectangle, outline or mesh"
    )
    pose: Pose = Field(default=Pose(), description="pose in the base frame")
    material: SheetMaterial = Field(description="E_pa, nu, thickness_m, density_kg_m3, or a preset")
    law: Literal["st_venant_kirchhoff", "neo_hookean"] = Field(
        default="st_venant_kirchhoff", description="how it stretches; `neo_hookean` for rubber films"
    )

    @model_validator(mode="after")
    def _keeps_its_volume(self) -> Sheet:
        if self.law == "neo_hookean" and self.material.nu != 0.5:
            raise trouble(
                f"is {self.material.nu:g}, and a film with 'law: neo_hookean' keeps its volume.",
                "Write 'nu: 0.5'.",
                "material",
                "nu",
            )
        return self


class Gel(Strict):
    """A soft solid. ``bonded`` names the face that is glued to ``mount``; without both it is free."""

    type: Literal["gel"]
    shape: Annotated[Block | Disc | Dome | GelFile, Field(discriminator="type")] = Field(
        description="block, disc, dome or mesh"
    )
    pose: Pose = Field(default=Pose(), description="pose in the frame of its mount, or in the base frame")
    material: GelMaterial = Field(description="E_pa, nu, density_kg_m3, or a preset")
    bonded: Text | None = Field(
        default=None,
        description="face that is glued to the mount (block: bottom, top, x_min, x_max, y_min, y_max; disc: bottom, "
        "top, side; dome: base, outer, inner)",
    )
    mount: Name | None = Field(
        default=None, description="end effector or `world` to which it is glued; left out, with `bonded`: it is free"
    )

    @model_validator(mode="after")
    def _bond(self) -> Gel:
        if (self.bonded is None) != (self.mount is None):
            given, other = ("mount", "bonded") if self.bonded is None else ("bonded", "mount")
            raise trouble(f"has {given} but no {other}.", "Give both (which face is glued, and to what), or neither.")
        if self.bonded is not None and self.bonded not in self.shape.faces:
            raise trouble(
                f"is {self.bonded!r}, which is no face of a {self.shape.type}.",
                f"Choose one of: {', '.join(self.shape.faces)}." if self.shape.faces else "Name faces by face_regions.",
                "bonded",
            )
        return self


class Rigid(Strict):
    """A body that does not deform; it moves with its mount."""

    type: Literal["rigid"]
    shape: Annotated[Sphere | Cylinder | Box | Plane, Field(discriminator="type")] = Field(
        description="sphere, cylinder, box or plane"
    )
    pose: Pose = Field(default=Pose(), description="pose in the frame of its mount")
    mount: Name = Field(default=WORLD, description="end effector or `world` that carries it")


class Affine(Strict):
    """A stiff body that is free: it moves under weight, contact and joints, and keeps its shape.

    Its pose and its velocities are those at the start, in the base frame; it turns about its centre. ``edge_m``: wanted
    length of the edges of its surface mesh (without it: whole faces of a box, a fifth of the radius else).
    """

    type: Literal["affine"]
    shape: Annotated[Sphere | Cylinder | Box, Field(discriminator="type")] = Field(
        description="sphere, cylinder or box"
    )
    pose: Pose = Field(default=Pose(), description="pose at the start, in the base frame")
    material: AffineMaterial = Field(description="density_kg_m3, or a preset")
    edge_m: Length | None = Field(
        default=None,
        description="wanted length of the edges of its surface mesh; left out: faces of a box, a fifth of the radius",
    )
    velocity_m_s: Vector = Field(default=(0.0, 0.0, 0.0), description="velocity of its centre at the start")
    angular_velocity_deg_s: Vector = Field(
        default=(0.0, 0.0, 0.0), description="angular velocity at the start, in the base frame"
    )

    @model_validator(mode="after")
    def _has_sharp_edges(self) -> Affine:
        if not isinstance(self.shape, Sphere) and self.shape.edge_radius_m is not None:
            raise trouble(
                "is given, but edges and rims of affine bodies are those of their surface meshes, which are sharp.",
                "Leave it out.",
                "shape",
                "edge_radius_m",
            )
        return self


Body = Annotated[Sheet | Gel | Rigid | Affine, Field(discriminator="type")]
