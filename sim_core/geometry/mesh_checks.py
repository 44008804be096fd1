"""What is wrong with a mesh that was made elsewhere, by the numbers of the vertices and elements concerned.

What has one remedy only is repaired, and reported; everything else is refused. Numbers count from 0, as in the file.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components
from scipy.spatial import cKDTree

from sim_core.errors import ConfigError

SMALLEST_M, LARGEST_M = 1e-3, 10.0
"""Extents of bodies beyond which a wrong unit is likelier than such a body."""

COINCIDENT = 1e-7
"""Distance of vertices, over the diagonal of the mesh, below which they are at one place."""

FLAT = 1e-3
"""Height over longest edge of a triangle, or six volumes over the cube of the longest edge of a tetrahedron, below
which it is degenerate."""

SHOWN = 6
"""How many numbers a message lists."""


def ids(numbers: Sequence[int] | np.ndarray) -> str:
    """Numbers as a message lists them."""
    shown = ", ".join(str(int(n)) for n in list(numbers)[:SHOWN])
    return shown if len(numbers) <= SHOWN else f"{shown}, ... ({len(numbers)} in all)"


def check_extent(points: np.ndarray, unit: str, units: dict[str, float]) -> None:
    """Raise if the body is far too large or small; ``points`` in m."""
    extent = float(np.ptp(points, axis=0).max())
    if SMALLEST_M <= extent <= LARGEST_M:
        return
    others = {u: extent * s / units[unit] for u, s in units.items()}
    fitting = [f"{e:.3g} m with 'unit: {u}'" for u, e in others.items() if SMALLEST_M <= e <= LARGEST_M]
    raise ConfigError(
        f"is {extent:.3g} m large with 'unit: {unit}', and bodies are between {SMALLEST_M:g} and {LARGEST_M:g} m.",
        f"Name the unit of its coordinates; it would be {', '.join(fitting)}." if fitting else "Scale the mesh.",
    )


def check_finite(points: np.ndarray) -> None:
    """Raise if a coordinate is no number."""
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise ConfigError(f"has vertices without finite coordinates: {ids(bad)}.", "Correct them, or export it again.")


def without_unused(points: np.ndarray, cells: np.ndarray, notes: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Drop vertices that no cell has."""
    used, cells_now = np.unique(cells, return_inverse=True)
    if len(used) < len(points):
        unused = np.setdiff1d(np.arange(len(points)), used)
        notes.append(f"Vertices that belong to no element were left out: {ids(unused)}.")
    return points[used], cells_now.reshape(cells.shape)


def joined(
    points: np.ndarray, cells: np.ndarray, weld: bool | None, notes: list[str], apart: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Join vertices at one place: nearer than ``FLAT`` of the shortest edge at either, so that nothing but a degenerate
    element fits between them. ``weld``: None refuses them, unless the format keeps all triangles ``apart``; False keeps
    them apart."""
    if weld is False:
        return points, cells
    same = COINCIDENT * float(np.linalg.norm(np.ptp(points, axis=0)))
    reach = np.maximum(FLAT * _shortest_edges(points, cells), same)
    pairs = cKDTree(points).query_pairs(float(reach.max()), output_type="ndarray")
    gaps = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    near = gaps <= reach[pairs].min(axis=1)
    pairs, gaps = pairs[near], gaps[near]
    if not len(pairs):
        return points, cells
    widest = float(gaps.max())
    if weld is None and not apart:
        shown = "; ".join(f"{a} and {b}" for a, b in pairs[:SHOWN])
        where = "at one place" if widest <= same else f"at one place but for up to {widest:.2g} m"
        raise ConfigError(
            f"has {len(pairs)} pairs of vertices {where}: {shown}.",
            "Write 'weld: true' to join them, or 'weld: false' where the body is slit there and they are to part.",
        )
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    _, label = connected_components(graph, directed=False)
    _, first = np.unique(label, return_index=True)
    words = "Vertices at one place were joined" if widest <= same else f"Seams up to {widest:.2g} m wide were welded"
    notes.append(f"{words}: {len(points)} vertices became {len(first)}.")
    return points[first], label[cells]


def _shortest_edges(points: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Length [m] of the shortest edge of the elements at each vertex ``(n,)``; of those with nodes within their edges
    half of it."""
    corners = points[cells[:, :4]]
    sides = np.linalg.norm(corners[:, :, None] - corners[:, None, :], axis=3)
    k = corners.shape[1]
    shortest = sides[:, ~np.eye(k, dtype=bool)].min(axis=1) * (0.5 if cells.shape[1] > 4 else 1.0)
    found = np.full(len(points), np.inf)
    np.minimum.at(found, cells, np.broadcast_to(shortest[:, None], cells.shape))
    return np.where(np.isfinite(found), found, 0.0)


def pieces_of(cells: np.ndarray) -> np.ndarray:
    """Number of the piece that each element ``(m, k)`` belongs to ``(m,)``: elements hang together by common
    vertices."""
    rows = np.repeat(np.arange(len(cells)), cells.shape[1])
    graph = coo_matrix((np.ones(cells.size), (rows, cells.ravel())), shape=(len(cells), int(cells.max()) + 1))
    _, label = connected_components(graph @ graph.T, directed=False)
    return np.asarray(label)


def check_seams(points: np.ndarray, triangles: np.ndarray) -> None:
    """Raise where a vertex at an edge of the surface lies on another such edge between its ends: the two sides look
    joined there and are not."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    rim = edges[count == 1]
    if not len(rim):
        return
    a, b = points[rim[:, 0]], points[rim[:, 1]]
    length = np.linalg.norm(b - a, axis=1)
    vertices = np.unique(rim)
    near = cKDTree(points[vertices]).query_ball_point(0.5 * (a + b), 0.5 * length)
    edge = np.repeat(np.arange(len(rim)), [len(n) for n in near])
    vertex = vertices[np.concatenate([np.asarray(n, dtype=np.int64) for n in near])] if len(edge) else edge
    other = (vertex != rim[edge, 0]) & (vertex != rim[edge, 1])
    edge, vertex = edge[other], vertex[other]
    along = (b - a)[edge] / length[edge, None]
    offset = points[vertex] - a[edge]
    share = (offset * along).sum(axis=1)
    away = np.linalg.norm(offset - share[:, None] * along, axis=1)
    slack = FLAT * length[edge]
    on = (away <= slack) & (share > slack) & (share < length[edge] - slack)
    if on.any():
        first = int(np.flatnonzero(on)[0])
        raise ConfigError(
            f"has vertices on edges of other triangles, which they do not share: {ids(np.unique(vertex[on]))}, as "
            f"{int(vertex[first])} on the edge {rim[edge[first]].tolist()}.",
            "Give both sides of a seam the same vertices, as by merging or remeshing; or write 'weld: false' where the "
            "body is slit there.",
        )


def check_distinct(cells: np.ndarray, kind: str) -> None:
    """Raise if an element is given twice, or has a vertex twice."""
    corners = np.sort(cells, axis=1)
    repeated = np.flatnonzero((corners[:, 1:] == corners[:, :-1]).any(axis=1))
    if len(repeated):
        raise ConfigError(f"has {kind} with a vertex twice: {ids(repeated)}.", "Remove them.")
    _, first, count = np.unique(corners, axis=0, return_index=True, return_counts=True)
    if (count > 1).any():
        twins = [np.flatnonzero((corners == corners[k]).all(axis=1)) for k in first[count > 1][:SHOWN]]
        shown = "; ".join(" and ".join(str(t) for t in group) for group in twins)
        raise ConfigError(f"has {int((count > 1).sum())} {kind} more than once: {shown}.", "Keep one of each.")


def check_triangles(points: np.ndarray, triangles: np.ndarray) -> None:
    """Raise if triangles are degenerate."""
    corners = points[triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    flat = np.flatnonzero(doubled <= FLAT * longest**2)
    if len(flat):
        raise ConfigError(
            f"has degenerate triangles, lower than {FLAT:g} of their longest edge: {ids(flat)}.",
            "Collapse them in the program that made the mesh, or mesh the surface anew.",
        )


def oriented(triangles: np.ndarray, notes: list[str]) -> np.ndarray:
    """All triangles of a connected piece the same way round, as most of its triangles are. Raises if an edge has more
    than two, if a vertex joins two pieces that share no edge there, or if there is no such orientation."""
    directed = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    owner = np.repeat(np.arange(len(triangles)), 3)
    edges, index, count = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True)
    if (count > 2).any():
        crowded = int(np.argmax(count))
        raise ConfigError(
            f"has {int((count > 2).sum())} edges with more than two triangles; edge {edges[crowded].tolist()} has "
            f"{ids(owner[index == crowded])}.",
            "Split the surface there: a sheet has one or two triangles at an edge.",
        )
    by_edge = np.argsort(index, kind="stable")
    first = by_edge[np.flatnonzero(np.diff(index[by_edge], prepend=-1) > 0)][count == 2]
    last = by_edge[np.cumsum(count) - 1][count == 2]
    _check_fans(triangles, directed, owner, first, last)
    same_way = (directed[first] == directed[last]).all(axis=1)
    one, other = owner[first], owner[last]
    # Two copies of each triangle, as given and turned over: neighbours join those copies that agree.
    n = len(triangles)
    ends = np.where(same_way, other + n, other), np.where(same_way, other, other + n)
    rows, columns = np.concatenate([one, one + n]), np.concatenate(ends)
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(2 * n, 2 * n)).tocsr()
    _, label = connected_components(graph, directed=False)
    both = np.flatnonzero(label[:n] == label[n:])
    if len(both):
        raise ConfigError(
            f"has no consistent orientation, like a Moebius strip; triangle {both[0]} can be reached turned over.",
            "Cut the surface open, so that it has two sides.",
        )
    turned = np.zeros(n, dtype=bool)
    visited = np.zeros(n, dtype=bool)
    for start in range(n):
        if visited[start]:
            continue
        reached = breadth_first_order(graph, start, directed=False, return_predecessors=False)
        piece = reached % n
        visited[piece] = True
        over = reached >= n
        turned[piece] = over if 2 * over.sum() <= len(piece) else ~over
    if turned.any():
        notes.append(f"Triangles were turned over, to face as their neighbours do: {ids(np.flatnonzero(turned))}.")
    return np.where(turned[:, None], triangles[:, ::-1], triangles)


def _check_fans(
    triangles: np.ndarray, directed: np.ndarray, owner: np.ndarray, first: np.ndarray, last: np.ndarray
) -> None:
    """Raise if the triangles around a vertex are not all joined by edges at it. ``first``, ``last``: rows of
    ``directed`` that share an edge."""
    links = []
    for end in (0, 1):
        vertex = directed[first, end]
        corner = [3 * owner[row] + np.argmax(triangles[owner[row]] == vertex[:, None], axis=1) for row in (first, last)]
        links.append(np.stack(corner))
    rows, columns = np.hstack(links)
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(triangles.size,) * 2)
    _, label = connected_components(graph, directed=False)
    fans = np.unique(np.stack([triangles.ravel(), label], axis=1), axis=0)[:, 0]
    vertices, count = np.unique(fans, return_counts=True)
    if (count > 1).any():
        raise ConfigError(
            f"has vertices at which pieces touch that share no edge there: {ids(vertices[count > 1])}.",
            "Give each piece a vertex of its own there, or join them along an edge.",
        )


def check_closed(triangles: np.ndarray) -> None:
    """Raise unless each edge has two triangles."""
    sides = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    if (count == 1).any():
        raise ConfigError(
            f"is not closed: {int((count == 1).sum())} edges have one triangle only, the first at the vertices "
            f"{edges[count == 1][0].tolist()}.",
            "Close its holes, or give a mesh of tetrahedra.",
        )


def upright(points: np.ndarray, tets: np.ndarray, notes: list[str]) -> np.ndarray:
    """Tetrahedra ``(m, 4)`` or ``(m, 10)`` with positive volumes; raises where they are flat."""
    corners = points[tets[:, :4]]
    volume = np.linalg.det(corners[:, 1:] - corners[:, :1])
    sides = np.linalg.norm(corners[:, :, None] - corners[:, None, :], axis=3).max(axis=(1, 2))
    flat = np.flatnonzero(np.abs(volume) <= FLAT * sides**3)
    if len(flat):
        raise ConfigError(
            f"has degenerate tetrahedra, nearly flat ones: {ids(flat)}.", "Mesh the body anew, or optimise the mesh."
        )
    turned = volume < 0.0
    if turned.any():
        notes.append(f"Tetrahedra that were inside out were renumbered: {ids(np.flatnonzero(turned))}.")
        order = [0, 2, 1, 3, 6, 5, 4, 7, 9, 8][: tets.shape[1]]
        tets = np.where(turned[:, None], tets[:, order], tets)
    return tets


def check_faces(tets: np.ndarray) -> None:
    """Raise if a face has more than two tetrahedra, or the body is in pieces that share no face."""
    faces = np.sort(tets[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3), axis=1)
    unique, index, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    owner = np.repeat(np.arange(len(tets)), 4)
    if (count > 2).any():
        crowded = int(np.argmax(count))
        raise ConfigError(
            f"has faces with more than two tetrahedra; face {unique[crowded].tolist()} has "
            f"{ids(owner[index == crowded])}.",
            "Remove the elements that overlap.",
        )
    order = np.argsort(index, kind="stable")
    pairs = order[np.flatnonzero(np.diff(index[order]) == 0)], order[1:][np.diff(index[order]) == 0]
    graph = coo_matrix((np.ones(len(pairs[0])), (owner[pairs[0]], owner[pairs[1]])), shape=(len(tets),) * 2)
    pieces, label = connected_components(graph, directed=False)
    if pieces > 1:
        apart = [int(np.argmax(label == k)) for k in range(pieces)]
        raise ConfigError(
            f"is in {pieces} pieces that share no face; they begin with the tetrahedra {ids(apart)}.",
            "Give each piece a body of its own, or write 'weld: true' if vertices are doubled where they meet.",
        )
