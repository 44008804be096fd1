"""What contact measures on the shape at rest: areas that samples and edges stand for, and squared lengths of edges."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from sim_core.geometry.sheets import area_slopes


class Measures(Protocol):
    """Some numbers of the shape at rest, ``count`` of them."""

    @property
    def count(self) -> int: ...

    def back(self, rest: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Derivative by the nodes ``(n_nodes, 3)``, at rest at ``rest`` [m], of the sum of the measures with
        ``weights`` ``(count,)``."""
        ...


@dataclass(frozen=True)
class SharedAreas:
    """Areas [m^2] that are shares of those of ``triangles``, int ``(m, 3)``: ``shares`` csr ``(count, m)``."""

    triangles: np.ndarray
    shares: sp.csr_matrix

    @property
    def count(self) -> int:
        return int(self.shares.shape[0])

    def back(self, rest: np.ndarray, weights: np.ndarray) -> np.ndarray:
        slopes = (self.shares.T @ weights)[:, None, None] * area_slopes(rest, self.triangles)
        out = np.zeros_like(rest)
        np.add.at(out, self.triangles, slopes)
        return out


@dataclass(frozen=True)
class SquaredLengths:
    """Squared lengths [m^2] of ``edges``, int ``(count, 2)``."""

    edges: np.ndarray

    @property
    def count(self) -> int:
        return len(self.edges)

    def back(self, rest: np.ndarray, weights: np.ndarray) -> np.ndarray:
        slopes = 2.0 * weights[:, None] * (rest[self.edges[:, 1]] - rest[self.edges[:, 0]])
        out = np.zeros_like(rest)
        np.add.at(out, self.edges, np.stack([-slopes, slopes], axis=1))
        return out


def equal_shares(corners: np.ndarray, triangles: np.ndarray, count: int) -> SharedAreas:
    """A third of each triangle for each of its ``corners`` (or edges), int ``(m, 3)`` below ``count``."""
    which = np.repeat(np.arange(len(corners)), 3)
    shares = sp.csr_matrix((np.full(corners.size, 1.0 / 3.0), (corners.ravel(), which)), shape=(count, len(corners)))
    return SharedAreas(triangles, shares)
