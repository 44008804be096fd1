"""A scene as the flat record of the compiled core, with the derivatives of its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.sparse as sp

from sim_core.contact.edges import EdgeContact
from sim_core.contact.rigid import RigidContact
from sim_core.contact.surface import SurfaceContact
from sim_core.core.layout import Layout, layout_of
from sim_core.energies.bending import Bending
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.neo_hookean_moduli import apart
from sim_core.rigs import Rigid
from sim_core.scene.scene import Scene
from sim_core.solve.report import NewtonSettings

ContactTerm = RigidContact | SurfaceContact | EdgeContact


@dataclass(frozen=True)
class NumberSlopes:
    """Derivatives of the numbers of the mechanics by parameters. ``keys``: of the numbers, as
    :mod:`sim_core.gradients.directions` has them; ``table``: ``(n_keys, n_parameters)``."""

    keys: Sequence[tuple[str, str, str]] = ()
    table: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def count(self) -> int:
        """How many parameters there are."""
        return int(self.table.shape[1])

    def of(self, owner: str) -> list[tuple[str, np.ndarray]]:
        """Numbers of a term that change, with their slopes ``(p,)``."""
        return [(q, self.table[k]) for k, (kind, name, q) in enumerate(self.keys) if kind == "terms" and name == owner]


def record_values(
    scene: Scene, settings: NewtonSettings, bearing: np.ndarray, by: NumberSlopes, columns: int
) -> dict[str, Any]:
    """Fields of the record (include/record.hpp). ``bearing``: nodes of which derivatives of the loads are wanted;
    ``columns``: room for derivatives, for at least as many as there are parameters."""
    system, layout = scene.system, layout_of(scene)
    values: dict[str, Any] = {
        "nodes": len(scene.rest),
        "columns": columns,
        "prescribed": system.prescribed,
        "rank": layout.rank,
        "rest": scene.rest,
        "bearing": len(bearing),
        "bearing_node": bearing,
        "step_tolerance": settings.step_tolerance_m,
        "force_tolerance": settings.force_tolerance,
        "fast_iterations": settings.fast_iterations,
        "second_order": system.second_order,
    }
    values |= _masses(scene, by, columns)
    values |= _triangles(layout, by)
    values |= _hinges(layout, by)
    values |= _tetrahedra(layout, by)
    values |= _contacts(scene, by, columns)
    values |= _surfaces(scene, by, columns)
    values |= _edges(scene, by, columns)
    return values | _followers(scene)


def _collected(parts: dict[int, list[np.ndarray]], *shapes: tuple[int, ...]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Columns that have a block, and their blocks stacked. ``parts``: by column, arrays of the ``shapes``."""
    columns = sorted(parts)
    stacks = [
        np.stack([parts[c][k] for c in columns]) if columns else np.zeros((0, *shape)) for k, shape in enumerate(shapes)
    ]
    return np.array(columns, dtype=np.int32), stacks


def _masses(scene: Scene, by: NumberSlopes, columns: int) -> dict[str, Any]:
    """Mass, damping by mass and weight."""
    system, count = scene.system, len(scene.rest)
    mass = sp.csr_matrix(system.mass)
    mass.sum_duplicates()
    mass.sort_indices()
    rows = np.repeat(np.arange(count), np.diff(mass.indptr))

    def on_pattern(matrix: sp.csr_matrix) -> np.ndarray:
        return np.asarray(sp.csr_matrix(matrix)[rows, mass.indices]).ravel() if len(rows) else np.zeros(0)

    def whole(name: str, matrix: sp.csr_matrix) -> np.ndarray:
        """A matrix over the nodes of a body, over all, on the pattern."""
        nodes, part = scene.bodies[name].nodes, sp.coo_matrix(matrix)
        return on_pattern(sp.csr_matrix((part.data, (nodes[part.row], nodes[part.col])), shape=mass.shape))

    damping = np.zeros(len(rows))
    parts: dict[int, list[np.ndarray]] = {}
    external = np.zeros((count, 3, columns))

    def part(column: int) -> list[np.ndarray]:
        return parts.setdefault(column, [np.zeros(len(rows)), np.zeros(len(rows))])

    for term in system.terms:
        if isinstance(term, MassDamping):
            body = term.name.rpartition(".")[0]
            damping += whole(body, term.matrix)
            for quantity, slope in by.of(term.name):
                change = whole(body, term.matrix_by(quantity))
                for column in np.flatnonzero(slope).tolist():
                    part(column)[1] += slope[column] * change
    for k, (kind, owner, axis) in enumerate(by.keys):
        if kind == "gravity":
            pull = np.asarray(mass @ np.ones(count))
            external[:, "xyz".index(axis), : by.count] += pull[:, None] * by.table[k]
        built = scene.bodies.get(owner)
        if kind == "density" and built is not None and built.unit_mass is not None:
            change, weight = whole(owner, built.unit_mass), np.asarray(built.unit_mass @ np.ones(len(built.nodes)))
            external[built.nodes, :, : by.count] += weight[:, None, None] * system.gravity[:, None] * by.table[k]
            for column in np.flatnonzero(by.table[k]).tolist():
                part(column)[0] += by.table[k, column] * change
    changed, (d_mass, d_damping) = _collected(parts, (len(rows),), (len(rows),))
    return {
        "external": system.mass @ np.broadcast_to(system.gravity, (count, 3)) + system.loads,
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


def _elastic_slopes(
    term: Membrane | Bending, by: NumberSlopes
) -> list[tuple[np.ndarray, np.ndarray | None, np.ndarray | None]]:
    """By each number of a term that changes: its slopes ``(p,)``, the derivative of area times stiffness ``(m, 3, 3)``
    and that of damping ``(m,)``; None: zero."""
    found: list[tuple[np.ndarray, np.ndarray | None, np.ndarray | None]] = []
    for quantity, slope in by.of(term.name):
        if quantity == "stiffness_damping_s":
            found.append((slope, None, np.ones(len(term.areas))))
        elif term.grading is not None and quantity in term.grading.numbers:
            grown = term.areas * term.grading.by(quantity)
            found.append((slope, grown[:, None, None] * term.stiffness, None))
        else:
            found.append((slope, term.areas[:, None, None] * term.stiffness_by(quantity), None))
    return found


def _triangles(layout: Layout, by: NumberSlopes) -> dict[str, Any]:
    """Triangles that stretch."""
    terms = layout.membranes
    count = sum(len(t.triangles) for t in terms)
    parts: dict[int, list[np.ndarray]] = {}
    first = 0
    for term in terms:
        own = slice(first, first + len(term.triangles))
        first = own.stop
        for slope, stiffness, damping in _elastic_slopes(term, by):
            for column in np.flatnonzero(slope).tolist():
                part = parts.setdefault(column, [np.zeros((count, 3, 3)), np.zeros(count)])
                if stiffness is not None:
                    part[0][own] += slope[column] * stiffness
                if damping is not None:
                    part[1][own] += slope[column] * damping
    columns, (d_stiffness, d_damping) = _collected(parts, (count, 3, 3), (count,))
    return {
        "triangles": count,
        "triangle": np.vstack([t.triangles for t in terms] or [np.empty((0, 3))]),
        "hats": np.concatenate([t.hats() for t in terms] or [np.empty((0, 3, 2))]),
        "stretch_stiffness": np.concatenate(
            [t.areas[:, None, None] * t.stiffness for t in terms] or [np.empty((0, 3, 3))]
        ),
        "stretch_damping": np.concatenate([t.damping for t in terms] or [np.empty(0)]),
        "stretch_blocks": len(columns),
        "stretch_of": columns,
        "d_stretch_stiffness": d_stiffness,
        "d_stretch_damping": d_damping,
    }


def _hinges(layout: Layout, by: NumberSlopes) -> dict[str, Any]:
    """Hinges that bend, and how they are coupled: sum over triangles of B^T A D B, and of B^T A beta D B."""
    terms, pattern = layout.bendings, layout.pattern
    rows = np.repeat(np.arange(pattern.shape[0]), np.diff(pattern.indptr))

    def coupled(parts: list[np.ndarray]) -> np.ndarray:
        """On the pattern, of stiffnesses ``(m, 3, 3)`` of the triangles of all terms."""
        blocks = []
        for term, part in zip(terms, parts, strict=True):
            starts = np.arange(len(part) + 1)
            middle = sp.bsr_matrix((part, starts[:-1], starts), shape=(3 * len(part),) * 2)
            blocks.append(term.operator.T @ (middle @ term.operator))
        if not blocks:
            return np.zeros(0)
        return np.asarray(sp.block_diag(blocks).tocsr()[rows, pattern.indices]).ravel()

    stiffness = [t.areas[:, None, None] * t.stiffness for t in terms]
    none = [np.zeros_like(s) for s in stiffness]
    parts: dict[int, list[np.ndarray]] = {}
    for at, term in enumerate(terms):
        for slope, harder, damping in _elastic_slopes(term, by):
            changed, rubbed = list(none), list(none)
            if harder is not None:
                changed[at], rubbed[at] = harder, term.damping[:, None, None] * harder
            if damping is not None:
                rubbed[at] = rubbed[at] + damping[:, None, None] * stiffness[at]
            by_stiffness, by_damping = coupled(changed), coupled(rubbed)
            for column in np.flatnonzero(slope).tolist():
                part = parts.setdefault(column, [np.zeros(len(rows)), np.zeros(len(rows))])
                part[0] += slope[column] * by_stiffness
                part[1] += slope[column] * by_damping
    columns, (d_stiffness, d_damping) = _collected(parts, (len(rows),), (len(rows),))
    return {
        "hinges": pattern.shape[0],
        "couplings": len(rows),
        "hinge": np.vstack([t.hinge_nodes for t in terms] or [np.empty((0, 4))]),
        "rest_angle": np.concatenate([t.rest_angles for t in terms] or [np.empty(0)]),
        "coupling_start": pattern.indptr,
        "coupling_column": pattern.indices,
        "bend_stiffness": coupled(stiffness),
        "bend_damping": coupled([t.damping[:, None, None] * s for t, s in zip(terms, stiffness, strict=True)]),
        "bend_blocks": len(columns),
        "bend_of": columns,
        "d_bend_stiffness": d_stiffness,
        "d_bend_damping": d_damping,
    }


def _gel_slopes(term: NeoHookean, by: NumberSlopes) -> list[tuple[np.ndarray, np.ndarray]]:
    """By each number of a gel that changes: its slopes ``(p,)``, the derivatives of the numbers of the elements, and of
    the logarithm of their factor, ``(m, 5)``."""
    found = []
    for quantity, slope in by.of(term.name):
        change = np.zeros((len(term.tets), 5))
        if quantity == "stiffness_damping_s":
            change[:, 3] = 1.0
        elif term.grading is not None and quantity in term.grading.numbers:
            change[:, 4] = term.grading.by(quantity)
        else:
            change[:, :3] = apart(term.moduli_by(quantity))
        found.append((slope, change))
    return found


def _tetrahedra(layout: Layout, by: NumberSlopes) -> dict[str, Any]:
    """Tetrahedra of gels."""
    terms = layout.gels
    count, first = sum(len(t.tets) for t in terms), 0
    parts: dict[int, list[np.ndarray]] = {}
    for term in terms:
        own = slice(first, first + len(term.tets))
        first = own.stop
        for slope, change in _gel_slopes(term, by):
            for column in np.flatnonzero(slope).tolist():
                parts.setdefault(column, [np.zeros((count, 5))])[0][own] += slope[column] * change
    columns, (d_gel,) = _collected(parts, (count, 5))
    numbers = [np.column_stack([apart(t.moduli), t.damping]) for t in terms]
    return {
        "tetrahedra": count,
        "tetrahedron": np.vstack([t.tets for t in terms] or [np.empty((0, 10))]),
        "gel_gradient": np.concatenate([t.gradients for t in terms] or [np.empty((0, 10, 3))]),
        "gel_volume": np.concatenate([t.weights for t in terms] or [np.empty((0, 4))]),
        "gel_number": np.concatenate(numbers or [np.empty((0, 4))]),
        "gel_blocks": len(columns),
        "gel_of": columns,
        "d_gel": d_gel,
    }


def contacts_of(scene: Scene) -> list[RigidContact]:
    """Contacts with rigid shapes, in the order of the record."""
    return [t for t in scene.system.terms if isinstance(t, RigidContact)]


def _contacts(scene: Scene, by: NumberSlopes, columns: int) -> dict[str, Any]:
    """Contacts with rigid shapes."""
    terms, mounts = contacts_of(scene), list(scene.start)
    bodies = {int(b.nodes[0]): b.spec for b in scene.bodies.values() if isinstance(b.spec, Rigid)}
    specs = [bodies[t.body_node] for t in terms]
    corners, nodes, weights = _padded(terms)
    return {
        "contacts": len(terms),
        "samples": sum(len(t.samples.areas) for t in terms),
        "corners": corners,
        "sample_start": np.cumsum([0, *(len(t.samples.areas) for t in terms)]),
        "body_node": [t.body_node for t in terms],
        "body_mount": [mounts.index(spec.mount) for spec in specs],
        "body_rotation": [spec.pose.rotation().as_matrix() for spec in specs],
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
            for place, share in term.law_by(quantity).items():
                law[k, place, : by.count] += share * slope
    return law


def surfaces_of(scene: Scene) -> list[SurfaceContact]:
    """Contacts of surfaces, in the order of the record."""
    return [t for t in scene.system.terms if isinstance(t, SurfaceContact)]


def edges_of(scene: Scene) -> list[EdgeContact]:
    """Contacts of edges, in the order of the record."""
    return [t for t in scene.system.terms if isinstance(t, EdgeContact)]


def _surfaces(scene: Scene, by: NumberSlopes, columns: int) -> dict[str, Any]:
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
        "surface_triangle": np.vstack([t.triangles for t in terms] or [np.empty((0, 3))]),
        "surface_border": np.vstack([t.border for t in terms] or [np.empty((0, 6))]),
        "d_surface_law": _law_slopes(terms, by, columns),
    }


def _edges(scene: Scene, by: NumberSlopes, columns: int) -> dict[str, Any]:
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
        "edge_node": np.vstack([s.edges for s in sides] or [np.empty((0, 2))]),
        "edge_area": np.concatenate(areas or [np.empty(0)]),
        "edge_square": np.concatenate([s.squares for s in sides] or [np.empty(0)]),
        "d_edge_law": _law_slopes(terms, by, columns),
    }


def _followers(scene: Scene) -> dict[str, Any]:
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
