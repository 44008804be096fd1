"""Solid bodies as meshes of quadratic tetrahedra: blocks, cylinders, hollow domes, and halves and quarters of them.

All builders start from hexahedra whose corners carry the two colours of a checkerboard, and cut each
into five tetrahedra: one spanned by the four even corners, and one for each odd corner. A face shared
by two hexahedra is then cut along the same diagonal (between its even corners), and neighbours are
mirror images of each other, so the mesh has no preferred diagonal direction.

Cells may be graded along the directions of a shape: their widths then grow by the same factor from cell to cell.
Beyond that, boxes may be refined (:mod:`sim_core.geometry.bisection`). ``cut``: axes (0: x, 1: y) normal to planes of
symmetry through the origin; of the body only the part with positive coordinates is meshed, and the faces on those
planes are the sets x_cut and y_cut.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from sim_core.errors import ConfigError
from sim_core.geometry import tet10
from sim_core.geometry.bisection import Middle, Refinement, bisected
from sim_core.geometry.lattice import check_positive, core_and_ring_shares, core_and_rings, graded_lines, grid

_AROUND = ((1, 3, 4), (0, 2, 5), (1, 3, 6), (0, 2, 7), (0, 5, 7), (1, 4, 6), (2, 5, 7), (3, 4, 6))
"""The three neighbours of each corner of a hexahedron (0 1 2 3 below, 4 5 6 7 above)."""


@dataclass(frozen=True)
class TetMesh:
    """A solid body at rest.

    ``nodes``: rest positions [m], ``(n, 3)``. ``tets``: int32 ``(m, 10)``, order of
    :mod:`sim_core.geometry.tet10`. ``surface``: boundary faces, int32 ``(k, 6)``: corners a, b, c with
    the normal outward, then the mid-edges ab, bc, ca. ``face_sets``: rows of ``surface`` by name;
    ``node_sets``: the nodes on those faces by name.
    """

    nodes: np.ndarray
    tets: np.ndarray
    surface: np.ndarray
    face_sets: Mapping[str, np.ndarray]
    node_sets: Mapping[str, np.ndarray] = field(init=False)

    def __post_init__(self) -> None:
        sets = {name: np.unique(self.surface[rows]).astype(np.int32) for name, rows in self.face_sets.items()}
        object.__setattr__(self, "node_sets", sets)
        check_quality(self.nodes, self.tets)


def check_quality(nodes: np.ndarray, tets: np.ndarray) -> None:
    """Raise unless the map from the reference element is orientation-preserving where it is sampled.

    ``nodes``: ``(n, 3)`` [m]; ``tets``: ``(m, 10)``. Sampled at the quadrature points and the corners.
    """
    points = np.concatenate([tet10.four_point_rule()[0], np.eye(4)])
    det = np.linalg.det(tet10.jacobian(nodes[tets], points)).min(axis=1)
    worst = int(np.argmin(det))
    if not det[worst] > 0.0:
        centre = nodes[tets[worst, :4]].mean(axis=0)
        raise ConfigError(
            f"Element {worst} at {np.array2string(centre, precision=6)} m is turned inside out or flat:"
            f" its smallest Jacobian determinant is {det[worst]:.3g} m^3, {np.sum(det <= 0.0)} of"
            f" {len(tets)} elements are affected.",
            "Use more cells, less grading, or dimensions with a less extreme aspect ratio.",
        )


def volume(mesh: TetMesh) -> float:
    """Volume of the body [m^3], exact for the curved elements."""
    points, weights = tet10.conical_rule(2)
    return float((np.linalg.det(tet10.jacobian(mesh.nodes[mesh.tets], points)) @ weights).sum())


def element_masses(mesh: TetMesh) -> np.ndarray:
    """Consistent mass of each element per unit density, integral of N_a N_b dV: ``(m, 10, 10)`` [m^3].

    The quadrature is exact to degree 7, which covers curved elements. The matrix for three components
    is its Kronecker product with the 3 x 3 identity, times the density [kg/m^3].
    """
    points, weights = tet10.conical_rule(4)
    det = np.linalg.det(tet10.jacobian(mesh.nodes[mesh.tets], points))
    n = tet10.shape(points)
    return np.asarray(np.einsum("q,mq,qa,qb->mab", weights, det, n, n, optimize=True))


def consistent_mass(mesh: TetMesh, density: np.ndarray | float = 1.0) -> csr_matrix:
    """Mass of all elements together: sparse ``(n, n)``. ``density``: of each element ``(m,)``, or of all."""
    local = element_masses(mesh) * np.broadcast_to(density, len(mesh.tets))[:, None, None]
    rows = np.repeat(mesh.tets, 10, axis=1).ravel()
    columns = np.tile(mesh.tets, (1, 10)).ravel()
    return coo_matrix((local.ravel(), (rows, columns)), shape=(len(mesh.nodes),) * 2).tocsr()


def locate(mesh: TetMesh, points: np.ndarray, tolerance: float = 1e-6) -> tuple[np.ndarray, np.ndarray]:
    """Find material points inside the body or on its surface.

    ``points``: rest positions ``(p, 3)`` [m]. Returns the element of each, int32 ``(p,)``, and the
    shape-function weights of its ten nodes, ``(p, 10)``, so that ``weights[i] @ x[tets[element[i]]]``
    follows point ``i``. A point may lie outside by ``tolerance`` times the size of its element (the
    quadratic facets of a curved surface differ a little from the surface itself); the weights then
    extrapolate and still reproduce the point exactly.
    """
    points = np.atleast_2d(np.asarray(points, dtype=float))
    corners = mesh.nodes[mesh.tets]
    # A quadratic element bulges at most by its nodes' spread; the margin of 1/4 of the extent covers it.
    extent = np.ptp(corners, axis=1).max(axis=1, keepdims=True)
    low = corners.min(axis=1) - (0.25 + tolerance) * extent
    high = corners.max(axis=1) + (0.25 + tolerance) * extent
    element = np.full(len(points), -1, dtype=np.int32)
    weights = np.zeros((len(points), 10))
    near = [np.flatnonzero(np.all((low <= point) & (point <= high), axis=1)) for point in points]
    counts = [len(elements) for elements in near]
    candidates = np.concatenate([np.zeros(0, dtype=int), *near])
    barycentric = _invert(corners[candidates], np.repeat(points, counts, axis=0))
    end = np.cumsum(counts)
    for p in np.flatnonzero(counts):
        own = slice(end[p] - counts[p], end[p])
        best = own.start + int(np.argmax(barycentric[own].min(axis=1)))
        if barycentric[best].min() >= -tolerance:
            element[p] = candidates[best]
            weights[p] = tet10.shape(barycentric[best : best + 1])[0]
    missing = np.flatnonzero(element < 0)
    if len(missing):
        first = ", ".join(f"{i} at {np.array2string(points[i], precision=6)} m" for i in missing[:5])
        raise ConfigError(
            f"{len(missing)} of {len(points)} points lie outside the body: {first}"
            f"{', ...' if len(missing) > 5 else ''}.",
            f"Move them inside, or allow more than a share {tolerance:g} of an element outside.",
        )
    return element, weights


def locate_pins(
    mesh: TetMesh, points: np.ndarray, feet: np.ndarray, tolerance: float = 1e-6
) -> tuple[np.ndarray, np.ndarray]:
    """Follow points off the body as the tips of pins that stand on it, ``(p, 3)`` each, rest positions [m].

    A tip goes on as the body does at its foot, ``x(tip) = x(foot) + F(foot) (tip - foot)`` with the deformation
    gradient F: it moves and turns with the surface. Returns element and weights as :func:`locate`, whose ``tolerance``
    is for the feet.
    """
    element, weights = locate(mesh, feet, tolerance)
    nodes = mesh.nodes[mesh.tets[element]]
    slopes = tet10.shape_derivative(_invert(nodes, feet))
    off = np.linalg.solve(np.swapaxes(nodes, 1, 2) @ slopes, (points - feet)[:, :, None])
    weights += (slopes @ off)[:, :, 0]
    return element, weights


def _invert(elements: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric ``(m, 4)`` of each of the ``points`` ``(m, 3)`` in its element ``(m, 10, 3)``; -inf where there are
    none."""
    local, miss = np.full((len(elements), 3), 0.25), np.full(len(elements), np.inf)
    scale, left = np.ptp(elements, axis=1).max(axis=1), np.arange(len(elements))
    for _ in range(30):
        barycentric = _with_first(local[left])
        error = np.einsum("ma,mai->mi", tet10.shape(barycentric), elements[left]) - points[left]
        miss[left] = np.linalg.norm(error, axis=1) / scale[left]
        far = miss[left] >= 1e-14
        left, error, barycentric = left[far], error[far], barycentric[far]
        if not len(left):
            break
        jac = np.einsum("mai,maj->mij", elements[left], tet10.shape_derivative(barycentric))
        singular = np.abs(np.linalg.det(jac)) < 1e-12 * scale[left] ** 3
        jac[singular] = np.eye(3)
        step = np.linalg.solve(jac, error[:, :, None])[:, :, 0]
        step[singular] = 0.0
        local[left] -= step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
    barycentric = _with_first(local)
    barycentric[miss > 1e-10] = -np.inf
    return barycentric


def _with_first(local: np.ndarray) -> np.ndarray:
    """All four barycentric coordinates ``(m, 4)`` from the last three of them."""
    return np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)


def block(
    size_m: tuple[float, float, float],
    cells: tuple[int, int, int],
    towards: Mapping[str, float] | None = None,
    cut: Collection[int] = (),
    refine: Sequence[Refinement] = (),
) -> TetMesh:
    """A box, centred on the z axis, from z = 0 up.

    ``cells``: hexahedra along x, y, z of the whole box, five tetrahedra each. ``towards``: by place (a face, x_middle,
    y_middle or z_middle), the width of the cells there over that of those farthest from it (below 1: finer there).
    Sets: bottom, top, x_min, x_max, y_min, y_max.
    """
    check_positive(size_m=size_m, cells=cells)
    _check_even(cut, cells[:2])
    spaced = graded_lines(size_m, cells, towards or {})
    flat, quads, parity = grid(*cells[:2])
    layers = [
        np.column_stack([spaced[0][flat[:, 0]], spaced[1][flat[:, 1]], np.full(len(flat), height)])
        for height in spaced[2] + size_m[2] / 2.0
    ]

    def sets(p: np.ndarray) -> dict[str, np.ndarray]:
        tiny = 1e-9 * max(size_m)
        found = {"bottom": p[..., 2] < tiny, "top": p[..., 2] > size_m[2] - tiny}
        for axis, letter in enumerate("xy"):
            if axis not in cut:
                found[f"{letter}_min"] = p[..., axis] < -size_m[axis] / 2.0 + tiny
            found[f"{letter}_max"] = p[..., axis] > size_m[axis] / 2.0 - tiny
        return found

    return _extrude(layers, quads, parity, _half_way, sets, cut, refine)


def cylinder(
    radius_m: float,
    height_m: float,
    cells: tuple[int, int, int],
    towards: Mapping[str, float] | None = None,
    cut: Collection[int] = (),
    refine: Sequence[Refinement] = (),
    curved: bool = True,
) -> TetMesh:
    """A solid cylinder or disc around the z axis, from z = 0 up.

    ``cells``: hexahedra along a side of the square core, from the core to the rim, and along the height. ``towards``:
    as of a block, by place: bottom, top, axis, side. ``curved``: put the mid-edge nodes of the rim on the circle. Sets:
    bottom, top, side.
    """
    check_positive(radius_m=(radius_m,), height_m=(height_m,), cells=cells)
    n, rings, nz = cells
    _check_even(cut, (n, n))
    given = dict(towards or {})
    square, ring, quads, parity = core_and_rings(n, rings)
    ratio = given.pop("axis", 1.0) / given.pop("side", 1.0)
    outward = core_and_ring_shares(n, rings, ratio)
    core, rim = 0.9 * radius_m * outward[0], radius_m
    share = np.interp(ring, np.linspace(0.0, 1.0, rings + 1), (outward - outward[0]) / (1.0 - outward[0]))
    flat = (1.0 - share) * core * square + share * rim * _unit(np.tan(np.pi / 4.0 * square))
    heights = graded_lines((1.0, 1.0, height_m), (1, 1, nz), given)[2] + height_m / 2.0
    layers = [np.column_stack([flat, np.full(len(flat), z)]) for z in heights]
    tiny = 1e-9 * max(radius_m, height_m)

    def middle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        mid: np.ndarray = _half_way(a, b)
        if curved:
            rim = _on_side(a) & _on_side(b)
            mid[rim, :2] = radius_m * _unit(mid[rim, :2])
        return mid

    def _on_side(p: np.ndarray) -> np.ndarray:
        on: np.ndarray = np.hypot(p[..., 0], p[..., 1]) > radius_m - tiny
        return on

    def sets(p: np.ndarray) -> dict[str, np.ndarray]:
        return {"bottom": p[..., 2] < tiny, "top": p[..., 2] > height_m - tiny, "side": _on_side(p)}

    return _extrude(layers, quads, parity, middle, sets, cut, refine)


def dome(
    radius_m: float,
    cavity_radius_m: float,
    cells: tuple[int, int, int],
    towards: Mapping[str, float] | None = None,
    cut: Collection[int] = (),
    refine: Sequence[Refinement] = (),
    curved: bool = True,
) -> TetMesh:
    """A hollow half ball, like a tactile fingertip: flat rim at z = 0, pole on +z.

    Half of a cubed sphere (Ronchi, Iacono and Paolucci, J. Comput. Phys. 124, 1996): a square cap
    around the pole and rings from there to the rim, with no degenerate cell. ``cells``: hexahedra along
    a side of the cap, from the cap to the rim, and through the wall; a good shape has twice as many in
    the first as in the second. ``towards``: as of a block, by place: outer, inner. ``curved``: put mid-edge nodes on
    spheres (the volume of (2, 1, 1) is then 0.8 % low, of (4, 2, 2) 0.05 %). Sets: base (the rim), outer, inner (the
    wall of the cavity).
    """
    check_positive(radius_m=(radius_m,), cavity_radius_m=(cavity_radius_m,), cells=cells)
    if not cavity_radius_m < radius_m:
        raise ConfigError(
            f"The cavity radius {cavity_radius_m} m is not below the outer radius {radius_m} m.",
            "Give a cavity that fits into the dome.",
        )
    n, rings, n_wall = cells
    _check_even(cut, (n, n))
    square, ring, quads, parity = core_and_rings(n, rings)
    half_angle = np.pi / 2.0 * n / (n + 2.0 * rings)
    cap = _unit(np.column_stack([np.tan(half_angle * square), np.ones(len(square))]))
    rim = _unit(np.column_stack([np.tan(np.pi / 4.0 * square), np.zeros(len(square))]))
    angle = np.arccos(np.clip(np.sum(cap * rim, axis=1, keepdims=True), -1.0, 1.0))
    direction = (np.sin((1.0 - ring) * angle) * cap + np.sin(ring * angle) * rim) / np.sin(angle)
    given = {{"inner": "bottom", "outer": "top"}.get(place, place): ratio for place, ratio in (towards or {}).items()}
    wall = graded_lines((1.0, 1.0, radius_m - cavity_radius_m), (1, 1, n_wall), given)[2]
    layers = [r * direction for r in 0.5 * (cavity_radius_m + radius_m) + wall]

    def middle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        radius = (np.linalg.norm(a, axis=1, keepdims=True) + np.linalg.norm(b, axis=1, keepdims=True)) / 2.0
        mid: np.ndarray = radius * _unit(_unit(a) + _unit(b)) if curved else (a + b) / 2.0
        return mid

    def sets(p: np.ndarray) -> dict[str, np.ndarray]:
        r, tiny = np.linalg.norm(p, axis=-1), 1e-9 * radius_m
        return {"base": p[..., 2] < tiny, "outer": r > radius_m - tiny, "inner": r < cavity_radius_m + tiny}

    return _extrude(layers, quads, parity, middle, sets, cut, refine)


def _check_even(cut: Collection[int], cells: tuple[int, int]) -> None:
    for axis in cut:
        if cells[axis] % 2:
            raise ConfigError(
                f"A plane of symmetry normal to {'xy'[axis]} would go through the middle of the {cells[axis]} cells.",
                "Give the whole body an even number of cells in that direction.",
            )


def _half_way(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    middle: np.ndarray = (a + b) / 2.0
    return middle


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length one; a zero vector stays zero."""
    unit: np.ndarray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
    return unit


def _extrude(
    layers: list[np.ndarray],
    quads: np.ndarray,
    parity: np.ndarray,
    middle: Middle,
    sets: Callable[[np.ndarray], dict[str, np.ndarray]],
    cut: Collection[int] = (),
    refine: Sequence[Refinement] = (),
) -> TetMesh:
    """Stack ``quads`` through ``layers``, cut into tetrahedra, leave out what is beyond a plane of symmetry, refine,
    add mid-edge nodes, find the surface."""
    corners = np.concatenate(layers)
    n_flat = len(parity)
    even = np.concatenate([(parity + k) % 2 == 0 for k in range(len(layers))])
    hexes = np.concatenate(
        [np.column_stack([quads + k * n_flat, quads + (k + 1) * n_flat]) for k in range(len(layers) - 1)]
    )
    first_even = even[hexes[:, 0]]
    linear = np.concatenate([_cut(hexes[first_even], (0, 2, 5, 7)), _cut(hexes[~first_even], (1, 3, 4, 6))])
    a, b, c, d = np.moveaxis(corners[linear], 1, 0)
    flipped = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0.0
    linear[flipped] = linear[flipped][:, [0, 2, 1, 3]]
    for axis in cut:
        linear = linear[corners[linear, axis].mean(axis=1) > 0.0]
    kept, linear = np.unique(linear, return_inverse=True)
    corners, linear = bisected(corners[kept], linear.reshape(-1, 4), refine, middle)

    def faces_of(p: np.ndarray) -> dict[str, np.ndarray]:
        planes = {f"{'xy'[axis]}_cut": np.abs(p[..., axis]) < 1e-9 * np.abs(corners).max() for axis in cut}
        return {**sets(p), **planes}

    return quadratic(corners, linear, middle, faces_of)


def quadratic(
    corners: np.ndarray,
    linear: np.ndarray,
    middle: Middle,
    sets: Callable[[np.ndarray], dict[str, np.ndarray]],
) -> TetMesh:
    """Add mid-edge nodes to linear tetrahedra ``(m, 4)`` and find their surface. ``sets``: by the name of a set of
    faces, which corners ``(k, 3, 3)`` [m] of the surface belong to it; faces with all three are in it."""
    pairs = np.sort(linear[:, tet10.EDGES].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(pairs, axis=0, return_inverse=True)
    nodes = np.concatenate([corners, middle(corners[edges[:, 0]], corners[edges[:, 1]])])
    tets = np.concatenate([linear, len(corners) + inverse.reshape(-1, 6)], axis=1)

    return surface_of(nodes, tets, sets)


def surface_of(nodes: np.ndarray, tets: np.ndarray, sets: Callable[[np.ndarray], dict[str, np.ndarray]]) -> TetMesh:
    """The mesh of quadratic tetrahedra ``(m, 10)`` with its surface; ``sets``: as of :func:`quadratic`."""
    faces = tets[:, tet10.FACES].reshape(-1, 6)
    _, first, count = np.unique(np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True)
    surface = faces[np.sort(first[count == 1])]
    named = {name: np.flatnonzero(on.all(axis=1)) for name, on in sets(nodes[surface[:, :3]]).items()}
    return TetMesh(nodes, tets.astype(np.int32), surface.astype(np.int32), named)


def _cut(hexes: np.ndarray, even: tuple[int, int, int, int]) -> np.ndarray:
    """Five tetrahedra for each of ``hexes (h, 8)``: the even corners, and each odd corner cut off."""
    odd = [corner for corner in range(8) if corner not in even]
    parts = [hexes[:, even]] + [hexes[:, (*_AROUND[corner], corner)] for corner in odd]
    return np.stack(parts, axis=1).reshape(-1, 4)
