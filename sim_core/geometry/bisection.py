"""Local refinement of tetrahedra by bisection of their longest edges: conforming, graded by itself.

A tetrahedron that is too large marks its longest edge, and every tetrahedron with a marked edge marks its own
longest edge too, until nothing changes (Rivara, Int. J. Numer. Methods Eng. 20, 1984; Plaza & Carey, Appl. Numer.
Math. 32, 2000). Then each is cut at the longest of its marked edges, again and again. The order of the edges, by
length and then by their numbers, is the same for all who share a face, so that both sides of it are cut alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.errors import ConfigError
from sim_core.geometry import tet10

Middle = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Where the middles of edges lie whose ends are given, ``(n, 3)`` each [m]: on a curved surface, elsewhere than half
way."""

MOST_TETS = 100_000
"""Elements beyond which no simulation is possible; refinement stops with an error there."""


@dataclass(frozen=True)
class Refinement:
    """``box``: lower and upper corner [m] ``(2, 3)``; the edges of all tetrahedra that reach into it are at most
    ``edge_m`` long."""

    box: np.ndarray
    edge_m: float


def bisected(
    nodes: np.ndarray, tets: np.ndarray, wanted: Sequence[Refinement], middle: Middle
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [m] ``(n, 3)`` and linear tetrahedra ``(m, 4)`` that meet all refinements; orientation is kept."""
    while True:
        ends = np.sort(tets[:, tet10.EDGES].reshape(-1, 2).astype(np.int64), axis=1)
        keys, index = np.unique(ends[:, 0] * len(nodes) + ends[:, 1], return_inverse=True)
        edges, index = np.stack(np.divmod(keys, len(nodes)), axis=1), index.reshape(-1, 6)
        length = np.linalg.norm(nodes[edges[:, 0]] - nodes[edges[:, 1]], axis=1)
        # Lengths that differ by round-off alone are taken for equal, so that regular meshes stay regular.
        alike = np.round(np.log(length), 6)
        order = np.lexsort((edges[:, 1], edges[:, 0], alike))
        rank = np.empty(len(edges), dtype=np.int64)
        rank[order] = np.arange(len(edges))
        longest = np.take_along_axis(index, rank[index].argmax(axis=1)[:, None], axis=1)[:, 0]
        marked = np.zeros(len(edges), dtype=bool)
        marked[longest[_too_large(nodes[tets], length[longest], wanted)]] = True
        if not marked.any():
            return nodes, tets
        touched = longest[marked[index].any(axis=1)]
        while not marked[touched].all():
            marked[touched] = True
            touched = longest[marked[index].any(axis=1)]
        tets = _cut_all(tets, edges[marked], rank[marked], len(nodes))
        nodes = np.vstack([nodes, middle(nodes[edges[marked, 0]], nodes[edges[marked, 1]])])
        if len(tets) > MOST_TETS:
            raise ConfigError(
                f"The refinement asks for more than {MOST_TETS} tetrahedra.",
                "Make its boxes smaller or edge_m longer.",
            )


def _too_large(corners: np.ndarray, length: np.ndarray, wanted: Sequence[Refinement]) -> np.ndarray:
    low, high = corners.min(axis=1), corners.max(axis=1)
    slack = 1e-6 * length[:, None]
    found = np.zeros(len(corners), dtype=bool)
    for refinement in wanted:
        inside = ((low < refinement.box[1] - slack) & (high > refinement.box[0] + slack)).all(axis=1)
        found |= inside & (length > refinement.edge_m * (1.0 + 1e-6))
    return found


def _cut_all(tets: np.ndarray, edges: np.ndarray, rank: np.ndarray, first: int) -> np.ndarray:
    """Cut tetrahedra at all of their marked ``edges`` ``(k, 2)``, the one of highest ``rank`` first. The middle of edge
    ``k`` is the node ``first + k``."""
    size = first + len(edges)
    keys = edges[:, 0] * size + edges[:, 1]
    by_key = np.argsort(keys)
    keys = keys[by_key]
    done = []
    while len(tets):
        pairs = np.sort(tets[:, tet10.EDGES], axis=2)
        own = pairs[..., 0].astype(np.int64) * size + pairs[..., 1]
        place = np.minimum(np.searchsorted(keys, own), len(keys) - 1)
        edge = np.where(keys[place] == own, by_key[place], -1)
        height = np.where(edge >= 0, rank[edge], -1)
        k = height.argmax(axis=1)
        row = np.arange(len(tets))
        whole = height[row, k] < 0
        done.append(tets[whole])
        row, k = row[~whole], k[~whole]
        halves = []
        for end in (0, 1):
            half = tets[row].copy()
            half[np.arange(len(row)), tet10.EDGES[k, end]] = first + edge[row, k]
            halves.append(half)
        tets = np.vstack(halves)
    return np.vstack(done)
