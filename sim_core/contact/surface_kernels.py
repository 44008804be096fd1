"""Kernels of :mod:`sim_core.contact.surface`: the gap of every sample, then energy and derivatives from it.

A sample ``s`` has the nodes ``own[s]`` with ``weights[s]`` and the candidate triangles
``near[first[s]:first[s + 1]]``.
"""

import taichi as ti

from sim_core.contact.closest import closest_point, distance_second_derivative
from sim_core.contact.law import (
    friction_force,
    friction_potential,
    friction_stiffness,
    potential,
    pressure,
    slope,
    tangent_projector,
)
from sim_core.kernels import F1, F2, F3, I1, I2, add_block, vec3

STIFFNESS, WIDTH, MU, EXCESS, SLIP_SCALE, OFFSET = range(6)
FAR = 1e30
"""Gap [m] of a sample without candidates."""


@ti.func
def _row(x: ti.template(), i: ti.i32):
    return vec3(x[i, 0], x[i, 1], x[i, 2])


@ti.func
def _sample(x: ti.template(), own: ti.template(), weights: ti.template(), s: ti.i32):
    p = vec3(0.0, 0.0, 0.0)
    for a in range(weights.shape[1]):
        p += weights[s, a] * _row(x, own[s, a])
    return p


@ti.kernel
def measure(
    x: F2, own: I2, weights: F2, triangles: I2, border: I2, first: I1, near: I1, normals: F2, side: F1, c: F1,
    chosen: I1, at: F2, direction: F2, gap: F1, sign: F1, kind: I1, height: F1,
):  # fmt: skip
    """Nearest triangle of every sample (-1: none), barycentric weights on it, gap [m] and its gradient.

    ``sign`` of the distance; ``kind``: 3 face, 2 edge, 1 corner; ``height``: over the face, any scale.
    """
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        chosen[s] = -1
        gap[s] = FAR
        height[s] = 0.0
        if first[s] < first[s + 1]:
            p = _sample(x, own, weights, s)
            best = FAR
            for k in range(first[s], first[s + 1]):
                t = near[k]
                y0, y1, y2 = _row(x, triangles[t, 0]), _row(x, triangles[t, 1]), _row(x, triangles[t, 2])
                b, feature = closest_point(p, y0, y1, y2)
                d = (p - b[0] * y0 - b[1] * y1 - b[2] * y2).norm()
                if d < best - 1e-15:
                    best = d
                    chosen[s] = t
                    kind[s] = feature
                    for j in range(3):
                        at[s, j] = b[j]
            t = chosen[s]
            feature = kind[s]
            y0, y1, y2 = _row(x, triangles[t, 0]), _row(x, triangles[t, 1]), _row(x, triangles[t, 2])
            r = p - at[s, 0] * y0 - at[s, 1] * y1 - at[s, 2] * y2
            d = r.norm()
            face = (y1 - y0).cross(y2 - y0).normalized()
            height[s] = face.dot(p - y0)
            sign[s] = side[s]
            kind[s] = 3
            along = side[s] * face
            gap[s] = along.dot(r) - c[OFFSET]
            if feature < 6:
                kind[s] = 2
                if feature < 3:
                    kind[s] = 1
                sign[s] = 1.0
                if border[t, feature] == 0:
                    m = vec3(0.0, 0.0, 0.0)
                    for j in range(3):
                        m += at[s, j] * _row(normals, triangles[t, j])
                    if side[s] * m.dot(r) < 0.0:
                        sign[s] = -1.0
                if d > 1e-12:
                    along = sign[s] * r / d
                gap[s] = sign[s] * d - c[OFFSET]
            for j in ti.static(range(3)):
                direction[s, j] = along[j]


@ti.func
def _elastic_slip(
    x: ti.template(), x_start: ti.template(), own: ti.template(), weights: ti.template(),
    triangles: ti.template(), lag: ti.template(), lag_b: ti.template(), lag_n: ti.template(),
    anchor: ti.template(), s: ti.i32,
):  # fmt: skip
    """Elastic slip [m] and projector, against the triangle under the sample at the start."""
    move = _sample(x, own, weights, s) - _sample(x_start, own, weights, s)
    for j in range(3):
        i = triangles[lag[s], j]
        move -= lag_b[s, j] * (_row(x, i) - _row(x_start, i))
    t = tangent_projector(_row(lag_n, s))
    return t @ (_row(anchor, s) + move), t


@ti.kernel
def add_energy(
    x: F2, x_start: F2, own: I2, weights: F2, triangles: I2, areas: F1, c: F1, limit: F1, lag: I1, lag_b: F2,
    lag_n: F2, anchor: F2, gap: F1, out: F1,
):  # fmt: skip
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        e = areas[s] * potential(gap[s], c[STIFFNESS], c[WIDTH])
        if limit[s] > 0.0:
            u, _t = _elastic_slip(x, x_start, own, weights, triangles, lag, lag_b, lag_n, anchor, s)
            e += friction_potential(u, limit[s], c[STIFFNESS] * areas[s])
        out[0] = out[0] + e


@ti.kernel
def add_gradient(
    x: F2, x_start: F2, own: I2, weights: F2, triangles: I2, areas: F1, c: F1, limit: F1, lag: I1, lag_b: F2,
    lag_n: F2, anchor: F2, gap: F1, chosen: I1, at: F2, direction: F2, force: F2, load: F1, out: F2,
):  # fmt: skip
    """Also write the force on each sample [N] and its normal part [N]."""
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        load[s] = areas[s] * pressure(gap[s], c[STIFFNESS], c[WIDTH])
        rub = vec3(0.0, 0.0, 0.0)
        if limit[s] > 0.0:
            u, _t = _elastic_slip(x, x_start, own, weights, triangles, lag, lag_b, lag_n, anchor, s)
            rub = -friction_force(u, limit[s], c[STIFFNESS] * areas[s])
        for j in range(3):
            force[s, j] = rub[j]
        if load[s] > 0.0:
            for k in range(3):
                i = triangles[chosen[s], k]
                for j in range(3):
                    out[i, j] = out[i, j] + at[s, k] * load[s] * direction[s, j]
            for j in range(3):
                force[s, j] = load[s] * direction[s, j] + rub[j]
        if limit[s] > 0.0:
            for k in range(3):
                i = triangles[lag[s], k]
                for j in range(3):
                    out[i, j] = out[i, j] + lag_b[s, k] * rub[j]
        if load[s] > 0.0 or limit[s] > 0.0:
            for a in range(weights.shape[1]):
                for j in range(3):
                    out[own[s, a], j] = out[own[s, a], j] - weights[s, a] * force[s, j]


@ti.func
def _participant(own: ti.template(), weights: ti.template(), triangles: ti.template(), s: ti.i32, t: ti.i32, a: ti.i32):
    """Node, block of the second derivative, and weight in it of the a-th participant in a contact."""
    count = weights.shape[1]
    node = triangles[t, ti.max(a - count, 0)]
    block = a - count + 1
    weight = 1.0
    if a < count:
        node = own[s, a]
        block = 0
        weight = weights[s, a]
    return node, block, weight


@ti.kernel
def add_hessian(
    x: F2, x_start: F2, own: I2, weights: F2, triangles: I2, areas: F1, c: F1, limit: F1, lag: I1, lag_b: F2,
    lag_n: F2, anchor: F2, gap: F1, chosen: I1, at: F2, direction: F2, sign: F1, kind: I1, exact: I1,
    start: I1, column: I1, place: I1, second: F3, out: F1,
):  # fmt: skip
    """``second``: scratch, blocks (4 x 4) of the second derivative of the gap in (p, y0, y1, y2), [1/m]."""
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        count = weights.shape[1] + 3
        for law in range(2):
            # First the pressure on the triangle that is nearest now, then friction on that of the start.
            active = gap[s] < c[WIDTH]
            if law == 1:
                active = limit[s] > 0.0
            if active:
                t = chosen[s]
                b = vec3(0.0, 0.0, 0.0)
                bend = 0.0
                stiff = ti.Matrix.zero(ti.f64, 3, 3)
                if law == 0:
                    b = _row(at, s)
                    n = _row(direction, s)
                    stiff = (areas[s] * slope(gap[s], c[STIFFNESS], c[WIDTH])) * n.outer_product(n)
                    if exact[0] == 1:
                        bend = -areas[s] * pressure(gap[s], c[STIFFNESS], c[WIDTH])
                        y0, y1, y2 = _row(x, triangles[t, 0]), _row(x, triangles[t, 1]), _row(x, triangles[t, 2])
                        p = _sample(x, own, weights, s)
                        distance_second_derivative(p, y0, y1, y2, b, kind[s], sign[s], second)
                else:
                    t = lag[s]
                    b = _row(lag_b, s)
                    u, projector = _elastic_slip(x, x_start, own, weights, triangles, lag, lag_b, lag_n, anchor, s)
                    stiff = friction_stiffness(u, limit[s], c[STIFFNESS] * areas[s], projector)
                for a in range(count):
                    i, qa, wa = _participant(own, weights, triangles, s, t, a)
                    ca = wa
                    if qa > 0:
                        ca = -b[qa - 1]
                    for d in range(a, count):
                        j, qd, wd = _participant(own, weights, triangles, s, t, d)
                        cd = wd
                        if qd > 0:
                            cd = -b[qd - 1]
                        m = (ca * cd) * stiff
                        if bend != 0.0:
                            for r in range(3):
                                for q in range(3):
                                    m[r, q] += bend * wa * wd * second[4 * qa + qd, r, q]
                        add_block(start, column, place, out, i, j, m)
