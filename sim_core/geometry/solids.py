"""Solid bodies as meshes of quadratic tetrahedra: blocks, cylinders, hollow domes.

All builders start from hexahedra whose corners carry the two colours of a checkerboard, and cut each
into five tetrahedra: one spanned by the four even corners, and one for each odd corner. A face shared
by two hexahedra is then cut along the same diagonal (between its even corners), and neighbours are
mirror images of each other, so the mesh has no preferred diagonal direction.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from sim_core.errors import ConfigError
from sim_core.geometry import tet10

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
    for p, point in enumerate(points):
        near = np.flatnonzero(np.all((low <= point) & (point <= high), axis=1))
        if len(near) == 0:
            continue
        barycentric = _invert(corners[near], point)
        inside = barycentric.min(axis=1)
        best = int(np.argmax(inside))
        if inside[best] >= -tolerance:
            element[p] = near[best]
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
    for p, nodes in enumerate(mesh.nodes[mesh.tets[element]]):
        slopes = tet10.shape_derivative(_invert(nodes[None], feet[p]))[0]
        weights[p] += slopes @ np.linalg.solve(nodes.T @ slopes, points[p] - feet[p])
    return element, weights


def _invert(elements: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Barycentric ``(m, 4)`` of ``point`` in elements ``(m, 10, 3)``; -inf where there are none."""
    local = np.full((len(elements), 3), 0.25)
    scale = np.ptp(elements, axis=1).max(axis=1)
    miss = np.full(len(elements), np.inf)
    for _ in range(30):
        barycentric = np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)
        error = np.einsum("ma,mai->mi", tet10.shape(barycentric), elements) - point
        miss = np.linalg.norm(error, axis=1) / scale
        if np.all(miss < 1e-14):
            break
        jac = np.einsum("mai,maj->mij", elements, tet10.shape_derivative(barycentric))
        singular = np.abs(np.linalg.det(jac)) < 1e-12 * scale**3
        jac[singular] = np.eye(3)
        step = np.linalg.solve(jac, error[:, :, None])[:, :, 0]
        step[singular] = 0.0
        local = local - step * np.minimum(1.0, 0.5 / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
    barycentric = np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)
    barycentric[miss > 1e-10] = -np.inf
    return barycentric


def block(
    size_m: tuple[float, float, float],
    cells: tuple[int, int, int],
    centre_ratio: float = 1.0,
    top_ratio: float = 1.0,
) -> TetMesh:
    """A box, centred on the z axis, from z = 0 up.

    ``cells``: hexahedra along x, y, z, five tetrahedra each. ``centre_ratio``: width of the cells at
    the middle over that at the border, in x and y (below 1: finer in the middle). ``top_ratio``:
    height of the cells at the top over that at the bottom. Sets: bottom, top, x_min, x_max, y_min,
    y_max.
    """
    _check_positive(size_m=size_m, cells=cells, centre_ratio=(centre_ratio,), top_ratio=(top_ratio,))
    nx, ny, nz = cells
    x = _spaced(size_m[0], _to_centre(nx), centre_ratio) - size_m[0] / 2.0
    y = _spaced(size_m[1], _to_centre(ny), centre_ratio) - size_m[1] / 2.0
    z = _spaced(size_m[2], np.linspace(0.0, 1.0, nz), top_ratio)
    flat, quads, parity = _grid(nx, ny)
    layers = [np.column_stack([x[flat[:, 0]], y[flat[:, 1]], np.full(len(flat), height)]) for height in z]

    def sets(p: np.ndarray) -> dict[str, np.ndarray]:
        tiny = 1e-9 * max(size_m)
        found = {"bottom": p[..., 2] < tiny, "top": p[..., 2] > size_m[2] - tiny}
        for axis, letter in enumerate("xy"):
            found[f"{letter}_min"] = p[..., axis] < -size_m[axis] / 2.0 + tiny
            found[f"{letter}_max"] = p[..., axis] > size_m[axis] / 2.0 - tiny
        return found

    return _extrude(layers, quads, parity, lambda a, b: (a + b) / 2.0, sets)


def cylinder(radius_m: float, height_m: float, cells: tuple[int, int, int], curved: bool = True) -> TetMesh:
    """A solid cylinder or disc around the z axis, from z = 0 up.

    ``cells``: hexahedra along a side of the square core, from the core to the rim, and along the
    height. ``curved``: put the mid-edge nodes of the rim on the circle. Sets: bottom, top, side.
    """
    _check_positive(radius_m=(radius_m,), height_m=(height_m,), cells=cells)
    n, rings, nz = cells
    square, ring, quads, parity = _core_and_rings(n, rings)
    core = 0.9 * radius_m * n / (n + 2.0 * rings)
    flat = (1.0 - ring) * core * square + ring * radius_m * _unit(np.tan(np.pi / 4.0 * square))
    layers = [np.column_stack([flat, np.full(len(flat), z)]) for z in np.linspace(0.0, height_m, nz + 1)]
    tiny = 1e-9 * max(radius_m, height_m)

    def middle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        mid: np.ndarray = (a + b) / 2.0
        if curved:
            rim = _on_side(a) & _on_side(b)
            mid[rim, :2] = radius_m * _unit(mid[rim, :2])
        return mid

    def _on_side(p: np.ndarray) -> np.ndarray:
        on: np.ndarray = np.hypot(p[..., 0], p[..., 1]) > radius_m - tiny
        return on

    def sets(p: np.ndarray) -> dict[str, np.ndarray]:
        return {"bottom": p[..., 2] < tiny, "top": p[..., 2] > height_m - tiny, "side": _on_side(p)}

    return _extrude(layers, quads, parity, middle, sets)


def dome(radius_m: float, cavity_radius_m: float, cells: tuple[int, int, int], curved: bool = True) -> TetMesh:
    """A hollow half ball, like a tactile fingertip: flat rim at z = 0, pole on +z.

    Half of a cubed sphere (Ronchi, Iacono and Paolucci, J. Comput. Phys. 124, 1996): a square cap
    around the pole and rings from there to the rim, with no degenerate cell. ``cells``: hexahedra along
    a side of the cap, from the cap to the rim, and through the wall; a good shape has twice as many in
    the first as in the second. ``curved``: put mid-edge nodes on spheres (the volume of (2, 1, 1) is then
    0.8 % low, of (4, 2, 2) 0.05 %). Sets: base (the rim), outer, inner (the wall of the cavity).
    """
    _check_positive(radius_m=(radius_m,), cavity_radius_m=(cavity_radius_m,), cells=cells)
    if not cavity_radius_m < radius_m:
        raise ConfigError(
            f"The cavity radius {cavity_radius_m} m is not below the outer radius {radius_m} m.",
            "Give a cavity that fits into the dome.",
        )
    n, rings, n_wall = cells
    square, ring, quads, parity = _core_and_rings(n, rings)
    half_angle = np.pi / 2.0 * n / (n + 2.0 * rings)
    cap = _unit(np.column_stack([np.tan(half_angle * square), np.ones(len(square))]))
    rim = _unit(np.column_stack([np.tan(np.pi / 4.0 * square), np.zeros(len(square))]))
    angle = np.arccos(np.clip(np.sum(cap * rim, axis=1, keepdims=True), -1.0, 1.0))
    direction = (np.sin((1.0 - ring) * angle) * cap + np.sin(ring * angle) * rim) / np.sin(angle)
    layers = [r * direction for r in np.linspace(cavity_radius_m, radius_m, n_wall + 1)]

    def middle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        radius = (np.linalg.norm(a, axis=1, keepdims=True) + np.linalg.norm(b, axis=1, keepdims=True)) / 2.0
        mid: np.ndarray = radius * _unit(_unit(a) + _unit(b)) if curved else (a + b) / 2.0
        return mid

    def sets(p: np.ndarray) -> dict[str, np.ndarray]:
        r, tiny = np.linalg.norm(p, axis=-1), 1e-9 * radius_m
        return {"base": p[..., 2] < tiny, "outer": r > radius_m - tiny, "inner": r < cavity_radius_m + tiny}

    return _extrude(layers, quads, parity, middle, sets)


def _check_positive(**values: tuple[float, ...]) -> None:
    for name, given in values.items():
        if not all(v > 0 for v in given):
            raise ConfigError(f"{name} = {given} must be positive.", "Give positive sizes and cell counts.")


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length one; a zero vector stays zero."""
    unit: np.ndarray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)
    return unit


def _to_centre(n: int) -> np.ndarray:
    """Position of ``n`` cells from 0 at the border to 1 at the middle."""
    away = np.abs(np.arange(n) - (n - 1) / 2.0)
    place: np.ndarray = 1.0 - (away - away.min()) / max(np.ptp(away), 1e-300)
    return place


def _spaced(length: float, place: np.ndarray, ratio: float) -> np.ndarray:
    """``len(place) + 1`` coordinates [m] with cell widths in proportion to ``ratio ** place``."""
    widths = ratio**place
    coordinates: np.ndarray = np.concatenate([[0.0], np.cumsum(widths)]) * (length / widths.sum())
    return coordinates


def _grid(nx: int, ny: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lattice nodes ``(k, 2)``, their quads ``(q, 4)`` counter-clockwise, and the colour of each node."""
    j, i = (g.ravel() for g in np.meshgrid(np.arange(ny + 1), np.arange(nx + 1), indexing="ij"))
    first = (np.arange(ny)[:, None] * (nx + 1) + np.arange(nx)[None, :]).ravel()
    quads = np.column_stack([first, first + 1, first + nx + 2, first + nx + 1])
    return np.column_stack([i, j]), quads, (i + j) % 2


def _core_and_rings(n: int, rings: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A square grid of ``n x n`` cells with ``rings`` rings of quads around it.

    Returns the place of each node in the square [-1, 1]^2 (nodes of a ring: on its border), its ring
    as a share ``(k, 1)`` (0 in the core, 1 at the rim), the quads ``(q, 4)``, and the node colours.
    """
    flat, quads, parity = _grid(n, n)
    index = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    border = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    square = [2.0 * flat / n - 1.0]
    ring, colour, all_quads, inside = [np.zeros(len(flat))], [parity], [quads], border
    for r in range(1, rings + 1):
        outside = len(flat) + (r - 1) * len(border) + np.arange(len(border))
        square.append(square[0][border])
        ring.append(np.full(len(border), r / rings))
        colour.append((parity[border] + r) % 2)
        all_quads.append(np.column_stack([inside, outside, np.roll(outside, -1), np.roll(inside, -1)]))
        inside = outside
    place, share = np.concatenate(square), np.concatenate(ring)[:, None]
    return place, share, np.concatenate(all_quads), np.concatenate(colour)


def _extrude(
    layers: list[np.ndarray],
    quads: np.ndarray,
    parity: np.ndarray,
    middle: Callable[[np.ndarray, np.ndarray], np.ndarray],
    sets: Callable[[np.ndarray], dict[str, np.ndarray]],
) -> TetMesh:
    """Stack ``quads`` through ``layers``, cut into tetrahedra, add mid-edge nodes, find the surface."""
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

    pairs = np.sort(linear[:, tet10.EDGES].reshape(-1, 2), axis=1)
    edges, inverse = np.unique(pairs, axis=0, return_inverse=True)
    nodes = np.concatenate([corners, middle(corners[edges[:, 0]], corners[edges[:, 1]])])
    tets = np.concatenate([linear, len(corners) + inverse.reshape(-1, 6)], axis=1)

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
