"""Kernels of :mod:`sim_core.energies.bending`: angles, response of the triangles, forces, Hessian.

``harder``: hardening ratio of each triangle; ``rate``: its damping over the time of a rate.
"""

import taichi as ti

from sim_core.energies.dihedral import angle, angle_gradient, side_curvature
from sim_core.energies.plastic_flow import AT_YIELD
from sim_core.kernels import F1, F2, F3, I1, I2, mat3, row, times3, vec3


@ti.func
def _load(x: ti.template(), hinge: ti.template(), h: ti.i32):
    return (
        row(x, hinge[h, 0]),
        row(x, hinge[h, 1]),
        row(x, hinge[h, 2]),
        row(x, hinge[h, 3]),
    )


@ti.kernel
def angles(x: F2, hinge: I2, rest: F1, out: F1):
    """Deviation of the angles from rest [rad]."""
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        out[h] = angle(x0, x1, x2, x3) - rest[h]


@ti.func
def _curvature(t: ti.i32, d: ti.template(), first: ti.template(), around: ti.template(), b: ti.template(), less):
    """Curvature change of triangle ``t`` by the angles, ``less`` another one [1/m]."""
    kappa = -less
    for k in range(first[t], first[t + 1]):
        kappa += d[around[k]] * vec3(b[k, 0], b[k, 1], b[k, 2])
    return kappa


@ti.func
def _excess(c: ti.template(), t: ti.i32, kappa, moment, onset):
    """Norm of an elastic curvature if nothing flows, and by how much it is beyond the onset (0: it is not) [1/m]."""
    norm = ti.sqrt(kappa.dot(moment) / c[t, 0, 0])
    return norm, ti.max(norm - onset, 0.0)


@ti.kernel
def energy(
    d: F1, first: I1, around: I1, b: F2, plastic: F2, base: F2, onset: F1, area: F1, c: F3, harder: F1, rate: F1,
    out: F1,
):  # fmt: skip
    ti.loop_config(serialize=True)
    for t in range(area.shape[0]):
        kappa = _curvature(t, d, first, around, b, row(plastic, t))
        moment = times3(c, t, kappa)
        out[0] = out[0] + 0.5 * area[t] * kappa.dot(moment)
        _, excess = _excess(c, t, kappa, moment, onset[t])
        if excess > 0.0:
            out[0] = out[0] - 0.5 * area[t] * c[t, 0, 0] * excess**2 / (1.0 + harder[t])
        if rate[t] > 0.0:
            change = _curvature(t, d, first, around, b, row(base, t))
            out[0] = out[0] + 0.5 * area[t] * rate[t] * change.dot(times3(c, t, change))


@ti.kernel
def moments(
    d: F1, first: I1, around: I1, b: F2, plastic: F2, base: F2, onset: F1, area: F1, c: F3, harder: F1, rate: F1,
    out: F1,
):  # fmt: skip
    """Hinge moments [N m]."""
    ti.loop_config(serialize=True)
    for h in range(d.shape[0]):
        out[h] = 0.0
    ti.loop_config(serialize=True)
    for t in range(area.shape[0]):
        kappa = _curvature(t, d, first, around, b, row(plastic, t))
        m = times3(c, t, kappa)
        norm, excess = _excess(c, t, kappa, m, onset[t])
        if excess > 0.0:
            m *= 1.0 - excess / (1.0 + harder[t]) / norm
        if rate[t] > 0.0:
            m += rate[t] * times3(c, t, _curvature(t, d, first, around, b, row(base, t)))
        m *= area[t]
        for k in range(first[t], first[t + 1]):
            out[around[k]] = out[around[k]] + b[k, 0] * m[0] + b[k, 1] * m[1] + b[k, 2] * m[2]


@ti.kernel
def tangents(
    d: F1, first: I1, around: I1, b: F2, plastic: F2, onset: F1, c: F3, harder: F1, rate: F1, exact: I1, out: F3
):
    """Derivative of each triangle's moment per area by its curvature; unless ``exact``, the secant where it flows,
    which is larger. At yield it has not begun to flow, as in :mod:`sim_core.energies.plastic_flow`."""
    ti.loop_config(serialize=True)
    for t in range(onset.shape[0]):
        kappa = _curvature(t, d, first, around, b, row(plastic, t))
        m = times3(c, t, kappa)
        norm, excess = _excess(c, t, kappa, m, onset[t])
        share, turn = 1.0, 0.0
        if excess > 0.0:
            flow = 1.0 / (1.0 + harder[t])
            share = 1.0 - flow * excess / norm
            if exact[0] == 1 and excess > AT_YIELD * onset[t]:
                turn = (flow - flow * excess / norm) / (c[t, 0, 0] * norm**2)
        for i, j in ti.static(ti.ndrange(3, 3)):
            out[t, i, j] = (share + rate[t]) * c[t, i, j] - turn * m[i] * m[j]


@ti.kernel
def gradient(x: F2, hinge: I2, moment: F1, out: F2):
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        g = angle_gradient(x0, x1, x2, x3)
        for a in ti.static(range(4)):
            for j in ti.static(range(3)):
                out[hinge[h, a], j] = out[hinge[h, a], j] + moment[h] * g[3 * a + j]


@ti.kernel
def gradients(x: F2, hinge: I2, out: F2):
    """Store the twelve derivatives of every angle."""
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        g = angle_gradient(x0, x1, x2, x3)
        for k in ti.static(range(12)):
            out[h, k] = g[k]


@ti.kernel
def gauss_newton(
    g: F2, first: I1, around: I1, b: F2, place: I2, nodes: I1, area: F1, c: F3, start: I1, slots: I2, row: F2, out: F1
):
    """Add A L^T c L for each triangle. ``place``: columns of L where a hinge's nodes are; ``nodes``: how
    many; ``start``: the triangle's first block; ``row``: scratch for L and A c L, ``(columns, 6)``."""
    ti.loop_config(serialize=True)
    for t in range(area.shape[0]):
        for n in range(3 * nodes[t]):
            for r in ti.static(range(3)):
                row[n, r] = 0.0
        for k in range(first[t], first[t + 1]):
            h = around[k]
            for a in range(4):
                for j in ti.static(range(3)):
                    n = 3 * place[k, a] + j
                    for r in ti.static(range(3)):
                        row[n, r] = row[n, r] + b[k, r] * g[h, 3 * a + j]
        for n in range(3 * nodes[t]):
            for r in ti.static(range(3)):
                row[n, 3 + r] = area[t] * (c[t, r, 0] * row[n, 0] + c[t, r, 1] * row[n, 1] + c[t, r, 2] * row[n, 2])
        block = start[t]
        for p in range(nodes[t]):
            left = mat3(0.0)
            for i, r in ti.static(ti.ndrange(3, 3)):
                left[i, r] = row[3 * p + i, r]
            for q in range(p, nodes[t]):
                right = mat3(0.0)
                for r, j in ti.static(ti.ndrange(3, 3)):
                    right[r, j] = row[3 * q + j, 3 + r]
                m = left @ right
                if p == q:
                    for i, j in ti.static(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
                        at = slots[block, 3 * i + j]
                        out[at] = out[at] + m[i, j]
                else:
                    for i, j in ti.static(ti.ndrange(3, 3)):
                        at = slots[block, 3 * i + j]
                        out[at] = out[at] + m[i, j]
                block += 1


@ti.kernel
def curved(x: F2, hinge: I2, moment: F1, slots: I2, out: F1):
    """Add moment times the second derivative of the angle, side by side."""
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        for side in range(2):
            apex = x2
            turn = 1.0
            if side == 1:
                apex = x3
                turn = -1.0
            n, along, up, dc, dphi = side_curvature(x0, x1, apex, turn)
            block = 12 * h + 6 * side
            for i in range(3):
                for j in range(i, 3):
                    left = moment[h] * (dc[i, 2 * j] * along + dc[i, 2 * j + 1] * up)
                    right = (moment[h] * dphi[i, 2]) * (dphi[j, 0] * along + dphi[j, 1] * up)
                    for r in ti.static(range(3)):
                        for q in ti.static(range(3)):
                            if i != j or r <= q:
                                at = slots[block, 3 * r + q]
                                out[at] = out[at] + n[r] * left[q] - right[r] * n[q]
                    block += 1
