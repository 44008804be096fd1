"""Dihedral angle of a hinge with its first and second derivatives.

A hinge is an edge x0-x1 with the apices x2 (left triangle x0 x1 x2) and x3 (right triangle x1 x0 x3).
The angle is that between the two normals, positive when the faces fold towards the side that the
normals point to:

    theta = -atan2( (N1 x N2) . e / |e|, N1 . N2 ),   e = x1 - x0,
    N1 = e x (x2 - x0),   N2 = (x3 - x0) x e

Each side contributes c_i n to the gradient, with its unit normal n, the height h of its apex over the
edge and the place t of the apex along the edge (0 at x0, 1 at x1):

    c_apex = 1/h,   c_1 = -t/h,   c_0 = -(1 - t)/h

and therefore n (dc_i/dx_j)^T - c_i grad(phi_j) n^T to the second derivative, because a normal turns by
dn = -sum_j grad(phi_j) n . dx_j with the barycentric coordinates phi_j. All of dc_i and grad(phi_j) are in
the plane of the triangle. Tamstorf & Grinspun, Discrete bending forces and their Jacobians (2013).
"""

import numpy as np

from sim_core.core import language as lang
from sim_core.core.language import vec3

vec12 = lang.types.vector(12, lang.f64)


@lang.func
def angle(x0, x1, x2, x3):
    """Dihedral angle [rad] in (-pi, pi]."""
    e = x1 - x0
    n1 = e.cross(x2 - x0)
    n2 = (x3 - x0).cross(e)
    return -lang.atan2(n1.cross(n2).dot(e) / e.norm(), n1.dot(n2))


@lang.func
def angle_gradient(x0, x1, x2, x3):
    """d theta / d (x0, x1, x2, x3) [rad/m] as one 12-vector."""
    e = x1 - x0
    length = e.norm()
    n1 = e.cross(x2 - x0)
    n2 = (x3 - x0).cross(e)
    u1 = n1 / n1.norm_sqr()
    u2 = n2 / n2.norm_sqr()
    g2 = length * u1
    g3 = length * u2
    g0 = ((x2 - x1).dot(e) * u1 + (x3 - x1).dot(e) * u2) / length
    g1 = -((x2 - x0).dot(e) * u1 + (x3 - x0).dot(e) * u2) / length
    return vec12(g0[0], g0[1], g0[2], g1[0], g1[1], g1[2], g2[0], g2[1], g2[2], g3[0], g3[1], g3[2])


@lang.func
def side_curvature(x0, x1, apex, turn: lang.f64):
    """Second derivative of the angle that one side contributes, from coefficients on its edge direction
    and its in-plane normal: ``n``, the two directions, ``dc`` (3 x 6) and ``dphi`` (3 x 3, last column c).

    ``turn``: 1 for the left triangle, -1 for the right one (its normal is reversed).
    Rows of ``dc`` are i, columns (edge, normal) for each j; rows of ``dphi`` are j.
    """
    e = x1 - x0
    length = e.norm()
    along = e / length
    a = apex - x0
    s = a.dot(along)
    up = a - s * along
    h = up.norm()
    up = up / h
    n = turn * along.cross(up)
    t = s / length
    # Changes of height and place with each node, on (along, up).
    dh = vec3(-(1.0 - t), -t, 1.0)
    dt_along = vec3(-1.0 / length + s / length**2, -s / length**2, 1.0 / length)
    dt_up = vec3(-h / length**2, h / length**2, 0.0)
    dc = lang.Matrix.zero(lang.f64, 3, 6)
    dphi = lang.Matrix.zero(lang.f64, 3, 3)
    for j in lang.static(range(3)):
        dc[0, 2 * j] = dt_along[j] / h
        dc[0, 2 * j + 1] = dt_up[j] / h + (1.0 - t) / h**2 * dh[j]
        dc[1, 2 * j] = -dt_along[j] / h
        dc[1, 2 * j + 1] = -dt_up[j] / h + t / h**2 * dh[j]
        dc[2, 2 * j + 1] = -dh[j] / h**2
    dphi[0, 0] = -1.0 / length
    dphi[1, 0] = 1.0 / length
    dphi[0, 1] = -(1.0 - t) / h
    dphi[1, 1] = -t / h
    dphi[2, 1] = 1.0 / h
    dphi[0, 2] = -(1.0 - t) / h
    dphi[1, 2] = -t / h
    dphi[2, 2] = 1.0 / h
    return n, along, up, dc, dphi


def hinge_angles(x: np.ndarray, hinges: np.ndarray) -> np.ndarray:
    """Angles [rad] ``(h,)`` of hinges, int ``(h, 4)``, at positions ``x`` [m] ``(n, 3)``."""
    x0, x1, x2, x3 = (x[hinges[:, k]] for k in range(4))
    e = x1 - x0
    n1, n2 = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    across = (np.cross(n1, n2) * e).sum(axis=1) / np.linalg.norm(e, axis=1)
    return np.asarray(-np.arctan2(across, (n1 * n2).sum(axis=1)))


def angle_slopes(x: np.ndarray, hinges: np.ndarray) -> np.ndarray:
    """Their derivatives by the nodes of the hinges [rad/m] ``(h, 4, 3)``."""
    x0, x1, x2, x3 = (x[hinges[:, k]] for k in range(4))
    e = x1 - x0
    length = np.linalg.norm(e, axis=1)[:, None]
    normals = np.cross(e, x2 - x0), np.cross(x3 - x0, e)
    u1, u2 = (n / (n * n).sum(axis=1)[:, None] for n in normals)

    def along(v: np.ndarray) -> np.ndarray:
        return np.asarray((v * e).sum(axis=1)[:, None] / length)

    g0 = along(x2 - x1) * u1 + along(x3 - x1) * u2
    g1 = -(along(x2 - x0) * u1 + along(x3 - x0) * u2)
    return np.stack([g0, g1, length * u1, length * u2], axis=1)
