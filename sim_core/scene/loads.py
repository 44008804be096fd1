"""Loads of a rig as terms: which nodes and faces they act on, and what they are configured with.

What a load acts on and how it is shared among nodes is as the rig draws the body: it stays with the material when the
body is given another shape at rest.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.energies.dead_load import DeadLoad, Schedule
from sim_core.energies.pressure import Pressure
from sim_core.errors import ConfigError
from sim_core.geometry.faces import face_rule
from sim_core.geometry.sheets import SheetMesh
from sim_core.geometry.solids import TetMesh
from sim_core.rigs.loads import ForceLoad, Load, PressureLoad, TractionLoad, WeightLoad
from sim_core.rigs.schema import Rig
from sim_core.scene.assembly import BuiltBody


def term_name(load: Load) -> str:
    """Name of the term of a load."""
    return f"loads.{load.name}"


def load_terms(rig: Rig, bodies: Mapping[str, BuiltBody]) -> list[DeadLoad | Pressure]:
    """The terms of all loads of a rig. Raises ``ConfigError`` where a region holds nothing to act on."""
    return [_term(load, bodies[load.body]) for load in rig.loads]


def load_numbers(load: Load, gravity: np.ndarray) -> dict[str, float]:
    """What the term of a load is configured with; ``gravity`` [m/s^2] ``(3,)``."""
    if isinstance(load, PressureLoad):
        return {"pressure_pa": load.pressure_pa}
    if isinstance(load, ForceLoad):
        vector = np.array(load.force_n)
    elif isinstance(load, WeightLoad):
        vector = load.mass_kg * gravity
    else:
        vector = np.array(load.traction_pa)
    return dict(zip("xyz", map(float, vector), strict=True))


def _term(load: Load, body: BuiltBody) -> DeadLoad | Pressure:
    schedule = Schedule(np.array(load.times_s), np.array(load.values))
    first, faces = int(body.nodes[0]), _faces_inside(load, body)
    if isinstance(load, PressureLoad):
        _refuse_nothing(load, body, len(faces))
        sign = -1.0 if isinstance(body.layout, TetMesh) else 1.0
        return Pressure(term_name(load), faces + first, sign, schedule)
    if isinstance(load, TractionLoad):
        _refuse_nothing(load, body, len(faces))
        nodes, weights = _by_area(body.local, faces)
        return DeadLoad(term_name(load), nodes + first, weights, schedule)
    nodes, weights = _by_area(body.local, faces) if len(faces) else _by_length(load, body)
    return DeadLoad(term_name(load), nodes + first, weights / weights.sum(), schedule)


def _faces_inside(load: Load, body: BuiltBody) -> np.ndarray:
    """Triangles ``(m, 3)`` or quadratic faces ``(m, 6)`` of the body all of whose nodes are in the region."""
    inside = load.region.contains(body.local)
    if isinstance(body.layout, TetMesh):
        cut = [rows for name, rows in body.layout.face_sets.items() if name.endswith("_cut")]
        outer = np.setdiff1d(np.arange(len(body.layout.surface)), np.concatenate([[], *cut]).astype(int))
        rows = outer if load.face is None else body.layout.face_sets[load.face]
        faces = body.layout.surface[rows]
    else:
        assert isinstance(body.layout, SheetMesh)
        faces = body.layout.triangles
    return np.asarray(faces[inside[faces].all(axis=1)])


def _refuse_nothing(load: Load, body: BuiltBody, count: int) -> None:
    """Raise where no element is inside the region."""
    if count:
        return
    what = "face of the surface" if isinstance(body.layout, TetMesh) else "triangle"
    raise ConfigError(
        f"The region of the load {load.name} holds no whole {what} of {body.name}.",
        "Widen the region (it is in the body's local rest coordinates, in m), or give the body more cells there.",
    )


def _by_area(local: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of faces, and the areas [m^2] that they have of them ``(k,)``."""
    nodes, place = np.unique(faces, return_inverse=True)
    shares = face_rule(faces.shape[1]).shares(local[faces])
    return nodes, np.bincount(place.ravel(), weights=shares.ravel(), minlength=len(nodes))


def _by_length(load: Load, body: BuiltBody) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of a sheet or an affine body in the region, and the lengths [m] that they have of the edges inside it, or 1
    each where there are none ``(k,)``."""
    inside = load.region.contains(body.local)
    if isinstance(body.layout, TetMesh):
        _refuse_nothing(load, body, 0)
    assert isinstance(body.layout, SheetMesh)
    triangles = body.layout.triangles
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    edges = edges[inside[edges].all(axis=1)]
    if len(edges):
        lengths = np.linalg.norm(body.local[edges[:, 1]] - body.local[edges[:, 0]], axis=1)
        nodes, place = np.unique(edges, return_inverse=True)
        return nodes, np.bincount(place.ravel(), weights=np.repeat(0.5 * lengths, 2), minlength=len(nodes))
    nodes = np.flatnonzero(inside[: len(body.layout.nodes)])
    if not len(nodes):
        raise ConfigError(
            f"The region of the load {load.name} holds no node of {body.name}.",
            "Widen the region (it is in the body's local rest coordinates, in m), or give the body more cells there.",
        )
    return nodes, np.ones(len(nodes))
