"""From hinge angles to the curvature of each triangle, exactly for quadratic surfaces.

On a surface w = 1/2 kappa : (x x) the hinge of a mesh edge opens by

    theta_e = (grad w_right - grad w_left) . m_e  =  G_e : kappa

where grad w are the gradients of the linear interpolants on both sides and m_e the in-plane normal of
the edge from left to right: linear in kappa, with G_e from the rest geometry alone. Each triangle
recovers its curvature from the angles of the hinges around it by weighted least squares,

    kappa_T = B_T theta,    B_T = argmin sum_e w_e ((theta_e - G_e : kappa) / |G_e|)^2

which reproduces a constant curvature on any mesh. An interior triangle has three hinges and the fit
is an interpolation (the quadratic through the six nodes of the patch). Where these are fewer (free
borders) or badly placed, the hinges of the neighbours join in with less weight; the misfit of such a
fit then enters the energy so that no combination of angles is free of charge. Compare Grinspun et al.,
Computing discrete shape operators on general meshes (2006), and Onate & Flores, Advances in the
formulation of the rotation-free basic shell triangle (2005).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from sim_core.geometry.sheets import Hinges

NEIGHBOUR_WEIGHT = 0.3
"""Weight of a hinge that is not the triangle's own in the fit of its curvature."""

SINGULAR_RATIO = 0.15
"""Smallest accepted ratio of singular values of a triangle's own three hinges."""


@dataclass(frozen=True)
class CurvatureOperator:
    """``kappa``: csr ``(3 m, n_hinges)``, angle [rad] to curvature [1/m] in Voigt order 11, 22, 2*12.
    ``misfit``: csr ``(n_rows, n_hinges)`` such that ``|misfit theta|^2`` is the area-weighted squared
    misfit curvature [-] of the least-squares fits."""

    kappa: sp.csr_matrix
    misfit: sp.csr_matrix


def curvature_operator(
    nodes: np.ndarray, triangles: np.ndarray, hinges: Hinges, frames: np.ndarray, areas: np.ndarray
) -> CurvatureOperator:
    """Build the operator. ``frames``: material axes of each triangle ``(m, 3, 2)``."""
    around: list[list[int]] = [[] for _ in range(len(triangles))]
    for h, (left, right) in enumerate(hinges.triangles.tolist()):
        around[left].append(h)
        around[right].append(h)
    rows, columns, values = [], [], []
    misfit_rows, misfit_columns, misfit_values = [], [], []
    n_misfit = 0
    for t in range(len(triangles)):
        own = around[t]
        if not own:
            continue
        stencil = list(own)
        flat = _unfold(nodes, triangles[t], hinges, stencil, frames[t])
        g = np.array([_opening(hinges.nodes[h], flat) for h in stencil])
        if len(own) < 3 or not _well_placed(g):
            sides = {s for h in own for s in hinges.triangles[h].tolist()} - {t}
            stencil += sorted({h for s in sides for h in around[s]} - set(own))
            flat = _unfold(nodes, triangles[t], hinges, stencil, frames[t])
            g = np.array([_opening(hinges.nodes[h], flat) for h in stencil])
        scale = np.linalg.norm(g, axis=1)
        weight = np.where(np.isin(stencil, own), 1.0, NEIGHBOUR_WEIGHT) / scale
        fit = np.linalg.pinv(weight[:, None] * g, rcond=1e-6) * weight[None, :]
        for i in range(3):
            rows += [3 * t + i] * len(stencil)
        columns += stencil * 3
        values += fit.ravel().tolist()
        if len(stencil) > 3:
            residual = (np.eye(len(stencil)) - g @ fit) * (weight * np.sqrt(areas[t]))[:, None]
            for k in range(len(stencil)):
                misfit_rows += [n_misfit + k] * len(stencil)
                misfit_columns += stencil
                misfit_values += residual[k].tolist()
            n_misfit += len(stencil)
    n_hinges = len(hinges.nodes)
    return CurvatureOperator(
        sp.csr_matrix((values, (rows, columns)), shape=(3 * len(triangles), n_hinges)),
        sp.csr_matrix((misfit_values, (misfit_rows, misfit_columns)), shape=(n_misfit, n_hinges)),
    )


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
    if i not in flat or j not in flat:
        return
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


def _opening(hinge: np.ndarray, flat: dict[int, np.ndarray]) -> np.ndarray:
    """G_e: opening of a hinge per unit curvature, Voigt (11, 22, 2*12) [m]."""
    p, q, left, right = (flat[int(n)] for n in hinge)
    axis = (q - p) / np.linalg.norm(q - p)
    normal = np.array([axis[1], -axis[0]])
    if (right - p) @ normal < 0:
        normal = -normal
    g = np.zeros(3)
    for k, shape in enumerate((((1.0, 0.0), (0.0, 0.0)), ((0.0, 0.0), (0.0, 1.0)), ((0.0, 0.5), (0.5, 0.0)))):
        matrix = np.asarray(shape)

        def height(point: np.ndarray, matrix: np.ndarray = matrix) -> float:
            return 0.5 * float(point @ matrix @ point)

        slopes = []
        for apex in (left, right):
            edges = np.array([q - p, apex - p])
            rise = np.array([height(q) - height(p), height(apex) - height(p)])
            slopes.append(np.linalg.solve(edges, rise))
        g[k] = (slopes[1] - slopes[0]) @ normal
    return g
