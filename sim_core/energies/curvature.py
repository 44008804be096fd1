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
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from sim_core.geometry.sheets import Hinges

NEIGHBOUR_WEIGHT = 0.3
"""Weight of a hinge that is not the triangle's own in the fit of its curvature."""

SINGULAR_RATIO = 0.15
"""Smallest accepted ratio of singular values of a triangle's own three hinges."""


def curvature_operator(
    nodes: np.ndarray,
    triangles: np.ndarray,
    hinges: Hinges,
    frames: np.ndarray,
    areas: np.ndarray,
    rigid: np.ndarray,
) -> sp.csr_matrix:
    """Operator ``(3 m, n_hinges)`` from angle changes [rad] to curvature changes [1/m].

    Voigt order 11, 22, 2*12 in the material axes ``frames`` ``(m, 3, 2)``. ``rigid``: bool ``(m,)``,
    triangles held as a whole; they have no curvature.
    """
    fits = curvature_fits(nodes, triangles, hinges, frames, rigid)
    rows: list[np.ndarray] = []
    columns: list[np.ndarray] = []
    values: list[np.ndarray] = []

    def add(t: int, direction: np.ndarray, hinge: np.ndarray, coefficient: np.ndarray) -> None:
        """Add ``direction`` (3,) times a row of coefficients on hinges to the curvature of ``t``."""
        rows.append(np.repeat(3 * t + np.arange(3), len(hinge)))
        columns.append(np.tile(hinge, 3))
        values.append(np.outer(direction, coefficient).ravel())

    edge_hinge = {frozenset(h[:2].tolist()): k for k, h in enumerate(hinges.nodes)}
    for t, corners in enumerate(triangles):
        own_fit = fits[t]
        if own_fit is None:
            continue
        flat = (nodes[corners] - nodes[corners[0]]) @ frames[t]
        for k in range(3):
            normal, length, q = _edge(flat, k)
            voigt = np.array([normal[0] ** 2, normal[1] ** 2, 2 * normal[0] * normal[1]])
            direction = length / areas[t] * voigt
            hinge = edge_hinge.get(frozenset((int(corners[k]), int(corners[(k + 1) % 3]))))
            if hinge is None:
                add(t, direction, own_fit[0], q @ own_fit[1])
                continue
            h = hinge
            sides = hinges.triangles[h]
            other = int(sides[0] if sides[1] == t else sides[1])
            other_fit = fits[other]
            if other_fit is None:
                add(t, direction, np.array([h]), np.ones(1))
                continue
            there = (nodes[triangles[other]] - nodes[triangles[other, 0]]) @ frames[other]
            edge = {int(corners[k]), int(corners[(k + 1) % 3])}
            at = next(j for j in range(3) if {int(triangles[other, j]), int(triangles[other, (j + 1) % 3])} == edge)
            q_other = _edge(there, at)[2]
            add(t, direction, np.array([h]), np.array([0.5]))
            add(t, direction, own_fit[0], 0.5 * (q @ own_fit[1]))
            add(t, direction, other_fit[0], -0.5 * (q_other @ other_fit[1]))
    shape = (3 * len(triangles), len(hinges.nodes))
    if not rows:
        return sp.csr_matrix(shape)
    matrix = sp.coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape
    ).tocsr()
    matrix.data[np.abs(matrix.data) < 1e-10 * np.abs(matrix.data).max()] = 0.0
    matrix.eliminate_zeros()
    return matrix


def curvature_fits(
    nodes: np.ndarray, triangles: np.ndarray, hinges: Hinges, frames: np.ndarray, rigid: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray] | None]:
    """Constant curvature that fits the angles around each triangle: hinges ``(k,)`` and ``(3, k)``; None where it is
    held. Arguments as of :func:`curvature_operator`."""
    around: list[list[int]] = [[] for _ in range(len(triangles))]
    for h, (left, right) in enumerate(hinges.triangles.tolist()):
        if not (rigid[left] and rigid[right]):
            around[left].append(h)
            around[right].append(h)
    return [
        None if rigid[t] else _fit(nodes, triangles, hinges, t, frames[t], around, rigid) for t in range(len(triangles))
    ]


def _edge(flat: np.ndarray, k: int) -> tuple[np.ndarray, float, np.ndarray]:
    """Outward normal, length [m] and slope part Q per unit curvature (Voigt) [m] of edge ``k``."""
    p, q, apex = flat[k], flat[(k + 1) % 3], flat[(k + 2) % 3]
    length = float(np.linalg.norm(q - p))
    along = (q - p) / length
    normal = np.array([along[1], -along[0]])
    middle = 0.5 * (p + q)
    a = apex - middle
    if a @ normal > 0:
        normal = -normal
    height = -float(a @ normal)
    half = 0.5 * length * along
    # (1/2 kappa : a a - 1/2 kappa : half half) / height, as a row on (k11, k22, 2 k12).
    row = 0.5 * np.array([a[0] ** 2 - half[0] ** 2, a[1] ** 2 - half[1] ** 2, a[0] * a[1] - half[0] * half[1]])
    return normal, length, row / height


def _fit(
    nodes: np.ndarray,
    triangles: np.ndarray,
    hinges: Hinges,
    t: int,
    frame: np.ndarray,
    around: list[list[int]],
    rigid: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Constant curvature that fits the angles around triangle ``t``: hinges ``(k,)``, ``(3, k)``."""
    own = around[t]
    stencil = list(own)
    flat = _unfold(nodes, triangles[t], hinges, stencil, frame)
    g = _openings(hinges, stencil, flat, rigid)
    if len(own) < 3 or not _well_placed(g):
        sides = {int(s) for h in own for s in hinges.triangles[h]} - {t}
        stencil += sorted({h for s in sides for h in around[s]} - set(own))
        flat = _unfold(nodes, triangles[t], hinges, stencil, frame)
        g = _openings(hinges, stencil, flat, rigid)
    scale = np.linalg.norm(g, axis=1)
    weight = np.where(np.isin(stencil, own), 1.0, NEIGHBOUR_WEIGHT) / scale
    fit = np.linalg.pinv(weight[:, None] * g, rcond=1e-6) * weight[None, :]
    return np.asarray(stencil), fit


def _openings(hinges: Hinges, stencil: list[int], flat: dict[int, np.ndarray], rigid: np.ndarray) -> np.ndarray:
    """Opening of each hinge per unit curvature (Voigt) [m], ``(k, 3)``: the sum of both sides' Q."""
    rows = np.zeros((len(stencil), 3))
    for row, h in zip(rows, stencil, strict=True):
        i, j, *apices = (int(n) for n in hinges.nodes[h])
        for apex, side in zip(apices, hinges.triangles[h], strict=True):
            if not rigid[side]:
                row += _edge(np.array([flat[i], flat[j], flat[apex]]), 0)[2]
    return rows


def _well_placed(g: np.ndarray) -> bool:
    s = np.linalg.svd(g / np.linalg.norm(g, axis=1, keepdims=True), compute_uv=False)
    return bool(s[-1] > SINGULAR_RATIO * s[0])


def _unfold(
    nodes: np.ndarray, corners: np.ndarray, hinges: Hinges, stencil: list[int], frame: np.ndarray
) -> dict[int, np.ndarray]:
    """Flatten a triangle and the hinges of ``stencil`` into its axes: node to 2-D position [m].

    Own hinges come first in the stencil, so the triangle beyond is flat before its own neighbours.
    """
    origin = nodes[corners[0]]
    flat = {int(i): (nodes[i] - origin) @ frame for i in corners}
    for h in stencil:
        _unfold_over(nodes, hinges.nodes[h], flat)
    return flat


def _unfold_over(nodes: np.ndarray, hinge: np.ndarray, flat: dict[int, np.ndarray]) -> None:
    """Place the one apex of ``hinge`` that is missing in ``flat`` by turning it about the edge."""
    i, j, k, m = (int(n) for n in hinge)
    for new, known in ((k, m), (m, k)):
        if new in flat or known not in flat:
            continue
        edge = nodes[j] - nodes[i]
        length = np.linalg.norm(edge)
        along = (nodes[new] - nodes[i]) @ edge / length
        height = np.linalg.norm(nodes[new] - nodes[i] - along * edge / length)
        axis = (flat[j] - flat[i]) / np.linalg.norm(flat[j] - flat[i])
        side = np.array([-axis[1], axis[0]])
        if (flat[known] - flat[i]) @ side > 0:
            side = -side
        flat[new] = flat[i] + along * axis + height * side
