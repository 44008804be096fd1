"""From hinge angles to the curvature of each triangle, on any mesh.

By the divergence theorem the curvature of a triangle with area A follows from the normal slopes g_e at
the middles of its edges (length l_e, in-plane outward normal m_e), measured from its own plane:

    A kappa_T = sum_e l_e m_e m_e^T phi_(T,e),      phi_(T,e) = (g_e - grad w_T) . m_e

The hinge angle is the sum of the two sides' parts, theta_e = phi_(T,e) + phi_(N,e), because g_e is one
slope shared by both. That makes constant moments do no work on any local disturbance (the patch test);
halving the angle would do, but misplaces the slope where the neighbours differ in shape. On the quadratic
w = 1/2 kappa : (x x) the parts are Q_(T,e) : kappa with Q from the triangle's rest geometry, so

    phi_(T,e) = theta_e / 2 + (Q_(T,e) : K_T - Q_(N,e) : K_N) / 2

with K a least-squares fit of a constant curvature to the angles around each triangle reproduces constant
curvature exactly on any mesh and keeps the sum. At a free border phi = Q : K_T; next to a rigidly held
triangle the slope is that of the holder, phi = theta. Symmetric pairs of triangles reduce to the basic
shell triangle of Onate & Zarate, Rotation-free triangular plate and shell elements (2000).

So the operator is a sum over the edges k of each triangle T,

    B_T = sum_k d_k (x) row_k,    row_k = (e_h + r_k - r_k') / 2,    d_k = l_k / A_T m_k m_k^T,    r_k = Q_k : K_T

(r_k alone at a free border, e_h next to a held triangle; k': the same edge seen from the neighbour). d_k and r_k depend
on the patch of a triangle: its corners, and the apices of the hinges that its fit uses. All patches are evaluated at
once, with positions that may be complex (:mod:`sim_core.energies.curvature_rest`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp

from sim_core.geometry.sheets import Hinges

NEIGHBOUR_WEIGHT = 0.3
"""Weight of a hinge that is not the triangle's own in the fit of its curvature."""

SINGULAR_RATIO = 0.15
"""Smallest accepted ratio of singular values of a triangle's own three hinges."""


def curvature_operator(
    nodes: np.ndarray, triangles: np.ndarray, hinges: Hinges, frames: np.ndarray, rigid: np.ndarray
) -> sp.csr_matrix:
    """Operator ``(3 m, n_hinges)`` from angle changes [rad] to curvature changes [1/m].

    Voigt order 11, 22, 2*12 in the material axes ``frames`` ``(m, 3, 2)``. ``rigid``: bool ``(m,)``,
    triangles held as a whole; they have no curvature.
    """
    shape = (3 * len(triangles), len(hinges.nodes))
    if rigid.all() or not len(hinges.nodes):
        return sp.csr_matrix(shape)
    patches = CurvaturePatches(nodes, triangles, hinges, frames, rigid)
    directions, rows = patches.evaluate(nodes[patches.slots], frames[patches.used], _pseudo_inverse)
    other = patches.own[patches.other]
    parts = (
        (np.maximum(patches.hinge, 0)[..., None], patches.share_of_hinge[..., None]),
        (np.broadcast_to(patches.stencil[:, None], rows.shape), patches.share_of_fit[..., None] * rows),
        (patches.stencil[other], -patches.share_of_other[..., None] * rows[other, patches.across]),
    )
    columns, coefficients = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
    values = directions[..., None, :] * coefficients[..., None]
    at = 3 * patches.used[:, None, None, None] + np.arange(3)
    where = [np.broadcast_to(index, values.shape).ravel() for index in (at, columns[..., None])]
    matrix = sp.coo_matrix((values.ravel(), where), shape=shape).tocsr()
    matrix.data[np.abs(matrix.data) < 1e-10 * np.abs(matrix.data).max()] = 0.0
    matrix.eliminate_zeros()
    return matrix


def _pseudo_inverse(rows: np.ndarray) -> np.ndarray:
    return np.linalg.pinv(rows, rcond=1e-6)


class CurvaturePatches:
    """The triangles of a sheet at rest at ``nodes`` [m] ``(n, 3)`` that are not ``rigid`` ``(m,)``, ``used``, each with
    what its curvature depends on: the hinges of its fit, ``stencil`` ``(u, s)``, padded where not ``inside``, and its
    nodes, ``slots`` ``(u, p)``, corners first. ``frames``: material axes of all triangles ``(m, 3, 2)``.

    Per edge ``(u, 3)``: its ``hinge``, the triangle beyond it, ``other`` (-1 at a border), and the number ``across``
    that the edge has there. ``own``: place of a triangle among those used, or -1.
    """

    def __init__(
        self, nodes: np.ndarray, triangles: np.ndarray, hinges: Hinges, frames: np.ndarray, rigid: np.ndarray
    ) -> None:
        self._hinges, self._rigid = hinges, rigid
        self.used = np.flatnonzero(~rigid)
        self.own = np.full(len(triangles), -1)
        self.own[self.used] = np.arange(len(self.used))
        self._find_edges(triangles)
        around: list[list[int]] = [[] for _ in range(len(triangles))]
        sides = hinges.triangles.tolist()
        for h, (left, right) in enumerate(sides):
            if not (rigid[left] and rigid[right]):
                around[left].append(h)
                around[right].append(h)
        stencils = [around[t] for t in self.used]
        self._find_patches(triangles, stencils)
        poor = np.flatnonzero(~self._well_placed(nodes, frames))
        for row in poor:
            beyond = {side for h in stencils[row] for side in sides[h]} - {int(self.used[row])}
            stencils[row] = stencils[row] + sorted({h for t in beyond for h in around[t]} - set(stencils[row]))
        if len(poor):
            self._find_patches(triangles, stencils)

    def _find_edges(self, triangles: np.ndarray) -> None:
        hinge, other, across = np.full((3, len(triangles), 3), -1)
        sides, ends = self._hinges.triangles, np.sort(self._hinges.nodes[:, :2], axis=1)
        edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
        numbers = [(edges[side] == ends[:, None]).all(axis=-1).argmax(axis=1) for side in sides.T]
        for side, (here, there) in enumerate((numbers, numbers[::-1])):
            hinge[sides[:, side], here] = np.arange(len(sides))
            other[sides[:, side], here] = sides[:, 1 - side]
            across[sides[:, side], here] = there
        self.hinge, self.other, self.across = hinge[self.used], other[self.used], across[self.used]
        border, bends = self.hinge < 0, (self.other >= 0) & (self.own[self.other] >= 0)
        self.share_of_hinge = np.where(border, 0.0, np.where(bends, 0.5, 1.0))
        self.share_of_fit = np.where(border, 1.0, np.where(bends, 0.5, 0.0))
        self.share_of_other = np.where(bends, 0.5, 0.0)

    def _find_patches(self, triangles: np.ndarray, stencils: list[list[int]]) -> None:
        """Nodes of each patch in slots; how they are unfolded, own hinges first, so that the triangle beyond is flat
        before its own neighbours; the sides of its hinges by slots."""
        corners, nodes = triangles[self.used].tolist(), self._hinges.nodes.tolist()
        slots, ways, sides = [], [], []
        for row, stencil in enumerate(stencils):
            place = {node: k for k, node in enumerate(corners[row])}
            steps, ends = [], []
            for h in stencil:
                i, j, *apices = nodes[h]
                for new, known in (apices, apices[::-1]):
                    if new not in place and known in place:
                        place[new] = len(place)
                        steps.append((place[i], place[j], place[new], place[known]))
                ends.append([(place[i], place[j], place[apex]) for apex in apices])
            slots.append(list(place))
            ways.append(steps)
            sides.append(ends)
        count, most, longest = len(stencils), max(map(len, stencils)), max(map(len, slots))
        self.slots = np.array([s + [s[0]] * (longest - len(s)) for s in slots])
        self._ways = []
        for step in range(max(map(len, ways))):
            rows = [r for r, steps in enumerate(ways) if len(steps) > step]
            self._ways.append((np.array(rows), np.array([ways[r][step] for r in rows])))
        self._sides = np.array([s + [[(0, 1, 2)] * 2] * (most - len(s)) for s in sides]).reshape(count, most, 2, 3)
        self.inside = np.arange(most) < np.array([len(stencil) for stencil in stencils])[:, None]
        self.stencil = np.array([stencil + [0] * (most - len(stencil)) for stencil in stencils], dtype=int)
        self._sided = ~self._rigid[self._hinges.triangles[self.stencil]] & self.inside[..., None]
        own = (self.stencil[..., None] == self.hinge[:, None]).any(axis=-1)
        self.preference = np.where(own, 1.0, NEIGHBOUR_WEIGHT) * self.inside

    def _well_placed(self, nodes: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Which triangles have hinges enough in directions that differ enough, bool ``(u,)``."""
        rows = self.openings(self.unfold(nodes[self.slots], frames[self.used]))
        rows /= np.where(self.inside, np.linalg.norm(rows, axis=-1), 1.0)[..., None]
        if rows.shape[1] < 3:
            return np.zeros(len(rows), dtype=bool)
        sizes = np.linalg.svd(rows, compute_uv=False)
        return np.asarray((self.inside.sum(axis=1) >= 3) & (sizes[:, 2] > SINGULAR_RATIO * sizes[:, 0]))

    def evaluate(
        self, x: np.ndarray, frames: np.ndarray, inverse: Callable[[np.ndarray], np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """d ``(..., u, 3 edges, 3)`` and r ``(..., u, 3 edges, s)`` of patches ``(..., u, p, 3)`` in the axes
        ``frames`` ``(..., u, 3, 2)``. ``inverse``: of the equations of a fit ``(..., s, 3)``, by least squares."""
        flat = self.unfold(x, frames)
        rows = self.openings(flat)
        scale = np.where(self.inside, norm(np.where(self.inside[..., None], rows, 1.0)), 1.0)
        weight = self.preference / scale
        fit = inverse(rows * weight[..., None]) * weight[..., None, :]
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

    def unfold(self, x: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """Flatten patches into the axes of their triangles, ``(..., u, p, 2)``: each apex is turned about its edge."""
        flat = (x - x[..., :1, :]) @ frames
        for rows, ways in self._ways:
            i, j, new = (x[..., rows, ways[:, k], :] for k in range(3))
            edge = j - i
            length = norm(edge)
            along = ((new - i) * edge).sum(axis=-1) / length
            height = norm(new - i - (along / length)[..., None] * edge)
            start, end, _, near = (flat[..., rows, ways[:, k], :] for k in range(4))
            axis = (end - start) / norm(end - start)[..., None]
            side = np.stack([-axis[..., 1], axis[..., 0]], axis=-1)
            away = np.where((((near - start) * side).sum(axis=-1)).real > 0.0, -1.0, 1.0)
            flat[..., rows, ways[:, 2], :] = start + along[..., None] * axis + (away * height)[..., None] * side
        return np.asarray(flat)

    def openings(self, flat: np.ndarray) -> np.ndarray:
        """Opening of each hinge of the stencils per unit curvature (Voigt) [m], ``(..., u, s, 3)``: the sum of both
        sides' Q."""
        u = np.arange(len(self.slots))[:, None]
        out = 0.0
        for side in range(2):
            ends = (flat[..., u, self._sides[:, :, side, k], :] for k in range(3))
            out = out + self._sided[:, :, side, None] * _edge(*ends)[2]
        return np.asarray(out)


def _edge(p: np.ndarray, q: np.ndarray, apex: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outward normal, length [m] and slope part Q per unit curvature (Voigt) [m] of edges ``(..., 2)`` in a plane:
    (1/2 kappa : a a - 1/2 kappa : half half) / height, as a row on (k11, k22, 2 k12)."""
    length = norm(q - p)
    along = (q - p) / length[..., None]
    normal = np.stack([along[..., 1], -along[..., 0]], axis=-1)
    a, half = apex - 0.5 * (p + q), 0.5 * (q - p)
    inward = (a * normal).sum(axis=-1)
    turn = np.where(inward.real > 0.0, -1.0, 1.0)
    height = -turn * inward
    squares = [a[..., i] * a[..., j] - half[..., i] * half[..., j] for i, j in ((0, 0), (1, 1), (0, 1))]
    return turn[..., None] * normal, length, 0.5 * np.stack(squares, axis=-1) / height[..., None]


def norm(v: np.ndarray) -> np.ndarray:
    """Lengths along the last axis, as analytic functions."""
    return np.asarray(np.sqrt((v * v).sum(axis=-1)))
