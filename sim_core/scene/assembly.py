"""Bodies of a rig as nodes, terms, masses and contact surfaces."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import reduce

import numpy as np
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from sim_core.contact.inner_primitives import cores
from sim_core.contact.samples import Samples, face_samples, face_triangles, sheet_samples
from sim_core.contact.shapes import BOX, CYLINDER, HALF_SPACE, SPHERE
from sim_core.energies.bending import Bending
from sim_core.energies.mass_damping import MassDamping
from sim_core.energies.membrane import Membrane
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.strain import strain_of
from sim_core.energies.strain_law import StrainLaws
from sim_core.energies.term import Term
from sim_core.errors import ConfigError
from sim_core.geometry import closed, sheets, solids
from sim_core.geometry.bisection import Refinement
from sim_core.geometry.folds import Fold, folded
from sim_core.geometry.subdivision import split_tets, split_triangles
from sim_core.rigs import Affine, Block, Disc, Dome, Gel, GelFile, Rectangle, Rig, Rigid, Sheet, SheetFile
from sim_core.rigs.bodies import WORLD


@dataclass
class BuiltBody:
    """One body of the scene.

    ``nodes``: indices among all nodes; ``local``: coordinates in the body's frame [m] in which the rig names regions
    and points, those of ``layout``; ``formed``: where the nodes are at rest, in that frame too, folded where the sheet
    is; ``rest``: the same in the world at the start [m]; ``drawn``: as ``rest``, by the rig alone, whatever shape was
    given since. ``mesh``: by which areas, volumes and masses are measured. ``unit_mass``: csr over the body's nodes,
    per unit density (a sheet: per unit density and thickness), without the elements that a mount holds wholly: these
    are part of it. None for rigid bodies, whose nodes are the origin and the points of their cores
    (:mod:`sim_core.contact.inner_primitives`). The last four nodes of an affine body are its control nodes
    (:mod:`sim_core.scene.joints`).
    """

    name: str
    spec: Sheet | Gel | Rigid | Affine
    nodes: np.ndarray
    local: np.ndarray
    formed: np.ndarray
    rest: np.ndarray
    drawn: np.ndarray
    mesh: sheets.SheetMesh | solids.TetMesh | None
    layout: sheets.SheetMesh | solids.TetMesh | None
    unit_mass: sp.csr_matrix | None
    outside: np.ndarray | None = None
    """Whether an element is not held wholly, bool ``(m,)``; None: none is."""
    terms: list[Term] = field(default_factory=list)
    rotation: np.ndarray = field(default_factory=lambda: np.eye(3))

    @property
    def control(self) -> np.ndarray:
        """Control nodes of an affine body."""
        return self.nodes[-4:]

    def place(self, points: np.ndarray) -> np.ndarray:
        """Rest coordinates in the body's frame [m] as world positions at the start."""
        return np.asarray(self.rest[0] + (points - self.local[0]) @ self.rotation.T)


def build_body(
    rig: Rig,
    name: str,
    carrier: tuple[np.ndarray, Rotation],
    offset: int,
    refine: int,
    given: np.ndarray | None = None,
) -> BuiltBody:
    """Mesh one body. ``offset``: index of its first node. ``refine``: factor on cells in each direction. ``given``:
    where the nodes of a sheet or a gel are at rest, in its frame [m], if not where the rig has them."""
    spec = rig.bodies[name]
    origin, rotation = spec.pose.within(carrier)
    mesh: sheets.SheetMesh | solids.TetMesh | None
    layout: sheets.SheetMesh | solids.TetMesh | None
    unit_mass = None
    if isinstance(spec, Sheet):
        mesh = _sheet_mesh(spec, refine, [part.region.box() for part in (*rig.clamps, *rig.loads) if part.body == name])
        local, layout = mesh.nodes, mesh
        mesh = layout if given is None else sheets.SheetMesh(given, layout.triangles)
        unit_mass = sp.diags(mesh.node_areas).tocsr()
    elif isinstance(spec, Gel):
        mesh = gel_mesh(spec, refine)
        local, layout = mesh.nodes, mesh
        mesh = layout if given is None else solids.TetMesh(given, layout.tets, layout.surface, layout.face_sets)
        unit_mass = solids.consistent_mass(mesh)
    elif isinstance(spec, Affine):
        mesh = layout = affine_mesh(spec, refine)
        volume, moments = affine_moments(spec)
        corners = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
        local = np.vstack([mesh.nodes, np.sqrt(moments / volume) * corners])
        shares = np.concatenate([np.zeros(len(mesh.nodes)), np.full(4, 0.25 * volume)])
        unit_mass = sp.diags(shares).tocsr()
    else:
        mesh = layout = None
        local = np.vstack([np.zeros((1, 3)), *(c.points for c in cores(rigid_shape(spec)))])
    formed = rest_form(spec, local)
    rest = drawn = origin + rotation.apply(formed)
    if given is not None:
        formed, rest = given, origin + rotation.apply(given)
    nodes = np.arange(offset, offset + len(local))
    body = BuiltBody(name, spec, nodes, local, formed, rest, drawn, mesh, layout, unit_mass)
    body.rotation[:] = rotation.as_matrix()
    return body


def rest_form(spec: Sheet | Gel | Rigid | Affine, local: np.ndarray) -> np.ndarray:
    """Where the points ``local`` of a body's mesh [m] ``(n, 3)`` are at rest, in its frame: elsewhere when folded."""
    if not (isinstance(spec, Sheet) and isinstance(spec.shape, Rectangle) and spec.shape.folds):
        return local
    across = np.unique(local[local[:, 1] == local[:, 1].min(), 0])  # nodes of the border, one a line
    bends = [Fold(f.at_m, float(np.deg2rad(f.angle_deg)), f.over_m or 0.0) for f in spec.shape.folds]
    return folded(local, across, bends)


def _sheet_mesh(spec: Sheet, refine: int, boxes: list[np.ndarray]) -> sheets.SheetMesh:
    """Mesh a sheet with lines of nodes along its creases and the edges of the boxes in which it is clamped or loaded
    (where it is a rectangle)."""
    shape = spec.shape
    if isinstance(shape, SheetFile):
        return split_triangles(shape.mesh(), refine)
    if isinstance(shape, Rectangle):
        cells = (shape.cells[0] * refine, shape.cells[1] * refine)
        edges = [sorted({float(v) for box in boxes for v in box[:, axis] if np.isfinite(v)}) for axis in (0, 1)]
        creases = {f.at_m for f in shape.folds if f.over_m is None}
        through = (tuple(sorted(creases.union(edges[0]))), tuple(edges[1]))
        return sheets.rectangle(shape.length_m, shape.width_m, cells, shape.pattern, through_m=through)
    holes = tuple(np.asarray(h) for h in shape.holes_m)
    return sheets.outline(np.asarray(shape.polygon_m), shape.edge_m / refine, holes)


def gel_mesh(spec: Gel, refine: int) -> solids.TetMesh:
    """Mesh of a gel in its frame; ``refine``: factor on cells in each direction."""
    shape = spec.shape
    if isinstance(shape, GelFile):
        if refine & (refine - 1):
            raise ConfigError(
                f"A mesh of tetrahedra can be refined by 2, 4, 8, ..., not by {refine}.", "Choose one of these."
            )
        return reduce(lambda mesh, _: split_tets(mesh), range(refine.bit_length() - 1), shape.mesh())
    a, b, c = (count * refine for count in shape.cells)
    raised = np.zeros(3) if isinstance(shape, Dome) else np.array([0.0, 0.0, -shape.bounds()[0, 2]])
    boxes = [Refinement(region.box() + raised, region.edge_m / refine) for region in shape.refine]
    how = (shape.ratios, shape.cut, boxes)
    if isinstance(shape, Block):
        mesh = solids.block(shape.size_m, (a, b, c), *how)
    elif isinstance(shape, Disc):
        mesh = solids.cylinder(shape.radius_m, shape.height_m, (a, b, c), *how)
    else:
        mesh = solids.dome(shape.radius_m, shape.cavity_radius_m, (a, b, c), *how)
    return solids.TetMesh(mesh.nodes - raised, mesh.tets, mesh.surface, mesh.face_sets)


def affine_mesh(spec: Affine, refine: int) -> sheets.SheetMesh:
    """Surface of an affine body."""
    shape = spec.shape
    if shape.type == "sphere":
        return closed.sphere(shape.radius_m, (spec.edge_m or 0.2 * shape.radius_m) / refine)
    if shape.type == "cylinder":
        return closed.cylinder(shape.radius_m, shape.length_m, (spec.edge_m or 0.2 * shape.radius_m) / refine)
    return closed.box(shape.size_m, (spec.edge_m or max(shape.size_m)) / refine)


def affine_moments(spec: Affine) -> tuple[float, np.ndarray]:
    """Volume [m^3] of an affine body and the integrals of x^2, y^2, z^2 over it [m^5] ``(3,)``."""
    shape = spec.shape
    if shape.type == "sphere":
        return closed.sphere_moments(shape.radius_m)
    if shape.type == "cylinder":
        return closed.cylinder_moments(shape.radius_m, shape.length_m)
    return closed.box_moments(shape.size_m)


def leave_to_mount(body: BuiltBody, inside: np.ndarray) -> None:
    """Take the elements whose nodes are all ``inside`` what holds them, bool over the nodes, out of the body's mass."""
    held = inside[elements(body)].all(axis=1)
    if held.any():
        body.outside = ~held if body.outside is None else body.outside & ~held
        body.unit_mass = mass_of(body, body.outside.astype(float))


def elements(body: BuiltBody) -> np.ndarray:
    """Nodes of the elements of a sheet or a gel among those of the body."""
    if isinstance(body.mesh, solids.TetMesh):
        return body.mesh.tets
    assert isinstance(body.mesh, sheets.SheetMesh)
    return body.mesh.triangles


def mass_of(body: BuiltBody, factor: np.ndarray) -> sp.csr_matrix:
    """Mass of a sheet or a gel per unit of density, of each element times its factor ``(m,)``."""
    if isinstance(body.mesh, sheets.SheetMesh):
        return sp.diags(body.mesh.shared(factor * body.mesh.areas)).tocsr()
    assert isinstance(body.mesh, solids.TetMesh)
    return solids.consistent_mass(body.mesh, factor)


def add_terms(body: BuiltBody, rest: np.ndarray, held: np.ndarray, loose: np.ndarray) -> None:
    """Elastic terms and damping of a sheet or a gel. ``rest``: all nodes [m]; ``held``, ``loose``: bool, nodes of the
    body in one clamp, and those not wholly prescribed."""
    if isinstance(body.spec, Sheet) and isinstance(body.mesh, sheets.SheetMesh):
        if body.mesh is body.layout:
            world, axis = sheets.SheetMesh(body.place(body.local), body.mesh.triangles), body.rotation[:, 0]
        else:
            world, axis = sheets.SheetMesh(body.rest, body.mesh.triangles), grain(body)
        offset = int(body.nodes[0])
        flat = rest.copy()
        flat[body.nodes] = world.nodes
        body.terms = [
            Membrane(f"{body.name}.membrane", flat, body.mesh.triangles + offset, axis),
            Bending(f"{body.name}.bending", world, offset, axis, body.rest, held=held),
        ]
    elif isinstance(body.mesh, solids.TetMesh):
        body.terms = [NeoHookean(f"{body.name}.elastic", body.mesh.tets + int(body.nodes[0]), rest)]
    if body.unit_mass is not None:
        body.terms.append(MassDamping(f"{body.name}.mass_damping", body.unit_mass, int(body.nodes[0]), loose))


def strain_laws(own: Membrane | Bending | NeoHookean) -> StrainLaws:
    """The term of the material laws that effects add to the ``own`` term of a sheet or a gel."""
    return StrainLaws(f"{own.name}_laws", strain_of(own))


def grain(body: BuiltBody) -> np.ndarray:
    """Material direction 1 of the triangles of a sheet as the rig has it at rest, in the world, ``(m, 3)``: along the
    body's x axis, and turned with the triangle where the sheet is folded, though not where it comes from a mesh file.
    What is normal to it does not count in another shape at rest."""
    assert isinstance(body.layout, sheets.SheetMesh)
    triangles = body.layout.triangles
    if isinstance(body.spec.shape, SheetFile):
        return np.tile(body.rotation[:, 0], (len(triangles), 1))
    flat, sides = (x[triangles[:, 1:]] - x[triangles[:, :1]] for x in (body.local, body.drawn))
    return np.asarray(np.einsum("mki,mk->mi", sides, np.linalg.inv(flat[..., :2].transpose(0, 2, 1))[..., 0]))


def element_middles(body: BuiltBody) -> np.ndarray:
    """Middles of the elements of a sheet or a gel where the rig has them, in the body's frame [m] ``(m, 3)``."""
    assert body.mesh is not None
    corners = body.mesh.triangles if isinstance(body.mesh, sheets.SheetMesh) else body.mesh.tets[:, :4]
    return np.asarray(body.local[corners].mean(axis=1))


def contact_samples(body: BuiltBody, rest: np.ndarray, on_round: bool = False) -> Samples:
    """Where a body is tested for contact (a gel: on the faces that are neither bonded nor planes of symmetry).
    ``on_round``: with a rigid shape that is curved."""
    if isinstance(body.mesh, sheets.SheetMesh):
        is_sheet = isinstance(body.spec, Sheet)
        thickness = body.spec.material.thickness_m if isinstance(body.spec, Sheet) else 0.0
        return sheet_samples(body.mesh, int(body.nodes[0]), thickness, divided=on_round and is_sheet)
    return face_samples(_free_faces(body), rest)


def contact_triangles(body: BuiltBody) -> np.ndarray:
    """Linear triangles of a body's surface, in nodes of the scene."""
    if isinstance(body.mesh, sheets.SheetMesh):
        return np.asarray(body.mesh.triangles + int(body.nodes[0]), dtype=np.int32)
    return face_triangles(_free_faces(body))


def _free_faces(body: BuiltBody) -> np.ndarray:
    assert isinstance(body.mesh, solids.TetMesh) and isinstance(body.spec, Gel)
    keep = np.ones(len(body.mesh.surface), dtype=bool)
    inner = [f"{axis}_cut" for axis in body.spec.shape.symmetry]
    for face in inner if body.spec.bonded is None else [*inner, body.spec.bonded]:
        keep[body.mesh.face_sets[face]] = False
    return np.asarray(body.mesh.surface[keep] + int(body.nodes[0]))


def rigid_shape(spec: Rigid) -> np.ndarray:
    """Parameters of the signed distance of :mod:`sim_core.contact.shapes`."""
    shape = spec.shape
    if shape.type == "sphere":
        values = [SPHERE, shape.radius_m]
    elif shape.type == "cylinder":
        values = [CYLINDER, shape.radius_m, 0.5 * shape.length_m, shape.edge_radius]
    elif shape.type == "box":
        values = [BOX, *(0.5 * s for s in shape.size_m), shape.edge_radius]
    else:
        values = [HALF_SPACE]
    return np.asarray(values + [0.0] * (5 - len(values)), dtype=float)


@dataclass(frozen=True)
class Held:
    """What holds some nodes of a body. ``inside``: bool over its nodes; ``axes``: which of the world's axes; ``mount``:
    what they follow."""

    inside: np.ndarray
    axes: tuple[bool, bool, bool]
    mount: str


def held_nodes(rig: Rig, body: BuiltBody) -> dict[str, Held]:
    """Nodes of a deformable body that follow a mount, by holder (plane of symmetry, clamp or bond)."""
    holders = _planes_of_symmetry(body) if isinstance(body.spec, Gel) else {}
    for index, clamp in enumerate(rig.clamps):
        if clamp.body == body.name:
            inside = clamp.region.contains(body.local)
            label = clamp.name or f"clamps[{index}]"
            if not inside.any():
                raise ConfigError(
                    f"The clamp {label} holds no node of {body.name}.",
                    "Widen its region, or give the body more cells there.",
                )
            lined = isinstance(body.mesh, sheets.SheetMesh) and not inside[body.mesh.triangles].all(axis=1).any()
            if clamp.axes is None and lined:
                raise ConfigError(
                    f"The clamp {label} holds a line of nodes of {body.name}, which lets it turn like a hinge.",
                    "Widen its region so that it holds at least one whole cell, give the sheet more cells, or write "
                    "'axes: [x, y, z]' if a hinge is what you want.",
                )
            holders[label] = Held(inside, clamp.held, clamp.mount)
    if isinstance(body.spec, Gel) and body.spec.bonded is not None and body.spec.mount is not None:
        assert isinstance(body.mesh, solids.TetMesh)
        glued = np.zeros(len(body.local), dtype=bool)
        glued[body.mesh.node_sets[body.spec.bonded]] = True
        holders[f"{body.name}.bond"] = Held(glued, (True, True, True), body.spec.mount)
    return holders


def _planes_of_symmetry(body: BuiltBody) -> dict[str, Held]:
    """Nodes of a gel on its planes of symmetry, which they do not leave. The normals must be axes of the world, as
    components of positions are held along those only."""
    assert isinstance(body.spec, Gel) and isinstance(body.mesh, solids.TetMesh)
    holders = {}
    for letter, axis in zip(body.spec.shape.symmetry, body.spec.shape.cut, strict=True):
        normal = np.abs(body.rotation[:, axis])
        along = int(np.argmax(normal))
        if normal[along] < 1.0 - 1e-9:
            raise ConfigError(
                f"The plane of symmetry of {body.name} normal to its {letter} axis is not normal to an axis of the "
                f"world at the start: its normal is {np.array2string(body.rotation[:, axis], precision=4)}.",
                "Turn the body, or its mount at the start, by multiples of 90 degrees, or simulate the whole of it.",
            )
        inside = np.zeros(len(body.local), dtype=bool)
        inside[body.mesh.node_sets[f"{letter}_cut"]] = True
        held = (along == 0, along == 1, along == 2)
        holders[f"{body.name}.{letter}_cut"] = Held(inside, held, body.spec.mount or WORLD)
    return holders
