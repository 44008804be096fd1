"""Shapes of sheets and gels that come from mesh files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from sim_core.errors import ConfigError
from sim_core.rigs.fields import Flag, FloatArray, Length, Name, Strict, Text, trouble
from sim_core.rigs.regions import RefinedBox, Region

if TYPE_CHECKING:
    from sim_core.geometry.sheets import SheetMesh
    from sim_core.geometry.solids import TetMesh

Unit = Literal["m", "cm", "mm", "um", "in"]


class _MeshFile(Strict):
    """What meshes of sheets and gels share. The body's rest coordinates are those of the file, in m.

    ``weld``: join vertices that are at one place (true), or keep them apart, as of a slit (false); without it, such
    vertices are refused. Triangles of STL files, which share none, are joined where they meet. One place: within a
    thousandth of the shortest edges there.
    """

    type: Literal["mesh"]
    file: Annotated[Text, Field(min_length=1)] = Field(description="path, from the folder of the rig file")
    unit: Unit = Field(description="unit of the coordinates in the file: m, cm, mm, um or in")
    weld: Flag | None = Field(
        default=None,
        description="join vertices at one place (true) or keep them apart (false); left out: such vertices are refused",
    )

    def _nodes(self) -> FloatArray:
        raise NotImplementedError

    @model_validator(mode="after")
    def _readable(self) -> _MeshFile:
        try:
            self._nodes()
        except ConfigError as error:
            raise trouble(f"is {self.file!r}. {error.problem}", error.remedy, "file") from None
        return self

    def bounds(self) -> FloatArray:
        """Corners of the box around it [m], shape ``(2, 3)``."""
        nodes = self._nodes()
        return np.array([nodes.min(axis=0), nodes.max(axis=0)])


class SheetFile(_MeshFile):
    """A sheet, flat or curved at rest, as the triangles of a file have it: OBJ, STL, PLY and what else meshio reads."""

    def mesh(self) -> SheetMesh:
        """The mesh as the file has it."""
        from sim_core.geometry.mesh_file import read_sheet

        return read_sheet(Path(self.file), self.unit, self.weld)

    def _nodes(self) -> FloatArray:
        return self.mesh().nodes


class Fill(Strict):
    """How a closed surface is filled with tetrahedra."""

    edge_m: Length = Field(description="wanted length of the edges of the tetrahedra in m")


class GelFile(_MeshFile):
    """A gel as the tetrahedra of a file have it: Gmsh, VTK and what else meshio reads; or a closed surface, filled.

    ``face_regions``: names of faces, and the box in which all of their corners lie. Named physical groups of triangles
    in a Gmsh file are faces too.
    """

    face_regions: dict[Name, Region] = Field(
        default={}, description="name of a face -> box in which all of its corners lie"
    )
    fill: Fill | None = Field(default=None, description="fill a closed surface with tetrahedra")

    refine: ClassVar[tuple[RefinedBox, ...]] = ()
    symmetry: ClassVar[tuple[str, ...]] = ()
    cut: ClassVar[tuple[int, ...]] = ()

    def mesh(self) -> TetMesh:
        """The mesh as the file has it."""
        from sim_core.geometry.mesh_file import read_solid

        boxes = {name: region.box() for name, region in self.face_regions.items()}
        return read_solid(Path(self.file), self.unit, self.weld, boxes, self.fill.edge_m if self.fill else None)

    @property
    def faces(self) -> tuple[str, ...]:
        """Names of its faces."""
        return tuple(self.mesh().face_sets)

    def _nodes(self) -> FloatArray:
        return self.mesh().nodes
