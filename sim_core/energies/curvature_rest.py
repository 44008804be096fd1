"""Derivative of the curvature operator of a sheet by its shape at rest.

The operator of :mod:`sim_core.energies.curvature` is a sum over the edges k of each triangle T,

    B_T = sum_k d_k (x) row_k,    row_k = (e_h + r_k - r_k') / 2,    d_k = l_k / A_T m_k m_k^T,    r_k = Q_k : K_T

(r_k alone at a free border, e_h next to a held triangle; k': the same edge seen from the neighbour). d_k and r_k depend
on a triangle and on those whose hinges its fit uses. So weights of B make weights of all d_k and r_k, and the sum of
these with their weights is differentiated patch by patch: a complex step (:mod:`sim_core.energies.linearised`) of one
node of all patches at once. The stencils of the fits count as given.
"""

from __future__ import annotations

import numpy as np

from sim_core.energies.curvature import NEIGHBOUR_WEIGHT, curvature_fits
from sim_core.errors import ConfigError
from sim_core.geometry.sheets import Hinges

_TINY = 1e-30

DEGENERATE = 1e-3
"""Least ratio of singular values of the fit of a curvature with which it is differentiated."""


class CurvatureRest:
    """The operator of a sheet at rest at ``nodes`` [m] ``(n, 3)`` as a function of these. ``axes``: material direction
    1 of the triangles ``(m, 3)``; ``rigid``: bool ``(m,)``, triangles that are held as a whole."""

    def __init__(
        self, nodes: np.ndarray, triangles: np.ndarray, hinges: Hinges, axes: np.ndarray, rigid: np.ndarray
    ) -> None:
        self._nodes, self._hinges, self._axes = nodes, hinges, axes
        frames = frames_of(nodes[triangles], axes)
        fits = curvature_fits(nodes, triangles, hinges, frames, rigid)
        self._used = np.flatnonzero(~rigid)
        self._own = np.full(len(triangles), -1)
        self._own[self._used] = np.arange(len(self._used))
        self._stencils = [np.empty(0, dtype=int) if fit is None else fit[0] for fit in fits]
        self._find_edges(triangles)
        self._find_patches(triangles, rigid)
        self._find_pairs()
        self._check()
        self.directions, self.rows = self._evaluate(nodes[self._slots])

    def _find_edges(self, triangles: np.ndarray) -> None:
        """The hinge at each edge of the triangles used, -1 at a border, and the edge from the other side ``(m, 3)``."""
        count = len(triangles)
        at = {frozenset(pair[:2].tolist()): h for h, pair in enumerate(self._hinges.nodes)}
        edges = [[frozenset((int(t[k]), int(t[(k + 1) % 3]))) for k in range(3)] for t in triangles]
        self._hinge = np.array([[at.get(e, -1) for e in three] for three in edges]).reshape(count, 3)[self._used]
        self._other = np.full((len(self._used), 3), -1)
        self._across = np.zeros((len(self._used), 3), dtype=int)
        for row, t in enumerate(self._used):
            for k in range(3):
                if self._hinge[row, k] >= 0:
                    sides = self._hinges.triangles[self._hinge[row, k]]
                    other = int(sides[0] if sides[1] == t else sides[1])
                    self._other[row, k] = other
                    self._across[row, k] = edges[other].index(edges[t][k])

    def _find_patches(self, triangles: np.ndarray, rigid: np.ndarray) -> None:
        """Nodes of each patch in slots, corners first; how they are unfolded; the sides of its hinges by slots."""
        slots, unfolded, sides, sided = [], [], [], []
        for t in self._used:
            place = {int(node): k for k, node in enumerate(triangles[t])}
            ways, ends, counts = [], [], []
            for h in self._stencils[t]:
                i, j, *apices = (int(n) for n in self._hinges.nodes[h])
                for new, known in (apices, apices[::-1]):
                    if new not in place and known in place:
                        place[new] = len(place)
                        ways.append((place[i], place[j], place[new], place[known]))
                ends.append([(place[i], place[j], place[apex]) for apex in apices])
                counts.append([not rigid[side] for side in self._hinges.triangles[h]])
            slots.append(list(place))
            unfolded.append(ways)
            sides.append(ends)
            sided.append(counts)
        count, most = len(self._used), max(map(len, sides), default=0)
        self._slots = np.array([s + [s[0]] * (max(map(len, slots)) - len(s)) for s in slots]).reshape(count, -1)
        self._ways = []
        for u in range(max(map(len, unfolded), default=0)):
            rows = [r for r, ways in enumerate(unfolded) if len(ways) > u]
            self._ways.append((np.array(rows), np.array([unfolded[r][u] for r in rows])))
        self._sides = np.array([s + [[(0, 1, 2)] * 2] * (most - len(s)) for s in sides]).reshape(count, most, 2, 3)
        self._sided = np.array([s + [[False] * 2] * (most - len(s)) for s in sided]).reshape(count, most, 2)
        sizes = [len(self._stencils[t]) for t in self._used]
        self._stencil = np.array(
            [[*self._stencils[t], *[0] * (most - n)] for t, n in zip(self._used, sizes, strict=True)], dtype=int
        ).reshape(count, most)
        self._inside = np.arange(most) < np.array(sizes)[:, None]
        own = (self._stencil[..., None] == self._hinge[:, None]).any(axis=-1)
        self._preference = np.where(own, 1.0, NEIGHBOUR_WEIGHT) * self._inside

    def _find_pairs(self) -> None:
        """Triangles and hinges on which the operator depends, int ``(2, k)``, zero entries of it included."""
        keys, many = [], len(self._hinges.nodes)
        for row, t in enumerate(self._used):
            around = [self._stencils[t], *(self._stencils[n] for n in self._other[row] if n >= 0)]
            edges = self._hinge[row][self._hinge[row] >= 0]
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
        rows = self._openings(self._unfold(self._nodes[self._slots])) * self._preference[..., None]
        scaled = rows / np.where(self._inside, np.linalg.norm(rows, axis=-1), 1.0)[..., None]
        sizes = np.linalg.svd(scaled * self._preference[..., None], compute_uv=False)
        poor = np.flatnonzero(sizes[:, 2] <= DEGENERATE * sizes[:, 0]) if sizes.shape[1] > 2 else np.arange(len(sizes))
        if len(poor):
            raise ConfigError(
                f"The hinges around {len(poor)} triangles of a sheet, {self._used[poor[0]]} to begin with, do not tell "
                "all components of its curvature apart, so bending has no derivative by its shape at rest.",
                "Give the sheet at least two cells in each direction, and more of them in a clamp's neighbourhood.",
            )

    def back(self, by_operator: np.ndarray) -> np.ndarray:
        """Derivative by the nodes ``(n, 3)`` of the sum of the operator's entries with the weights ``(k, 3)`` of its
        ``pairs``."""
        t, d, r = self._used, self.directions, self.rows
        open_edge, other = self._hinge < 0, self._own[self._other]
        bends = ~open_edge & (other >= 0)
        share = np.where(open_edge, 1.0, np.where(bends, 0.5, 0.0))
        own = self._weights(by_operator, t[:, None], self._stencil) * self._inside[..., None]
        edge = self._weights(by_operator, t[:, None], np.maximum(self._hinge, 0))
        theirs = self._weights(by_operator, t[:, None, None], self._stencil[other]) * self._inside[other][..., None]
        by_d = share[..., None] * np.einsum("mks,msi->mki", r, own)
        by_d += np.where(open_edge, 0.0, np.where(bends, 0.5, 1.0))[..., None] * edge
        by_d -= np.where(bends, 0.5, 0.0)[..., None] * np.einsum("mks,mksi->mki", r[other, self._across], theirs)
        by_r = share[..., None] * np.einsum("mki,msi->mks", d, own)
        seen = self._weights(by_operator, self._other[..., None], self._stencil[:, None])
        seen = seen * self._inside[:, None, :, None]
        by_r -= np.where(bends, 0.5, 0.0)[..., None] * np.einsum("mki,mksi->mks", d[other, self._across], seen)
        out = np.zeros_like(self._nodes)
        for slot in range(self._slots.shape[1]):
            moved = np.repeat(self._nodes[self._slots][None].astype(complex), 3, axis=0)
            moved[np.arange(3), :, slot, np.arange(3)] += 1j * _TINY
            directions, rows = self._evaluate(moved)
            total = (directions * by_d).sum(axis=(-1, -2)) + (rows * by_r).sum(axis=(-1, -2))
            np.add.at(out, self._slots[:, slot], total.imag.T / _TINY)
        return out

    def _evaluate(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """d ``(..., m, 3 edges, 3)`` and r ``(..., m, 3 edges, s)`` of patches ``(..., m, slots, 3)``."""
        flat = self._unfold(x)
        rows = self._openings(flat)
        scale = np.where(self._inside, _norm(np.where(self._inside[..., None], rows, 1.0)), 1.0)
        weight = self._preference / scale
        scaled = rows * weight[..., None]
        square = np.swapaxes(scaled, -1, -2) @ scaled
        fit = np.linalg.solve(square, np.swapaxes(scaled * weight[..., None], -1, -2))
        corners = flat[..., :3, :]
        sides = corners[..., 1:, :] - corners[..., :1, :]
        area = 0.5 * (sides[..., 0, 0] * sides[..., 1, 1] - sides[..., 0, 1] * sides[..., 1, 0])
        directions, parts = [], []
        for k in range(3):
            normal, length, q = _edge(*(corners[..., (k + j) % 3, :] for j in range(3)))
            voigt = np.stack([normal[..., 0] ** 2, normal[..., 1] ** 2, 2.0 * normal[..., 0] * normal[..., 1]], axis=-1)
            directions.append((length / area)[..., None] * voigt)
            parts.append((q[..., None, :] @ fit)[..., 0, :])
        return np.stack(directions, axis=-2), np.stack(parts, axis=-2)

    def _unfold(self, x: np.ndarray) -> np.ndarray:
        """Flatten patches into the axes of their triangles, ``(..., m, slots, 2)``."""
        frames = frames_of(x[..., :3, :], self._axes[self._used])
        flat = (x - x[..., :1, :]) @ frames
        for rows, ways in self._ways:
            i, j, new = (x[..., rows, ways[:, k], :] for k in range(3))
            edge = j - i
            length = _norm(edge)
            along = ((new - i) * edge).sum(axis=-1) / length
            height = _norm(new - i - (along / length)[..., None] * edge)
            start, end, _, near = (flat[..., rows, ways[:, k], :] for k in range(4))
            axis = (end - start) / _norm(end - start)[..., None]
            side = np.stack([-axis[..., 1], axis[..., 0]], axis=-1)
            away = np.where((((near - start) * side).sum(axis=-1)).real > 0.0, -1.0, 1.0)
            flat[..., rows, ways[:, 2], :] = start + along[..., None] * axis + (away * height)[..., None] * side
        return np.asarray(flat)

    def _openings(self, flat: np.ndarray) -> np.ndarray:
        """Opening of each hinge of the stencils per unit curvature (Voigt) [m], ``(..., m, s, 3)``."""
        m = np.arange(len(self._slots))[:, None]
        out = 0.0
        for side in range(2):
            ends = (flat[..., m, self._sides[:, :, side, k], :] for k in range(3))
            out = out + self._sided[:, :, side, None] * _edge(*ends)[2]
        return np.asarray(out)


def _edge(p: np.ndarray, q: np.ndarray, apex: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outward normal, length [m] and slope part Q per unit curvature (Voigt) [m] of edges ``(..., 2)`` in a plane."""
    length = _norm(q - p)
    along = (q - p) / length[..., None]
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    a, half = apex - 0.5 * (p + q), 0.5 * (q - p)
    inward = (a * normal).sum(axis=-1)
    turn = np.where(inward.real > 0.0, -1.0, 1.0)
    height = -turn * inward
    squares = [a[..., i] * a[..., j] - half[..., i] * half[..., j] for i, j in ((0, 0), (1, 1), (0, 1))]
    return turn[..., None] * normal, length, 0.5 * np.stack(squares, axis=-1) / height[..., None]


def frames_of(corners: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """In-plane frames of triangles ``(..., m, 3, 3)`` as :func:`sim_core.energies.membrane.material_frames` has them,
    columns ``(..., m, 3, 2)``; complex corners too."""
    p, q, r = (corners[..., k, :] for k in range(3))
    normal = _cross(q - p, r - p)
    normal = normal / _norm(normal)[..., None]
    first = axes - normal * (normal * axes).sum(axis=-1)[..., None]
    steep = (np.abs(first) ** 2).sum(axis=-1) < 1e-12
    first = np.where(steep[..., None], q - p, first)
    first = first / _norm(first)[..., None]
    return np.stack([first, _cross(normal, first)], axis=-1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    p, q = [1, 2, 0], [2, 0, 1]
    return np.asarray(a[..., p] * b[..., q] - a[..., q] * b[..., p])


def _norm(v: np.ndarray) -> np.ndarray:
    """Lengths along the last axis, as analytic functions."""
    return np.asarray(np.sqrt((v * v).sum(axis=-1)))
