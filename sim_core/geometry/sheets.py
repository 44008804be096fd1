"""Triangle meshes of sheets: rectangles in three patterns, any outline with holes, and hinges.

A sheet mesh lives in its body frame: the midsurface, nodes in metres. Flat builders put it in the
local xy plane with its centre at the origin and the normal along +z.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from sim_core.errors import ConfigError
from sim_core.geometry.polygons import area_of

MOST_ROUNDS = 8
"""Times that sides of an outline are halved before it is given up."""

PATTERNS = ("regular", "crossed", "irregular")


@dataclass(frozen=True)
class SheetMesh:
    """Midsurface mesh. ``nodes``: m, ``(n, 3)``. ``triangles``: int32 ``(m, 3)``, counter-clockwise."""

    nodes: np.ndarray
    triangles: np.ndarray

    @property
    def areas(self) -> np.ndarray:
        """Triangle areas [m^2], shape ``(m,)``."""
        a, b, c = (self.nodes[self.triangles[:, k]] for k in range(3))
        return 0.5 * np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1))

    @property
    def node_areas(self) -> np.ndarray:
        """Barycentric area of each node [m^2], shape ``(n,)``: a third of every triangle around it."""
        return self.shared(self.areas)

    def shared(self, amounts: np.ndarray) -> np.ndarray:
        """What each node gets ``(n,)`` when triangles share amounts ``(m,)`` equally among their corners."""
        nodal = np.zeros(len(self.nodes))
        np.add.at(nodal, self.triangles.ravel(), np.repeat(amounts / 3.0, 3))
        return nodal


def area_slopes(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Derivatives of the areas of triangles by their corners [m], ``(m, 3, 3)``: n x (side across from it) / 2."""
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return 0.5 * np.stack([np.cross(normal, across) for across in (c - b, a - c, b - a)], axis=1)


@dataclass(frozen=True)
class Hinges:
    """Interior edges. ``nodes``: int32 ``(k, 4)``: edge start, edge end, apex of the left triangle,
    apex of the right one; ``triangles``: int32 ``(k, 2)``: left, right."""

    nodes: np.ndarray
    triangles: np.ndarray


def find_hinges(triangles: np.ndarray) -> Hinges:
    """Collect interior edges of a consistently oriented manifold mesh.

    Raises ``ConfigError`` when an edge has more than two triangles or the orientations disagree.
    """
    left: dict[tuple[int, int], tuple[int, int]] = {}
    for t, tri in enumerate(triangles.tolist()):
        for k in range(3):
            edge = (tri[k], tri[(k + 1) % 3])
            if edge in left:
                raise ConfigError(
                    f"Edge {edge} of the sheet mesh is used twice in the same direction (triangles "
                    f"{left[edge][0]} and {t}).",
                    "Give a manifold mesh whose triangles are all oriented the same way.",
                )
            left[edge] = (t, tri[(k + 2) % 3])
    nodes, pairs = [], []
    for (i, j), (t, apex) in left.items():
        other = left.get((j, i))
        if other is not None and i < j:
            nodes.append((i, j, apex, other[1]))
            pairs.append((t, other[0]))
    return Hinges(
        np.asarray(nodes, dtype=np.int32).reshape(-1, 4),
        np.asarray(pairs, dtype=np.int32).reshape(-1, 2),
    )


def _lines(length: float, cells: int, through: tuple[float, ...]) -> np.ndarray:
    """Stations from -length/2 to length/2, the nearest inner one moved to each place in ``through``."""
    lines = np.linspace(-length / 2, length / 2, cells + 1)
    taken: set[int] = set()
    for place in sorted(through):
        if abs(place) >= length / 2 - 1e-9 * length:
            continue
        inner = [k for k in range(1, cells) if k not in taken]
        if not inner:
            raise ConfigError(
                f"A sheet of {length:g} m with {cells} cells has no line of nodes left for the edge of a clamp or load "
                f"at {place:g} m.",
                "Give the sheet more cells in that direction.",
            )
        nearest = min(inner, key=lambda k: abs(lines[k] - place))
        lines[nearest] = place
        taken.add(nearest)
    if np.any(np.diff(lines) <= 0.0):
        raise ConfigError(
            f"Edges of clamps and loads at {sorted(through)} m are too close together for {cells} cells on "
            f"{length:g} m.",
            "Give the sheet more cells in that direction.",
        )
    return lines


def rectangle(
    length_m: float,
    width_m: float,
    cells: tuple[int, int],
    pattern: str = "regular",
    seed: int = 0,
    through_m: tuple[tuple[float, ...], tuple[float, ...]] = ((), ()),
) -> SheetMesh:
    """Mesh a rectangle ``length_m`` (x) by ``width_m`` (y) with ``cells`` cells along x and y.

    ``regular``: two triangles a cell, all diagonals alike. ``crossed``: four triangles a cell.
    ``irregular``: interior and edge nodes displaced at random (seeded), Delaunay triangles.
    ``through_m``: places along x and along y that lines of nodes must pass through (edges of clamps and loads).
    """
    nx, ny = cells
    xs = _lines(length_m, nx, through_m[0])
    ys = _lines(width_m, ny, through_m[1])
    gx, gy = np.meshgrid(xs, ys, indexing="ij")
    grid = np.column_stack([gx.ravel(), gy.ravel()])
    index = np.arange((nx + 1) * (ny + 1)).reshape(nx + 1, ny + 1)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    if pattern == "regular":
        points, triangles = grid, np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    elif pattern == "crossed":
        centre = len(grid) + np.arange(nx * ny)
        middle = (grid[a] + grid[b] + grid[c] + grid[d]) / 4.0
        points = np.vstack([grid, middle])
        triangles = np.vstack([np.column_stack([p, q, centre]) for p, q in ((a, b), (b, c), (c, d), (d, a))])
    elif pattern == "irregular":
        rng = np.random.default_rng(seed)
        points = _jitter(grid, length_m, width_m, nx, ny, rng, through_m)
        triangles = _delaunay(points)
    else:
        raise ConfigError(f"Sheet pattern {pattern!r} is not known.", f"Use one of {', '.join(PATTERNS)}.")
    nodes = np.column_stack([points, np.zeros(len(points))])
    return SheetMesh(nodes, np.ascontiguousarray(triangles, dtype=np.int32))


def _jitter(
    grid: np.ndarray,
    length: float,
    width: float,
    nx: int,
    ny: int,
    rng: np.random.Generator,
    through: tuple[tuple[float, ...], tuple[float, ...]],
) -> np.ndarray:
    """Move nodes by up to 30 % of a cell; nodes of an edge or of a wanted line stay on it."""
    move = 0.3 * rng.uniform(-1, 1, grid.shape) * np.array([length / nx, width / ny])
    move[np.isclose(np.abs(grid[:, 0]), length / 2), 0] = 0.0
    move[np.isclose(np.abs(grid[:, 1]), width / 2), 1] = 0.0
    for axis, places in enumerate(through):
        for place in places:
            move[np.isclose(grid[:, axis], place), axis] = 0.0
    return np.asarray(grid + move)


def _delaunay(points: np.ndarray) -> np.ndarray:
    """Delaunay triangles, counter-clockwise, without slivers along straight edges."""
    triangles = Delaunay(points).simplices
    p, q, r = (points[triangles[:, k]] for k in range(3))
    doubled = (q[:, 0] - p[:, 0]) * (r[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (r[:, 0] - p[:, 0])
    longest = np.max([np.sum((u - v) ** 2, axis=1) for u, v in ((p, q), (q, r), (r, p))], axis=0)
    triangles = np.where(doubled[:, None] < 0, triangles[:, ::-1], triangles)
    return np.asarray(triangles[np.abs(doubled) > 1e-3 * longest])


def outline(polygon_m: np.ndarray, edge_m: float, holes_m: tuple[np.ndarray, ...] = (), seed: int = 0) -> SheetMesh:
    """Mesh a polygon with holes by points at about ``edge_m`` and Delaunay triangles.

    ``polygon_m`` and every hole: corners in order, m, shape ``(k, 2)``. The triangles have the polygon's area exactly.
    Raises ``ConfigError`` when the edge length is too long for the outline.
    """
    from matplotlib.path import Path

    rims = [np.asarray(polygon_m, dtype=float), *[np.asarray(h, dtype=float) for h in holes_m]]
    border = np.vstack([_along(rim, edge_m) for rim in rims])
    low, high = border.min(axis=0), border.max(axis=0)
    rows = np.arange(low[1], high[1], edge_m * np.sqrt(3) / 2)
    inside = np.vstack(
        [
            np.column_stack(
                [
                    np.arange(low[0] + (k % 2) * edge_m / 2, high[0], edge_m),
                    np.full_like(np.arange(low[0] + (k % 2) * edge_m / 2, high[0], edge_m), y),
                ]
            )
            for k, y in enumerate(rows)
        ]
    )
    inside = inside + 0.05 * edge_m * np.random.default_rng(seed).uniform(-1, 1, inside.shape)
    paths = [Path(rim) for rim in rims]

    def within(points: np.ndarray) -> np.ndarray:
        keep = paths[0].contains_points(points)
        for hole in paths[1:]:
            keep &= ~hole.contains_points(points)
        return np.asarray(keep)

    inside = inside[within(inside)]
    if len(inside):
        inside = inside[cKDTree(border).query(inside)[0] > 0.6 * edge_m]
    points, sides = np.vstack([border, inside]), _sides(rims, edge_m)
    for _ in range(MOST_ROUNDS):
        triangles = _delaunay(points)
        triangles = triangles[within(points[triangles].mean(axis=1))]
        lacking = _lacking(triangles, sides)
        if not lacking.any():
            break
        # A side that Delaunay triangles do not have, as where the outline is narrow, is halved until they do.
        halves = len(points) + np.arange(int(lacking.sum()))
        points = np.vstack([points, points[sides[lacking]].mean(axis=1)])
        begin, end = sides[lacking].T
        sides = np.vstack([sides[~lacking], np.column_stack([begin, halves]), np.column_stack([halves, end])])
    nodes = np.column_stack([points, np.zeros(len(points))])
    mesh = SheetMesh(nodes, np.ascontiguousarray(triangles, dtype=np.int32))
    area = area_of(rims[0]) - sum(area_of(rim) for rim in rims[1:])
    if len(triangles) == 0 or len(np.unique(triangles)) < len(points) or abs(mesh.areas.sum() - area) > 1e-6 * area:
        raise ConfigError(
            f"The outline cannot be meshed with edges of {edge_m:g} m: the mesh would have {mesh.areas.sum():.6g} m^2, "
            f"the outline has {area:.6g} m^2.",
            "Give a shorter edge_m.",
        )
    return mesh


def _sides(rims: list[np.ndarray], edge_m: float) -> np.ndarray:
    """Neighbours along the rims, as numbers of the points of :func:`_along` ``(k, 2)``."""
    sides, start = [], 0
    for rim in rims:
        count = len(_along(rim, edge_m))
        numbers = start + np.arange(count)
        sides.append(np.column_stack([numbers, np.roll(numbers, -1)]))
        start += count
    return np.vstack(sides)


def _lacking(triangles: np.ndarray, sides: np.ndarray) -> np.ndarray:
    """Which sides ``(k, 2)`` are edges of no triangle."""
    edges = {tuple(sorted(edge)) for tri in triangles.tolist() for edge in zip(tri, tri[1:] + tri[:1], strict=True)}
    return np.array([tuple(sorted(side)) not in edges for side in sides.tolist()])


def _along(rim: np.ndarray, edge_m: float) -> np.ndarray:
    """Points along a closed polygon at about ``edge_m``, corners included."""
    pieces = []
    for start, end in zip(rim, np.roll(rim, -1, axis=0), strict=True):
        count = max(1, round(float(np.linalg.norm(end - start)) / edge_m))
        pieces.append(start + (end - start) * (np.arange(count) / count)[:, None])
    return np.vstack(pieces)


def locate(mesh: SheetMesh, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Material points of a flat sheet: triangle ``(k,)`` and barycentric weights ``(k, 3)``.

    ``points``: local rest coordinates [m], ``(k, 2)`` or ``(k, 3)``. Raises ``ConfigError`` naming
    the first point that is off the sheet.
    """
    points = np.asarray(points, dtype=float)[:, :2]
    weights = weights_in(mesh.nodes[mesh.triangles], points[:, None, :])
    triangle = np.argmax(weights.min(axis=-1), axis=1)
    chosen = weights[np.arange(len(points)), triangle]
    off = np.flatnonzero(chosen.min(axis=1) < -1e-6)
    if len(off):
        raise ConfigError(
            f"Point {points[off[0]].tolist()} [m] is not on the sheet.",
            "Give local rest coordinates within the sheet's outline (origin at its centre).",
        )
    return triangle, chosen


def weights_in(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric weights ``(..., m, 3)`` of points [m] ``(..., m, 2)`` in flat triangles with ``corners`` [m]
    ``(m, 3, 2)`` or ``(m, 3, 3)``, of which the first two coordinates count; outside of them some are negative."""
    flat = corners[:, :, :2]
    edges = np.stack([flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]], axis=-1)
    local = np.einsum("mij,...mj->...mi", np.linalg.inv(edges), points - flat[:, 0])
    return np.concatenate([1.0 - local.sum(axis=-1, keepdims=True), local], axis=-1)
