"""Contact and friction laws, per unit area of the touching surface.

Normal pressure against the gap g (negative = overlap), linear with stiffness k [Pa/m] and rounded over
the half width w so that it is differentiable:

    p(g) = 0                     g >= w
           k (w - g)^2 / (4 w)   |g| < w
           -k g                  g <= -w

Friction is Coulomb's law with an elastic pre-sliding spring (Prandtl's element): the tangential
traction follows the elastic slip u with stiffness k until it reaches mu times the normal pressure of
the start of the step, lambda_n,

    D(u) = k A |u|^2 / 2                          k A |u| <= mu lambda_n
           mu lambda_n |u| - (mu lambda_n)^2 / (2 k A)   beyond

so a resting contact holds its load without creep (a velocity-regularised law creeps) and the
threshold does not depend on direction. Wriggers, Computational Contact Mechanics, 2nd ed., sec. 4.2
and 10.5 (elastic slip, return mapping). Static above kinetic friction:
mu = mu_k (1 + a exp(-(v/v_s)^2)) with the slip speed v of the last step.
"""

import taichi as ti

from sim_core.kernels import mat3, vec3


@ti.func
def potential(g: ti.f64, k: ti.f64, w: ti.f64):
    """Energy per area [J/m^2]."""
    out = 0.0
    if g <= -w:
        out = k * (0.5 * g * g + w * w / 6.0)
    elif g < w:
        out = k * (w - g) ** 3 / (12.0 * w)
    return out


@ti.func
def pressure(g: ti.f64, k: ti.f64, w: ti.f64):
    """Pressure [Pa], not negative."""
    out = 0.0
    if g <= -w:
        out = -k * g
    elif g < w:
        out = k * (w - g) ** 2 / (4.0 * w)
    return out


@ti.func
def slope(g: ti.f64, k: ti.f64, w: ti.f64):
    """-dp/dg [Pa/m], not negative."""
    out = 0.0
    if g <= -w:
        out = k
    elif g < w:
        out = k * (w - g) / (2.0 * w)
    return out


@ti.func
def friction_potential(u, limit: ti.f64, stiffness: ti.f64):
    """Energy [J] of the elastic slip u [m]; ``limit`` = mu lambda_n [N], ``stiffness`` = k A [N/m]."""
    length = u.norm()
    out = 0.5 * stiffness * length * length
    if stiffness * length > limit:
        out = limit * length - 0.5 * limit * limit / stiffness
    return out


@ti.func
def friction_force(u, limit: ti.f64, stiffness: ti.f64):
    """dD/du [N]."""
    length = u.norm()
    out = stiffness * u
    if stiffness * length > limit:
        out = u * (limit / length)
    return out


@ti.func
def friction_stiffness(u, limit: ti.f64, stiffness: ti.f64, projector):
    """d2D/du2 [N/m] within the tangent plane of ``projector``; positive semidefinite."""
    length = u.norm()
    out = stiffness * projector
    if stiffness * length > limit:
        unit = u / length
        out = (projector - unit.outer_product(unit)) * (limit / length)
    return out


@ti.func
def tangent_projector(n):
    return mat3(1, 0, 0, 0, 1, 0, 0, 0, 1) - vec3(n[0], n[1], n[2]).outer_product(n)
