"""The quadratic tetrahedron: shape functions, their gradients, quadrature.

Node order: corners 0 1 2 3, then the mid-edges of 01, 12, 02, 03, 13, 23 (the order of VTK and Abaqus
C3D10). With barycentric coordinates L the shape functions are L_i (2 L_i - 1) at the corners and
4 L_i L_j on the edges (Zienkiewicz and Taylor, The Finite Element Method, vol. 1).
"""

from __future__ import annotations

import numpy as np
from scipy.special import roots_jacobi

EDGES = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
"""Corners joined by each mid-edge node; mid-edge ``k`` is node ``4 + k``."""

FACES = np.array([[1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6], [0, 1, 3, 4, 8, 7], [0, 2, 1, 6, 5, 4]])
"""The four quadratic faces (a, b, c, ab, bc, ca), normals outward when det(x1-x0, x2-x0, x3-x0) > 0."""


def shape(barycentric: np.ndarray) -> np.ndarray:
    """Shape functions at barycentric points ``(n, 4)``: ``(n, 10)`` [-]."""
    corners = barycentric * (2.0 * barycentric - 1.0)
    edges = 4.0 * barycentric[:, EDGES[:, 0]] * barycentric[:, EDGES[:, 1]]
    return np.concatenate([corners, edges], axis=1)


def shape_derivative(barycentric: np.ndarray) -> np.ndarray:
    """Derivatives of the shape functions by (L1, L2, L3), with L0 = 1 - L1 - L2 - L3: ``(n, 10, 3)`` [-]."""
    by_l = np.zeros((len(barycentric), 10, 4))
    corner = np.arange(4)
    by_l[:, corner, corner] = 4.0 * barycentric - 1.0
    for k, (i, j) in enumerate(EDGES):
        by_l[:, 4 + k, i] = 4.0 * barycentric[:, j]
        by_l[:, 4 + k, j] = 4.0 * barycentric[:, i]
    derivative: np.ndarray = by_l[:, :, 1:] - by_l[:, :, :1]
    return derivative


def jacobian(corners_and_edges: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
    """dX/dL of elements ``(m, 10, 3)`` [m] at points ``(q, 4)``: ``(m, q, 3, 3)`` [m]."""
    jac: np.ndarray = np.einsum("mai,qaj->mqij", corners_and_edges, shape_derivative(barycentric))
    return jac


def gradients(corners_and_edges: np.ndarray, barycentric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the shape functions by rest position, and the Jacobian determinant.

    ``corners_and_edges``: rest positions ``(m, 10, 3)`` [m]; ``barycentric``: ``(q, 4)``. Returns
    dN_a/dX_j as ``(m, q, 10, 3)`` [1/m] and det dX/dL as ``(m, q)`` [m^3].
    """
    jac = jacobian(corners_and_edges, barycentric)
    gradient = np.einsum("qak,mqkj->mqaj", shape_derivative(barycentric), np.linalg.inv(jac))
    return gradient, np.linalg.det(jac)


def four_point_rule() -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points ``(4, 4)`` and weights ``(4,)`` that integrate quadratics; weights sum to 1/6."""
    near = (5.0 + 3.0 * np.sqrt(5.0)) / 20.0
    far = (5.0 - np.sqrt(5.0)) / 20.0
    return np.full((4, 4), far) + (near - far) * np.eye(4), np.full(4, 1.0 / 24.0)


def conical_rule(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric points ``(n^3, 4)`` and weights exact to degree ``2 n - 1``; weights sum to 1/6.

    Gauss-Jacobi product over the collapsed cube (Stroud, Approximate Calculation of Multiple
    Integrals, 1971).
    """
    rules = []
    for power in (2, 1, 0):
        points, weights = roots_jacobi(n, power, 0)
        rules.append(((1.0 + points) / 2.0, weights / 2.0 ** (power + 1)))
    (a, wa), (b, wb), (c, wc) = rules
    a, b, c = (g.ravel() for g in np.meshgrid(a, b, c, indexing="ij"))
    wa, wb, wc = (g.ravel() for g in np.meshgrid(wa, wb, wc, indexing="ij"))
    l1, l2, l3 = a, b * (1.0 - a), c * (1.0 - a) * (1.0 - b)
    return np.stack([1.0 - l1 - l2 - l3, l1, l2, l3], axis=1), wa * wb * wc
