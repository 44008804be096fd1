"""Points, edges and triangles of a surface, as spheres around them."""

from __future__ import annotations

import numpy as np


class Primitives:
    """Points, edges or triangles. ``nodes``: int32 ``(n, k)``; ``weights``: ``(n, k)`` of points that lie
    between nodes, else None."""

    def __init__(self, nodes: np.ndarray, weights: np.ndarray | None = None) -> None:
        self.nodes = nodes
        self._weights = weights
        self.members = np.unique(nodes)
        self.stretch = 1.0 if weights is None else float(np.abs(weights).sum(axis=1).max(initial=1.0))
        """How many times further from a common mean than its nodes a point may move."""

    def spheres(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres [m] ``(n, 3)`` and radii [m] ``(n,)`` of spheres around them."""
        corners = x[self.nodes]
        if self._weights is not None:
            return np.einsum("nk,nkj->nj", self._weights, corners), np.zeros(len(corners))
        return _around(corners)

    def moves(self, move: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean of the nodes' moves [m] ``(n, 3)`` and the largest deviation from it [m] ``(n,)``."""
        if self._weights is not None:
            return np.einsum("nk,nkj->nj", self._weights, move[self.nodes]), np.zeros(len(self.nodes))
        return _around(move[self.nodes])


def _around(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Means of corners ``(n, k, 3)`` and the largest distances from them."""
    centres = corners.mean(axis=1)
    return centres, np.sqrt(((corners - centres[:, None]) ** 2).sum(axis=-1).max(axis=1))
