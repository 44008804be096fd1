"""Nodes that are linear combinations of others: points of affine bodies, and what joints take away.

    x_i = sum_k w_ik x_k,    sum_k w_ik = 1,    x_k: independent nodes

The same weights hold for motions, and their transpose carries forces from the embedded nodes to the independent
ones. Linear constraints between nodes, sum_k c_k x_k = 0 (two bodies share a point), are solved for one node each
(:func:`eliminate`), which is then embedded in the others: they hold exactly and leave no multiplier.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

DEPENDENT = 1e-9
"""A constraint whose largest coefficient is below this share of what it was follows from the others."""


@dataclass(frozen=True)
class Embedding:
    """``nodes``: int ``(k,)``; ``weights``: csr ``(k, n_nodes)``, zero at embedded nodes, rows that sum to one."""

    nodes: np.ndarray
    weights: sp.csr_matrix
    _forces: sp.csr_matrix = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.weights[:, self.nodes].count_nonzero():
            raise ValueError("embedded nodes have to be combinations of independent ones")
        object.__setattr__(self, "_forces", self.weights.T.tocsr())

    def fill(self, x: np.ndarray) -> None:
        """Write positions or motions ``(n, 3)`` of the embedded nodes from those of the others, in place."""
        x[self.nodes] = self.weights @ x

    def fold(self, forces: np.ndarray) -> np.ndarray:
        """Forces ``(n, 3)`` on the independent nodes that do the same work; zero on the embedded ones."""
        out: np.ndarray = forces + self._forces @ forces[self.nodes]
        out[self.nodes] = 0.0
        return out

    def matrix(self) -> sp.csr_matrix:
        """Positions of all nodes from those of the independent ones, ``(n, n)``."""
        n = self.weights.shape[1]
        kept = np.ones(n)
        kept[self.nodes] = 0.0
        put = sp.csr_matrix((np.ones(len(self.nodes)), (self.nodes, np.arange(len(self.nodes)))), (n, len(self.nodes)))
        return (sp.diags(kept) + put @ self.weights).tocsr()


def eliminate(constraints: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve ``constraints`` ``(m, n)``, rows c with sum_k c_k x_k = 0, for as many of the ``free`` nodes (bool
    ``(n,)``) as are independent, the largest coefficients first.

    Returns these nodes ``(r,)``, their weights on the others ``(r, n)``, and what is left of the rows that could not
    be solved for any: conditions on nodes that are not free ``(s, n)``.
    """
    rows = np.array(constraints, dtype=float)
    size = np.abs(rows).max(axis=1, initial=0.0)
    open_rows = np.ones(len(rows), dtype=bool)
    solved: list[tuple[int, int]] = []
    allowed = free.copy()
    while open_rows.any() and allowed.any():
        candidates = np.where(open_rows[:, None] & allowed, np.abs(rows) / size[:, None], 0.0)
        row, node = np.unravel_index(int(np.argmax(candidates)), candidates.shape)
        if candidates[row, node] < DEPENDENT:
            break
        rows[row] /= rows[row, node]
        size[row] = 1.0
        others = np.arange(len(rows)) != row
        rows[others] -= rows[others, node, None] * rows[row]
        rows[others, node] = 0.0
        open_rows[row], allowed[node] = False, False
        solved.append((int(row), int(node)))
    nodes = np.array([node for _, node in solved], dtype=int)
    weights = -rows[[row for row, _ in solved]]
    weights[np.arange(len(nodes)), nodes] = 0.0
    left = rows[open_rows]
    return nodes, weights, left[np.abs(left).max(axis=1, initial=0.0) > DEPENDENT * size[open_rows]]


def embed(
    n_nodes: int, points: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]], solved: tuple[np.ndarray, np.ndarray]
) -> Embedding:
    """Embedding of ``points``, each (nodes ``(p,)``, masters ``(k,)``, weights ``(p, k)``), and of the nodes that
    :func:`eliminate` has ``solved`` for (nodes, their weights), on which points may depend in turn."""
    nodes, weights = solved
    through = sp.identity(n_nodes, format="lil")
    for node, row in zip(nodes, weights, strict=True):
        through[node] = sp.csr_matrix(np.where(np.abs(row) > 1e-14, row, 0.0))
    through = through.tocsr()
    parts = [through[nodes]]
    for members, masters, share in points:
        rows, columns = np.repeat(np.arange(len(members)), len(masters)), np.tile(masters, len(members))
        parts.append(sp.csr_matrix((share.ravel(), (rows, columns)), (len(members), n_nodes)) @ through)
    return Embedding(np.concatenate([nodes, *(members for members, _, _ in points)]), sp.vstack(parts).tocsr())
