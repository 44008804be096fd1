"""Meshes from files: triangles of sheets, tetrahedra of gels, closed surfaces to be filled.

Formats are those of meshio; the unit of the coordinates is given by the caller, as files do not say it.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from sim_core.errors import ConfigError
from sim_core.geometry import mesh_checks as checks
from sim_core.geometry.mesh_dialects import read
from sim_core.geometry.sheets import SheetMesh
from sim_core.geometry.solids import TetMesh, quadratic, surface_of

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Unit of coordinates in m."""


class MeshRepaired(UserWarning):
    """A mesh was not taken as it is in its file; what was done with it."""


def read_sheet(path: Path, unit: str, weld: bool | None = None) -> SheetMesh:
    """Triangles of a file as a sheet, coordinates as in the file, in m. ``weld``: join vertices at one place (True),
    keep them apart (False), or refuse them (None). Those of an STL file, whose triangles share none, are joined
    where it is not False, and at exactly one place in any case."""
    return _sheet(path, _stamp(path), unit, weld)


def read_solid(
    path: Path,
    unit: str,
    weld: bool | None = None,
    boxes: Mapping[str, np.ndarray] | None = None,
    fill_edge_m: float | None = None,
) -> TetMesh:
    """Tetrahedra of a file as a gel. ``boxes``: by name of a set of faces, a box [m] ``(2, 3)`` in which all of their
    corners lie; triangles of named physical groups of Gmsh are sets too. ``fill_edge_m``: fill the closed surface that
    the file has with tetrahedra of about these edges."""
    named = tuple((name, tuple(np.asarray(box).ravel())) for name, box in (boxes or {}).items())
    return _solid(path, _stamp(path), unit, weld, named, fill_edge_m)


def _stamp(path: Path) -> tuple[int, int]:
    """What changes when a file is written anew."""
    try:
        found = path.stat()
    except OSError as error:
        remedy = "Give its path from the folder of the rig file, or an absolute one."
        raise ConfigError(f"The mesh {path} cannot be read: {error.strerror}.", remedy) from None
    return found.st_mtime_ns, found.st_size


@lru_cache(maxsize=32)
def _sheet(path: Path, stamp: tuple[int, int], unit: str, weld: bool | None) -> SheetMesh:
    notes: list[str] = []
    with _named(path):
        mesh = read(path)
        points, triangles = _triangles(mesh, unit, weld, notes, _apart(path))
        if weld is not False:
            checks.check_seams(points, triangles)
        triangles = checks.oriented(triangles, notes)
    _tell(path, notes)
    return SheetMesh(points, np.ascontiguousarray(triangles, dtype=np.int32))


@lru_cache(maxsize=32)
def _solid(
    path: Path,
    stamp: tuple[int, int],
    unit: str,
    weld: bool | None,
    named: tuple[tuple[str, tuple[float, ...]], ...],
    fill_edge_m: float | None,
) -> TetMesh:
    notes: list[str] = []
    with _named(path):
        mesh = read(path)
        kinds = {block.type: block.data for block in mesh.cells if block.type in ("tetra", "tetra10")}
        if fill_edge_m is not None:
            points, triangles = _triangles(mesh, unit, weld, notes, _apart(path))
            checks.check_closed(triangles)
            points, tets = filled(points, checks.oriented(triangles, notes), fill_edge_m)
        elif len(kinds) != 1:
            found = ", ".join(sorted({block.type for block in mesh.cells})) or "no elements"
            raise ConfigError(
                f"has {found}, and a gel needs tetrahedra of one order.",
                "Export tetrahedra of order 1 or 2; a closed surface can be filled: 'fill: {edge_m: ...}'.",
            )
        else:
            (kind,) = kinds
            points = _vertices(mesh) * UNITS[unit]
            tets = np.vstack([block.data for block in mesh.cells if block.type == kind]).astype(np.int64)
            _check_numbers(points, tets)
            checks.check_finite(points)
            points, tets = checks.without_unused(points, tets, notes)
            checks.check_extent(points, unit, UNITS)
            points, tets = checks.joined(points, tets, weld, notes)
            checks.check_distinct(tets[:, :4], "tetrahedra")
        tets = checks.upright(points, tets, notes)
        checks.check_faces(tets[:, :4])
        groups = _groups(mesh, UNITS[unit])

        def sets(corners: np.ndarray) -> dict[str, np.ndarray]:
            found = {name: _inside(corners, np.reshape(box, (2, 3))) for name, box in named}
            for name, centres in groups.items():
                away = cKDTree(centres).query(corners.mean(axis=1))[0]
                found[name] = np.repeat((away < 1e-6 * np.ptp(centres))[:, None], 3, axis=1)
            return found

        if tets.shape[1] == 4:
            solid = quadratic(points, tets, lambda a, b: 0.5 * (a + b), sets)
        else:
            solid = surface_of(points, tets, sets)
        for name in solid.face_sets:
            if not len(solid.face_sets[name]):
                raise ConfigError(
                    f"has no face in the set {name!r}.", "Widen its region: all corners of a face must lie in it."
                )
    _tell(path, notes)
    return solid


def filled(points: np.ndarray, triangles: np.ndarray, edge_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedra that fill a closed surface, by fTetWild (Hu et al., ACM Trans. Graph. 39(4), 2020), which follows it
    within a thousandth of its diagonal. One thread, so that the mesh is the same every time."""
    try:
        import pytetwild
    except ImportError:
        raise ConfigError(
            "is a surface that is to be filled, for which pytetwild is missing.",
            "Install it (pip install 'thinshell_ros[mesh]'), or give a mesh of tetrahedra.",
        ) from None
    with contextlib.redirect_stdout(io.StringIO()):
        corners, tets = pytetwild.tetrahedralize(
            points, triangles.astype(np.int32), edge_length_abs=edge_m, num_threads=1, quiet=True
        )[:2]
    # Its corners are numbered the other way round.
    return np.asarray(corners, dtype=float), np.asarray(tets, dtype=np.int64)[:, [0, 2, 1, 3]]


def _apart(path: Path) -> bool:
    """Whether the triangles of a file share no vertices, by its format."""
    return path.suffix.lower() == ".stl"


def _triangles(mesh: Any, unit: str, weld: bool | None, notes: list[str], apart: bool) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [m] and triangles, checked but for their orientation."""
    points = _vertices(mesh)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1]))) * UNITS[unit]
    triangles = [block.data for block in mesh.cells if block.type == "triangle"]
    quads = [block.data for block in mesh.cells if block.type == "quad"]
    others = {block.type for block in mesh.cells} - {"triangle", "quad", "line", "vertex"}
    if others or not (triangles or quads):
        raise ConfigError(
            f"has {', '.join(sorted(others)) or 'no triangles'}, and triangles are wanted.",
            "Export the surface as triangles.",
        )
    for block in (*triangles, *quads):
        _check_numbers(points, block)
    if quads:
        notes.append(f"{sum(len(q) for q in quads)} quadrilaterals were cut into triangles.")
        triangles += [_cut(points, q) for q in quads]
    cells = np.vstack(triangles).astype(np.int64)
    checks.check_finite(points)
    points, cells = checks.without_unused(points, cells, notes)
    checks.check_extent(points, unit, UNITS)
    points, cells = checks.joined(points, cells, weld, notes, apart)
    checks.check_distinct(cells, "triangles")
    checks.check_triangles(points, cells)
    return points, cells


def _cut(points: np.ndarray, quads: np.ndarray) -> np.ndarray:
    """Triangles of quadrilaterals, cut along the diagonal that lies inside."""
    a, b, c, d = np.moveaxis(points[quads], 1, 0)
    outside = (np.cross(b - a, c - a) * np.cross(c - a, d - a)).sum(axis=1) < 0.0
    turned = np.where(outside[:, None], np.roll(quads, -1, axis=1), quads)
    return np.vstack([turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]])


def _vertices(mesh: Any) -> np.ndarray:
    """Vertices as in the file ``(n, 2)`` or ``(n, 3)``."""
    points = np.asarray(mesh.points, dtype=float)
    if points.ndim != 2 or not len(points) or points.shape[1] not in (2, 3):
        raise ConfigError(
            f"has vertices of the shape {points.shape}.", "Give vertices with two or three coordinates each."
        )
    return points


def _check_numbers(points: np.ndarray, cells: np.ndarray) -> None:
    """Elements have corners that are there."""
    wrong = cells[(cells < 0) | (cells >= len(points))]
    if wrong.size:
        raise ConfigError(
            f"has an element with the corner {int(wrong[0])}, and {len(points)} vertices, counted from 0.",
            "Export it again: the file is damaged.",
        )


def _groups(mesh: Any, scale: float) -> dict[str, np.ndarray]:
    """Centres [m] of the triangles of physical groups of Gmsh by their names."""
    tags = mesh.cell_data_dict.get("gmsh:physical", {})
    groups: dict[str, np.ndarray] = {}
    for kind in ("triangle", "triangle6"):
        if kind in tags:
            centres = scale * mesh.points[mesh.cells_dict[kind][:, :3]].mean(axis=1)
            for name, (tag, dimension) in mesh.field_data.items():
                if dimension == 2 and (tags[kind] == tag).any():
                    groups[name] = centres[tags[kind] == tag]
    return groups


def _inside(corners: np.ndarray, box: np.ndarray) -> np.ndarray:
    slack = 1e-9
    inside: np.ndarray = ((corners >= box[0] - slack) & (corners <= box[1] + slack)).all(axis=-1)
    return inside


@contextlib.contextmanager
def _named(path: Path) -> Iterator[None]:
    """Errors of checks, with the file that they are about."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"The mesh {path.name} {error.problem}", error.remedy) from None


def _tell(path: Path, notes: list[str]) -> None:
    if notes:
        warnings.warn(f"{path.name}: {' '.join(notes)}", MeshRepaired, stacklevel=4)
