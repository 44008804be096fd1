"""Derivative of the curvature operator of a sheet by its shape at rest.

Weights of the operator of :mod:`sim_core.energies.curvature` make weights of all d_k and r_k of its triangles, and the
sum of these with their weights is differentiated patch by patch: a complex step (:mod:`sim_core.energies.linearised`)
of one node of all patches at once. The stencils of the fits count as given.
"""

from __future__ import annotations

import numpy as np

from sim_core.energies.curvature import CurvaturePatches, norm
from sim_core.errors import ConfigError
from sim_core.geometry.sheets import Hinges

_TINY = 1e-30

DEGENERATE = 1e-3
"""Least ratio of singular values of the fit of a curvature with which it is differentiated."""


class CurvatureRest(CurvaturePatches):
    """The operator of a sheet at rest at ``nodes`` [m] ``(n, 3)`` as a function of these. ``axes``: material direction
    1 of the triangles ``(m, 3)``; ``rigid``: bool ``(m,)``, triangles that are held as a whole."""

    def __init__(
        self, nodes: np.ndarray, triangles: np.ndarray, hinges: Hinges, axes: np.ndarray, rigid: np.ndarray
    ) -> None:
        super().__init__(nodes, triangles, hinges, frames_of(nodes[triangles], axes), rigid)
        self._nodes, self._axes = nodes, axes[self.used]
        self._find_pairs()
        self._check()
        self.directions, self.rows = self._at(nodes[self.slots])

    def _at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """d and r of patches (:meth:`evaluate`)."""
        return self.evaluate(x, frames_of(x[..., :3, :], self._axes), _least_squares)

    def _find_pairs(self) -> None:
        """Triangles and hinges on which the operator depends, int ``(2, k)``, zero entries of it included."""
        keys, many = [], len(self._hinges.nodes)
        stencils = [stencil[inside] for stencil, inside in zip(self.stencil, self.inside, strict=True)]
        for row, t in enumerate(self.used):
            beyond = self.own[self.other[row][self.other[row] >= 0]]
            around = [stencils[row], *(stencils[n] for n in beyond if n >= 0)]
            edges = self.hinge[row][self.hinge[row] >= 0]
            keys.append(int(t) * many + np.unique(np.concatenate([*around, edges])).astype(np.int64))
        self._keys = np.concatenate(keys) if keys else np.empty(0, dtype=np.int64)
        self.pairs = np.stack(np.divmod(self._keys, max(many, 1)))

    def _weights(self, by_operator: np.ndarray, triangle: np.ndarray, hinge: np.ndarray) -> np.ndarray:
        """Rows of weights of the operator at pairs that it has (nought elsewhere), ``(..., 3)``."""
        wanted = triangle * np.int64(len(self._hinges.nodes)) + hinge
        at = np.minimum(np.searchsorted(self._keys, wanted), len(self._keys) - 1)
        return np.where((self._keys[at] == wanted)[..., None], by_operator[at], 0.0)

    def _check(self) -> None:
        """Where the hinges around a triangle leave its curvature open, the operator jumps with the shape."""
        x = self._nodes[self.slots]
        rows = self.openings(self.unfold(x, frames_of(x[:, :3], self._axes))) * self.preference[..., None]
        scaled = rows / np.where(self.inside, np.linalg.norm(rows, axis=-1), 1.0)[..., None]
        sizes = np.linalg.svd(scaled * self.preference[..., None], compute_uv=False)
        poor = np.flatnonzero(sizes[:, 2] <= DEGENERATE * sizes[:, 0]) if sizes.shape[1] > 2 else np.arange(len(sizes))
        if len(poor):
            raise ConfigError(
                f"The hinges around {len(poor)} triangles of a sheet, {self.used[poor[0]]} to begin with, do not tell "
                "all components of its curvature apart, so bending has no derivative by its shape at rest.",
                "Give the sheet at least two cells in each direction, and more of them in a clamp's neighbourhood.",
            )

    def back(self, by_operator: np.ndarray) -> np.ndarray:
        """Derivative by the nodes ``(n, 3)`` of the sum of the operator's entries with the weights ``(k, 3)`` of its
        ``pairs``."""
        t, d, r = self.used, self.directions, self.rows
        other, share = self.own[self.other], self.share_of_other[..., None]
        own = self._weights(by_operator, t[:, None], self.stencil) * self.inside[..., None]
        edge = self._weights(by_operator, t[:, None], np.maximum(self.hinge, 0))
        theirs = self._weights(by_operator, t[:, None, None], self.stencil[other]) * self.inside[other][..., None]
        by_d = self.share_of_fit[..., None] * np.einsum("mks,msi->mki", r, own)
        by_d += self.share_of_hinge[..., None] * edge
        by_d -= share * np.einsum("mks,mksi->mki", r[other, self.across], theirs)
        by_r = self.share_of_fit[..., None] * np.einsum("mki,msi->mks", d, own)
        seen = self._weights(by_operator, self.other[..., None], self.stencil[:, None])
        seen = seen * self.inside[:, None, :, None]
        by_r -= share * np.einsum("mki,mksi->mks", d[other, self.across], seen)
        out = np.zeros_like(self._nodes)
        for slot in range(self.slots.shape[1]):
            moved = np.repeat(self._nodes[self.slots][None].astype(complex), 3, axis=0)
            moved[np.arange(3), :, slot, np.arange(3)] += 1j * _TINY
            directions, rows = self._at(moved)
            total = (directions * by_d).sum(axis=(-1, -2)) + (rows * by_r).sum(axis=(-1, -2))
            np.add.at(out, self.slots[:, slot], total.imag.T / _TINY)
        return out


def _least_squares(rows: np.ndarray) -> np.ndarray:
    """(A^T A)^-1 A^T, an analytic function."""
    transposed = np.swapaxes(rows, -1, -2)
    return np.linalg.solve(transposed @ rows, transposed)


def frames_of(corners: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """In-plane frames of triangles ``(..., m, 3, 3)`` as :func:`sim_core.energies.membrane.material_frames` has them,
    columns ``(..., m, 3, 2)``; complex corners too."""
    p, q, r = (corners[..., k, :] for k in range(3))
    normal = _cross(q - p, r - p)
    normal = normal / norm(normal)[..., None]
    first = axes - normal * (normal * axes).sum(axis=-1)[..., None]
    steep = (np.abs(first) ** 2).sum(axis=-1) < 1e-12
    first = np.where(steep[..., None], q - p, first)
    first = first / norm(first)[..., None]
    return np.stack([first, _cross(normal, first)], axis=-1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    p, q = [1, 2, 0], [2, 0, 1]
    return np.asarray(a[..., p] * b[..., q] - a[..., q] * b[..., p])
