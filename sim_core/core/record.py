"""Mechanics as the flat record of the compiled core, with the derivatives of their numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp

from sim_core.contact.edges import EdgeContact
from sim_core.contact.pressure_and_friction import LAW_OF
from sim_core.contact.rigid import RigidContact
from sim_core.contact.surface import SurfaceContact
from sim_core.core.added import added_laws
from sim_core.core.elastic import collected, hinges, tetrahedra, triangles
from sim_core.core.gradings import at_the_start, gradings
from sim_core.core.layout import layout_of
from sim_core.core.materials import materials
from sim_core.core.mechanics import Mechanics
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.affine import AffineShape
from sim_core.energies.air_drag import AirDragTerm
from sim_core.energies.couple import Couple
from sim_core.energies.dead_load import DeadLoad
from sim_core.energies.guide import Guide
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.pressure import Pressure
from sim_core.geometry.faces import face_rule
from sim_core.solve.report import NewtonSettings
from sim_core.solve.system import System

ContactTerm = RigidContact | SurfaceContact | EdgeContact


def record_values(
    scene: Mechanics, settings: NewtonSettings, bearing: np.ndarray, by: NumberSlopes, columns: int
) -> dict[str, Any]:
    """Fields of the record (include/record.hpp). ``bearing``: nodes of which derivatives of the loads are wanted;
    ``columns``: room for derivatives, for at least as many as there are parameters."""
    system, layout = scene.system, layout_of(scene)
    at_the_start(layout)
    values: dict[str, Any] = {
        "nodes": len(scene.system.nodes),
        "columns": columns,
        "prescribed": system.prescribed,
        "rank": layout.rank,
        "rest": scene.system.nodes,
        "bearing": len(bearing),
        "bearing_node": bearing,
        "step_tolerance": settings.step_tolerance_m,
        "force_tolerance": settings.force_tolerance,
        "fast_iterations": settings.fast_iterations,
        "slow_iterations": settings.max_iterations,
        "second_order": system.second_order,
        "modulations": len(by.modulations.of),
        "modulated_from": by.modulations.of,
        "modulated_to": by.modulations.to,
    }
    values |= _masses(scene, by, columns)
    values |= triangles(layout, by)
    values |= hinges(layout, by)
    values |= tetrahedra(layout, by)
    values |= _contacts(scene, by, columns)
    values |= _surfaces(scene, by, columns)
    values |= _edges(scene, by, columns)
    values |= materials(scene, layout, by)
    values |= gradings(scene, layout, by, columns, values["bend_of"])
    values |= _drags(scene, by, columns)
    values |= _loads(scene, by, columns)
    values |= added_laws([*contacts_of(scene), *surfaces_of(scene), *edges_of(scene)], by, columns)
    values |= _affine(scene)
    values |= _guides(scene)
    values |= _couples(scene)
    values |= _yielding(scene, by, columns, values)
    return values | _followers(scene)


def _masses(scene: Mechanics, by: NumberSlopes, columns: int) -> dict[str, Any]:
    """Mass, damping by mass and weight."""
    system, count = scene.system, len(scene.system.nodes)
    mass = sp.csr_matrix(system.mass)
    mass.sum_duplicates()
    mass.sort_indices()
    rows = np.repeat(np.arange(count), np.diff(mass.indptr))

    def on_pattern(matrix: sp.csr_matrix) -> np.ndarray:
        return np.asarray(sp.csr_matrix(matrix)[rows, mass.indices]).ravel() if len(rows) else np.zeros(0)

    def whole(nodes: np.ndarray, matrix: sp.csr_matrix) -> np.ndarray:
        """A matrix over some nodes, over all, on the pattern."""
        part = sp.coo_matrix(matrix)
        return on_pattern(sp.csr_matrix((part.data, (nodes[part.row], nodes[part.col])), shape=mass.shape))

    damping = np.zeros(len(rows))
    parts: dict[int, list[np.ndarray]] = {}
    external = np.zeros((count, 3, columns))

    def part(column: int) -> list[np.ndarray]:
        return parts.setdefault(column, [np.zeros(len(rows)), np.zeros(len(rows))])

    for term in system.terms:
        if isinstance(term, MassDamping):
            damping += whole(term.nodes, term.matrix)
            for quantity, slope in by.of(term.name):
                change = whole(term.nodes, term.matrix_by(quantity))
                for column in np.flatnonzero(slope).tolist():
                    part(column)[1] += slope[column] * change
    for k, (kind, owner, axis) in enumerate(by.keys):
        if kind == "gravity":
            pull = np.asarray(mass @ np.ones(count))
            external[:, "xyz".index(axis), : by.count] += pull[:, None] * by.table[k]
        built = scene.bodies.get(owner)
        if kind == "density" and built is not None and built.unit_mass is not None:
            change, weight = (
                whole(built.nodes, built.unit_mass),
                np.asarray(built.unit_mass @ np.ones(len(built.nodes))),
            )
            external[built.nodes, :, : by.count] += weight[:, None, None] * system.gravity[:, None] * by.table[k]
            for column in np.flatnonzero(by.table[k]).tolist():
                part(column)[0] += by.table[k, column] * change
    changed, (d_mass, d_damping) = collected(parts, (len(rows),), (len(rows),))
    return {
        "external": dead_loads(system),
        "mass_start": mass.indptr,
        "mass_column": mass.indices,
        "mass": mass.data,
        "mass_damping": damping,
        "mass_blocks": len(changed),
        "mass_of": changed,
        "d_mass": d_mass,
        "d_mass_damping": d_damping,
        "d_external": external,
    }


def _drags(scene: Mechanics, by: NumberSlopes, columns: int) -> dict[str, Any]:
    """Triangles of sheets that air drags at."""
    terms = [t for t in scene.system.terms if isinstance(t, AirDragTerm)]
    slopes = [np.empty((0, columns))]
    for term in terms:
        slope = np.zeros(columns)
        slope[: by.count] = sum((s for _, s in by.of(term.name)), np.zeros(by.count))
        slopes.append(term.drag_areas(1.0)[:, None] * slope)
    return {
        "drags": sum(len(t.triangles) for t in terms),
        "drag_triangle": np.vstack([t.triangles for t in terms] or [np.empty((0, 3))]),
        "drag_factor": np.concatenate([t.drag_areas() for t in terms] or [np.empty(0)]),
        "d_drag_factor": np.concatenate(slopes),
    }


def _loads(scene: Mechanics, by: NumberSlopes, columns: int) -> dict[str, Any]:
    """Dead loads and pressures."""
    terms = [t for t in scene.system.terms if isinstance(t, DeadLoad | Pressure)]
    numbers, slopes = np.zeros((len(terms), 3)), np.zeros((len(terms), 3, columns))
    none = np.empty((0, 6), dtype=int)
    faces: list[np.ndarray] = []
    for k, term in enumerate(terms):
        numbers[k, : len(term.load)] = term.load
        for quantity, slope in by.of(term.name):
            slopes[k, : len(term.load), : by.count] += np.outer(term.load_by(quantity), slope)
        own = term.faces if isinstance(term, Pressure) else none
        faces.append(np.pad(own, ((0, 0), (0, 6 - own.shape[1])), constant_values=-1))
    dead = [t.nodes if isinstance(t, DeadLoad) else none[:, 0] for t in terms]
    weights = [t.weights if isinstance(t, DeadLoad) else np.empty(0) for t in terms]
    rules = [face_rule(nodes) for nodes in (3, 6)]
    return {
        "loads": len(terms),
        "load_table_start": np.cumsum([0, *(len(t.schedule.times) for t in terms)]),
        "load_time": np.concatenate([np.empty(0), *(t.schedule.times for t in terms)]),
        "load_value": np.concatenate([np.empty(0), *(t.schedule.values for t in terms)]),
        "load_number": numbers,
        "d_load_number": slopes,
        "dead_start": np.cumsum([0, *(len(n) for n in dead)]),
        "dead_node": np.concatenate([none[:, 0], *dead]),
        "dead_weight": np.concatenate([np.empty(0), *weights]),
        "face_start": np.cumsum([0, *(len(f) for f in faces)]),
        "face_node": np.concatenate([none, *faces]),
        "rule_weight": np.concatenate([r.weights for r in rules]),
        "rule_shape": np.concatenate([r.shape.ravel() for r in rules]),
        "rule_slope": np.concatenate([r.slopes.ravel() for r in rules]),
    }


def contacts_of(scene: Mechanics) -> list[RigidContact]:
    """Contacts with rigid shapes, in the order of the record."""
    return [t for t in scene.system.terms if isinstance(t, RigidContact)]


def _contacts(scene: Mechanics, by: NumberSlopes, columns: int) -> dict[str, Any]:
    """Contacts with rigid shapes."""
    terms, mounts = contacts_of(scene), list(scene.start)
    placed = [scene.placed_on(t.body_node) for t in terms]
    corners, nodes, weights = _padded(terms)
    return {
        "contacts": len(terms),
        "samples": sum(len(t.samples.areas) for t in terms),
        "corners": corners,
        "sample_start": np.cumsum([0, *(len(t.samples.areas) for t in terms)]),
        "body_node": [t.body_node for t in terms],
        "body_mount": [mounts.index(mount) for mount, _ in placed],
        "body_rotation": [rotation for _, rotation in placed],
        "law": [t.law for t in terms],
        "shape": [t.shape for t in terms],
        "sample_node": nodes,
        "sample_weight": weights,
        "sample_area": np.concatenate([t.areas for t in terms] or [np.empty(0)]),
        "d_law": _law_slopes(terms, by, columns),
    }


def _padded(terms: Sequence[RigidContact] | Sequence[SurfaceContact]) -> tuple[int, np.ndarray, np.ndarray]:
    """Most nodes of a sample, and nodes and weights of all samples ``(s, corners)``."""
    corners = max((t.samples.nodes.shape[1] for t in terms), default=1)
    nodes, weights = [np.empty((0, corners))], [np.empty((0, corners))]
    for term in terms:
        lack = corners - term.samples.nodes.shape[1]
        nodes.append(np.pad(term.samples.nodes, ((0, 0), (0, lack)), mode="edge"))
        weights.append(np.pad(term.samples.weights, ((0, 0), (0, lack))))
    return corners, np.vstack(nodes), np.vstack(weights)


def _law_slopes(terms: Sequence[ContactTerm], by: NumberSlopes, columns: int) -> np.ndarray:
    """Derivatives of the numbers of the laws ``(terms, 8, columns)``."""
    law = np.zeros((len(terms), 8, columns))
    for k, term in enumerate(terms):
        for quantity, slope in by.of(term.name):
            for place, share in (term.law_by(quantity) if quantity in LAW_OF else {}).items():
                law[k, place, : by.count] += share * slope
    return law


def surfaces_of(scene: Mechanics) -> list[SurfaceContact]:
    """Contacts of surfaces, in the order of the record."""
    return [t for t in scene.system.terms if isinstance(t, SurfaceContact)]


def edges_of(scene: Mechanics) -> list[EdgeContact]:
    """Contacts of edges, in the order of the record."""
    return [t for t in scene.system.terms if isinstance(t, EdgeContact)]


def _surfaces(scene: Mechanics, by: NumberSlopes, columns: int) -> dict[str, Any]:
    """Contacts of surfaces."""
    terms = surfaces_of(scene)
    corners, nodes, weights = _padded(terms)
    return {
        "surfaces": len(terms),
        "surface_corners": corners,
        "surface_sample_start": np.cumsum([0, *(len(t.samples.areas) for t in terms)]),
        "surface_triangle_start": np.cumsum([0, *(len(t.triangles) for t in terms)]),
        "surface_margin": [t.margin_m for t in terms],
        "surface_law": [t.law for t in terms],
        "surface_node": nodes,
        "surface_used": np.count_nonzero(weights, axis=1),
        "surface_weight": weights,
        "surface_area": np.concatenate([t.areas for t in terms] or [np.empty(0)]),
        "surface_triangle": np.vstack([t.triangles for t in terms] or [np.empty((0, 3), dtype=np.int32)]),
        "surface_border": np.vstack([t.border for t in terms] or [np.empty((0, 6), dtype=np.int32)]),
        "d_surface_law": _law_slopes(terms, by, columns),
    }


def _edges(scene: Mechanics, by: NumberSlopes, columns: int) -> dict[str, Any]:
    """Contacts of edges."""
    terms = edges_of(scene)
    pairs = [t.sides for t in terms]
    sides = [side for pair in pairs for side in pair]
    areas = [np.full(len(s.edges), -1.0) if s.areas is None else s.areas for s in sides]
    return {
        "edge_pairs": len(terms),
        "edge_start": np.cumsum([0, *(len(s.edges) for s in sides)]),
        "edge_once": [ours is theirs for ours, theirs in pairs],
        "edge_margin": [t.margin_m for t in terms],
        "edge_law": [t.law for t in terms],
        "edge_node": np.vstack([s.edges for s in sides] or [np.empty((0, 2), dtype=np.int32)]),
        "edge_area": np.concatenate(areas or [np.empty(0)]),
        "edge_square": np.concatenate([s.squares for s in sides] or [np.empty(0)]),
        "d_edge_law": _law_slopes(terms, by, columns),
    }


def _affine(scene: Mechanics) -> dict[str, Any]:
    """Affine bodies, and nodes that are combinations of others."""
    terms = [t for t in scene.system.terms if isinstance(t, AffineShape)]
    embedding, count = scene.system.embedding, sum(len(t.control) for t in terms)
    weights = sp.csr_matrix((0, len(scene.system.nodes))) if embedding is None else embedding.weights
    return {
        "bodies": count,
        "body_control": np.vstack([t.control for t in terms] or [np.empty((0, 4))]),
        "body_slope": np.concatenate([t.slopes for t in terms] or [np.empty((0, 4, 3))]),
        "body_stiffness": np.concatenate([t.stiffness for t in terms] or [np.empty(0)]),
        "embedded": weights.shape[0],
        "embedded_node": np.empty(0) if embedding is None else embedding.nodes,
        "embedded_start": weights.indptr,
        "embedded_in": weights.indices,
        "embedded_weight": weights.data,
    }


def _guides(scene: Mechanics) -> dict[str, Any]:
    """Guides of sliders."""
    terms = [t for t in scene.system.terms if isinstance(t, Guide)]
    return {
        "guides": len(terms),
        "guide_node": [t.nodes for t in terms],
        "guide_weight": [t.weights for t in terms],
        "guide_stiffness": [t.stiffness for t in terms],
    }


def _couples(scene: Mechanics) -> dict[str, Any]:
    """Couples that follow bodies, line by line."""
    terms = couples_of(scene)
    return {
        "couples": sum(len(t.moments) for t in terms),
        "couple_node": np.vstack([t.lines for t in terms] or [np.empty((0, 2))]),
        "couple_axis": np.vstack([np.tile(t.axis, (len(t.moments), 1)) for t in terms] or [np.empty((0, 3))]),
        "couple_moment": moments(scene),
    }


def couples_of(scene: Mechanics) -> list[Couple]:
    """Couples, in the order of the record."""
    return [t for t in scene.system.terms if isinstance(t, Couple)]


def moments(scene: Mechanics) -> np.ndarray:
    """Moments of the lines of all couples [N m] ``(k,)``."""
    return np.concatenate([np.empty(0), *(t.moments for t in couples_of(scene))])


def dead_loads(system: System) -> np.ndarray:
    """Weight and dead loads [N] ``(n, 3)``."""
    return np.asarray(system.mass @ np.broadcast_to(system.gravity, system.nodes.shape) + system.loads)


def _yielding(scene: Mechanics, by: NumberSlopes, columns: int, values: dict[str, Any]) -> dict[str, Any]:
    """Mounts that give way, and the rows of their deflections behind those of the nodes."""
    system, count = scene.system, len(scene.compliant)
    of, slopes = np.full(system.prescribed.shape, -1), np.zeros((count, 3, columns))
    for k, name in enumerate(scene.compliant):
        carried = system.compliant[k].nodes
        of[carried] = np.where(system.prescribed[carried], k, of[carried])
        for a, axis in enumerate("xyz"):
            for key, slope in zip(by.keys, by.table, strict=True):
                if key == ("compliance", name, axis):
                    slopes[k, a, : by.count] -= system.springs[k, a] ** 2 * slope
    longer = {name: values[name] for name in ("prescribed", "external", "d_external")}
    return {
        "yielding": count,
        "yield_of": of,
        "yield_spring": system.springs,
        "d_yield_spring": slopes,
        **{name: np.pad(v, ((0, count), *[(0, 0)] * (v.ndim - 1))) for name, v in longer.items()},
    }


def _followers(scene: Mechanics) -> dict[str, Any]:
    """Nodes that follow mounts."""
    mounts, followers = list(scene.start), scene.followers
    sizes = [len(f.nodes) for f in followers]
    return {
        "mounts": len(mounts),
        "followers": sum(sizes),
        "follower_node": np.concatenate([f.nodes for f in followers] or [np.empty(0)]),
        "follower_mount": np.repeat([mounts.index(f.mount) for f in followers], sizes),
        "follower_axes": np.repeat(np.array([f.axes > 0.0 for f in followers]).reshape(-1, 3), sizes, axis=0),
        "follower_local": np.vstack([f.local for f in followers] or [np.empty((0, 3))]),
    }
