"""Dihedral angle of a hinge with its first and second derivatives.

A hinge is an edge x0-x1 with the apices x2 (left triangle x0 x1 x2) and x3 (right triangle x1 x0 x3).
The angle is that between the two normals, positive when the faces fold towards the side that the
normals point to:

    theta = atan2( (N1 x N2) . e / |e|, N1 . N2 ),   e = x1 - x0,
    N1 = e x (x2 - x0),   N2 = (x3 - x0) x e

Gradient after Bridson, Marino & Fedkiw, Simulation of Clothing with Folds and Wrinkles (2003), and
Tamstorf & Grinspun, Discrete bending forces and their Jacobians (2013); the second derivative is the
directional derivative of that gradient along each of the twelve coordinates.
"""

import taichi as ti

from sim_core.kernels import vec3

mat12 = ti.types.matrix(12, 12, ti.f64)
vec12 = ti.types.vector(12, ti.f64)


@ti.func
def corner(x: ti.template(), i: ti.i32):
    return vec3(x[i, 0], x[i, 1], x[i, 2])


@ti.func
def angle(x0, x1, x2, x3):
    """Dihedral angle [rad] in (-pi, pi]."""
    e = x1 - x0
    n1 = e.cross(x2 - x0)
    n2 = (x3 - x0).cross(e)
    return -ti.atan2(n1.cross(n2).dot(e) / e.norm(), n1.dot(n2))


@ti.func
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


@ti.func
def _reciprocal_change(n, dn):
    """Change of n / |n|^2 along dn."""
    q = n.norm_sqr()
    return dn / q - n * (2.0 * n.dot(dn) / (q * q))


@ti.func
def angle_gradient_change(x0, x1, x2, x3, d0, d1, d2, d3):
    """Directional derivative of :func:`angle_gradient` along (d0, d1, d2, d3)."""
    e = x1 - x0
    de = d1 - d0
    length = e.norm()
    dlength = e.dot(de) / length
    n1 = e.cross(x2 - x0)
    n2 = (x3 - x0).cross(e)
    dn1 = de.cross(x2 - x0) + e.cross(d2 - d0)
    dn2 = (d3 - d0).cross(e) + (x3 - x0).cross(de)
    u1 = n1 / n1.norm_sqr()
    u2 = n2 / n2.norm_sqr()
    du1 = _reciprocal_change(n1, dn1)
    du2 = _reciprocal_change(n2, dn2)
    g2 = dlength * u1 + length * du1
    g3 = dlength * u2 + length * du2
    a1 = (x2 - x1).dot(e)
    a2 = (x3 - x1).dot(e)
    b1 = (x2 - x0).dot(e)
    b2 = (x3 - x0).dot(e)
    da1 = (d2 - d1).dot(e) + (x2 - x1).dot(de)
    da2 = (d3 - d1).dot(e) + (x3 - x1).dot(de)
    db1 = (d2 - d0).dot(e) + (x2 - x0).dot(de)
    db2 = (d3 - d0).dot(e) + (x3 - x0).dot(de)
    s0 = a1 * u1 + a2 * u2
    s1 = b1 * u1 + b2 * u2
    g0 = (da1 * u1 + a1 * du1 + da2 * u2 + a2 * du2) / length - s0 * (dlength / (length * length))
    g1 = -(db1 * u1 + b1 * du1 + db2 * u2 + b2 * du2) / length + s1 * (dlength / (length * length))
    return vec12(g0[0], g0[1], g0[2], g1[0], g1[1], g1[2], g2[0], g2[1], g2[2], g3[0], g3[1], g3[2])
