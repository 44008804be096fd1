"""The terms that make a contact of two bodies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim_core.contact.edges import EDGE_RANGE, EdgeContact
from sim_core.contact.inner_primitives import Core, cores
from sim_core.contact.intersection_check import cross
from sim_core.contact.rigid import RigidContact
from sim_core.contact.samples import Samples, edge_shares, triangle_edges
from sim_core.contact.start_depth import distances, over_triangles
from sim_core.contact.surface import SurfaceContact
from sim_core.errors import ConfigError
from sim_core.rigs import Gel, Rig, Rigid, Sheet
from sim_core.rigs.schema import Contact
from sim_core.scene.assembly import BuiltBody, contact_samples, contact_triangles, rigid_shape
from sim_core.scene.contact_constants import OF_OFFSET, ContactConstants

ContactTerm = RigidContact | SurfaceContact | EdgeContact

START_DEPTH, LEAST_DEPTH_M = 0.1, 1e-4
"""How deep gels may be pressed in where they start, in mesh sizes, and what is none of depth [m]."""

SAME_PLACE = 0.1
"""Distance of two sheets at the start, over that at which they touch, below which they are in one place."""

MARGIN = 0.5
"""How much wider than a step needs partners are looked for, in mesh sizes: a few steps of motion."""


def contact_of_surfaces(
    name: str, a: BuiltBody, b: BuiltBody, rest: np.ndarray, drawn: np.ndarray
) -> list[ContactTerm]:
    """Contact of two bodies that are simulated, or of one with itself: points and faces both ways, edges and edges.

    Against a sheet the points of a gel bear as they do against what is rigid, and those of the sheet only where they
    fail: few and large points of a sheet would dent the gel, and a fine sheet's would let the gel's border tuck under.

    ``rest``: all nodes at rest [m] ``(n, 3)``; ``drawn``: as the rig has them, of which typical sizes are taken.
    """
    ours, theirs = contact_samples(a, rest), contact_samples(b, rest)
    triangles, their_triangles = contact_triangles(a), contact_triangles(b)
    edges, areas = triangle_edges(triangles, rest)
    offset, margin = ours.offset + theirs.offset, MARGIN * min(_cell(triangles, drawn), _cell(their_triangles, drawn))
    if a is b:
        _check_cells(a, triangles, rest, offset)
        return [
            SurfaceContact(f"{name}.faces", ours, triangles, offset, margin),
            EdgeContact(f"{name}.edges", edges, areas, None, None, rest, offset, margin, [edge_shares(triangles)]),
        ]
    their_edges, their_areas = triangle_edges(their_triangles, rest)
    _check_apart(a, b, rest, triangles, their_triangles, offset)
    if cross(rest, edges, their_triangles) or cross(rest, their_edges, triangles):
        raise ConfigError(
            f"{a.name} and {b.name} go through each other at the start, and their contact could not part them.",
            "Move one of them until they are apart.",
        )
    shares = [edge_shares(triangles), edge_shares(their_triangles)]
    on_gel = any(isinstance(body.spec, Gel) for body in (a, b))
    bearing = [EDGE_RANGE if on_gel and isinstance(body.spec, Sheet) else 1.0 for body in (a, b)]
    return [
        SurfaceContact(f"{name}.0", ours, their_triangles, offset, margin, bearing[0]),
        SurfaceContact(f"{name}.1", theirs, triangles, offset, margin, bearing[1]),
        EdgeContact(f"{name}.edges", edges, areas, their_edges, their_areas, rest, offset, margin, shares),
    ]


def contact_with_rigid(name: str, a: BuiltBody, b: BuiltBody, rest: np.ndarray, drawn: np.ndarray) -> list[ContactTerm]:
    """Contact of a simulated body with a rigid one: its points with the shape, its faces and edges with the core, whose
    points stand for as much area as is typical of the body's (``rest``, ``drawn``: as above)."""
    assert isinstance(b.spec, Rigid)
    triangles, shape = contact_triangles(a), rigid_shape(b.spec)
    samples = contact_samples(a, rest, on_round=any(core.round for core in cores(shape)))
    _check_outside(a, b, rest, triangles, samples.offset, shape)
    edges, areas = triangle_edges(triangles, rest)
    cell, typical = _cell(triangles, drawn), float(np.median(contact_samples(replace(a, mesh=a.layout), drawn).areas))
    terms: list[ContactTerm] = [RigidContact(name, samples, int(b.nodes[0]), shape, b.rotation)]
    first = int(b.nodes[0]) + 1
    for k, core in enumerate(cores(shape)):
        offset = samples.offset + core.reach(_facet(a, cell, core))
        count = len(core.points)
        points = Samples(
            np.arange(first, first + count, dtype=np.int32)[:, None],
            np.ones((count, 1)),
            np.full(count, typical),
            0.0,
        )
        margin = MARGIN * cell
        terms.append(
            SurfaceContact(f"{name}.core{k}.points", points, triangles, offset, margin, EDGE_RANGE, stops=core.round)
        )
        if len(core.edges):
            sides = (edges, areas, core.edges + first, None)
            shares = [edge_shares(triangles)]
            terms.append(EdgeContact(f"{name}.core{k}.edges", *sides, rest, offset, margin, shares, stops=core.round))
        first += count
    return terms


def _facet(body: BuiltBody, cell: float, core: Core) -> float:
    """Length [m] of flat pieces between neighbouring samples of a surface on a round shape, 0 where flat is true: so is
    a sheet with cells that are coarse compared with the shape, and lies on it with what is between its samples."""
    if isinstance(body.spec, Gel):
        return cell
    return 0.5 * cell if isinstance(body.spec, Sheet) and cell < core.offset else 0.0


def _check_outside(
    a: BuiltBody, b: BuiltBody, rest: np.ndarray, triangles: np.ndarray, offset: float, shape: np.ndarray
) -> None:
    """A body does not start inside a rigid one, deeper than sheets are thick or gels may be pressed in."""
    corners = rest[triangles]
    middles = [corners.mean(axis=1), *(0.5 * (corners[:, k] + corners[:, k - 1]) for k in range(3))]
    points = np.vstack([rest[np.unique(triangles)], *middles])
    depth = offset - float(distances((points - rest[b.nodes[0]]) @ b.rotation, shape).min())
    allowed = START_DEPTH * _cell(triangles, rest) if isinstance(a.spec, Gel) else 2.0 * offset
    if depth > offset + max(allowed, LEAST_DEPTH_M):
        raise ConfigError(
            f"{a.name} starts inside {b.name}, {1e3 * depth:.3g} mm deep, and contact would push it out.",
            f"Move {a.name} or {b.name} until they are apart, or take their contact out of the rig.",
        )


def _check_apart(
    a: BuiltBody, b: BuiltBody, rest: np.ndarray, triangles: np.ndarray, theirs: np.ndarray, offset: float
) -> None:
    """Two sheets do not start in the same place: none of them would be on a side of the other."""
    if not all(isinstance(body.spec, Sheet) for body in (a, b)):
        return
    pairs = ((triangles, theirs), (theirs, triangles))
    apart = min(over_triangles(rest[np.unique(own)], rest[other]) for own, other in pairs)
    if apart < SAME_PLACE * offset:
        raise ConfigError(
            f"{a.name} and {b.name} start in the same place: {1e3 * apart:.3g} mm apart where both together are "
            f"{2e3 * offset:.3g} mm thick, and contact could not tell which is on which side.",
            f"Move one of them until their middles are {1e3 * offset:.3g} mm apart.",
        )


def bearing_surfaces(contact: Contact, terms: Sequence[ContactTerm]) -> int:
    """Number of surfaces whose points bear a contact with these terms; they share its stiffness."""
    one, other = contact.between
    return 2 if one == other else max(1, sum(isinstance(t, SurfaceContact) and t.bearing == 1.0 for t in terms))


def half_thicknesses(rig: Rig, contact: Contact) -> float:
    """Half thicknesses [m] of the sheets on both sides of a contact together."""
    sides = (rig.bodies[b] for b in contact.between)
    return sum(0.5 * side.material.thickness_m for side in sides if isinstance(side, Sheet))


def without_gap(term: ContactTerm, offset: float, law: ContactConstants) -> float:
    """Distance [m] at which a term has no gap, of surfaces that are ``offset`` [m] apart where they touch: nearer by
    what the law keeps them apart. The distance of two surfaces has no sign, so there it stays positive."""
    if isinstance(term, RigidContact):
        return offset - law.displacement_m
    if term.stops:
        return offset
    return offset - min(law.displacement_m, OF_OFFSET * offset)


def _cell(triangles: np.ndarray, rest: np.ndarray) -> float:
    """Typical length [m] of the edges of a surface."""
    corners = rest[triangles]
    return float(np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)))


def _check_cells(body: BuiltBody, triangles: np.ndarray, rest: np.ndarray, offset: float) -> None:
    """Points of a sheet that are neighbours must be further apart than it is thick, or it would touch itself flat."""
    corners = rest[triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    height = float((area / sides.max(axis=1)).min())
    if height <= 1.5 * offset:
        raise ConfigError(
            f"The contact of {body.name} with itself needs cells that are larger than it is thick: the "
            f"lowest triangle is {1e3 * height:.3g} mm high, the sheet {1e3 * offset:.3g} mm thick.",
            "Use fewer cells, or leave this contact out.",
        )
