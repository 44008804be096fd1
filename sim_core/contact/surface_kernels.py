"""Kernels of :mod:`sim_core.contact.surface`: the gap of every sample, then energy and derivatives from it.

A sample ``s`` has the nodes ``own[s, :used[s]]`` with ``weights[s]`` and the candidate triangles
``near[first[s]:first[s + 1]]``; ``side``: of each candidate on which the sample was at the start of the step.
"""

from sim_core.contact.closest import distance_second_derivative
from sim_core.contact.pressure_and_friction import (
    BLEND,
    GUARD,
    OFFSET,
    REACH,
    STIFFNESS,
    friction_force,
    friction_potential,
    friction_stiffness,
    potential,
    pressure,
    slope,
    tangent_projector,
)
from sim_core.contact.surface_geometry import closest_on, sample_at
from sim_core.core import language as lang
from sim_core.core.language import F1, F2, F3, I1, I2, mat3, vec3
from sim_core.kernels import add_block, row

MOST = 12
"""Triangles that may share in the gap of one sample."""
FAR = 1e30
"""Gap [m] of a sample without candidates."""

ASIDE = (4.1e-15, 7.3e-15, 5.5e-15)
"""Shift of all samples [m]: exactly above an edge of two triangles their distances would have second derivatives that
are those of neither side, and what is symmetric stands there."""


@lang.kernel
def measure(
    x: F2, own: I2, used: I1, weights: F2, triangles: I2, border: I2, first: I1, near: I1, normals: F2, side: F1,
    c: F1, number: I1, chosen: I2, at: F2, direction: F2, share: F2, kind: I2, distance: F2, sign: F1, gap: F1,
):  # fmt: skip
    """Triangles that every sample is nearest to (the nearest first), how they share in the gap, and the gap.

    ``number``: of them; ``at``, ``direction``: three columns for each, barycentric weights and gradient of
    its own gap; ``kind``: 3 face, 2 edge, 1 corner; ``sign``: of the distance.
    """
    lang.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        number[s] = 0
        gap[s] = FAR
        sign[s] = 1.0
        if first[s] < first[s + 1]:
            p = sample_at(x, own, used, weights, s) + vec3(ASIDE[0], ASIDE[1], ASIDE[2])
            best = FAR
            nearest = first[s]
            for k in range(first[s], first[s + 1]):
                _b, _feature, r = closest_on(x, p, triangles, near[k])
                if r.norm() < best - 1e-15:
                    best = r.norm()
                    nearest = k
            for q in range(first[s] - 1, first[s + 1]):
                k = nearest
                if q >= first[s]:
                    k = q
                t = near[k]
                m = number[s]
                if m == 0 or (m < MOST and k != nearest):
                    b, feature, r = closest_on(x, p, triangles, t)
                    d = r.norm()
                    if d < best + c[BLEND]:
                        y0 = row(x, triangles[t, 0])
                        face = (row(x, triangles[t, 1]) - y0).cross(row(x, triangles[t, 2]) - y0).normalized()
                        up = 1.0
                        if face.dot(r) < 0.0:
                            up = -1.0
                        outside = side[k] * up
                        along = up * face
                        part = 3
                        if feature < 6:
                            part = 2
                            if feature < 3:
                                part = 1
                            outside = 1.0
                            if border[t, feature] == 0:
                                n = vec3(0.0, 0.0, 0.0)
                                for j in range(3):
                                    n += b[j] * row(normals, triangles[t, j])
                                if side[k] * n.dot(r) < 0.0:
                                    outside = -1.0
                            if d > 1e-12:
                                along = r / d
                        if c[GUARD] > 0.0:
                            outside = 1.0
                        along = outside * along
                        if m == 0:
                            sign[s] = outside
                        if outside == sign[s]:
                            chosen[s, m] = t
                            kind[s, m] = part
                            distance[s, m] = d
                            for j in range(3):
                                at[s, 3 * m + j] = b[j]
                                direction[s, 3 * m + j] = along[j]
                            number[s] = m + 1
            # Smallest distance, smoothed over the width c[BLEND]: shares in proportion to level - distance.
            members = number[s]
            level = FAR
            for _ in range(MOST):
                total = c[BLEND]
                members = 0
                for m in range(number[s]):
                    if distance[s, m] < level:
                        total += distance[s, m]
                        members += 1
                level = total / members
            # Counted from the nearest: the shares sum to one only but for round-off over the width.
            smooth = distance[s, 0] - 0.5 * c[BLEND]
            for m in range(number[s]):
                w = lang.max(0.0, (level - distance[s, m]) / c[BLEND])
                share[s, m] = w
                smooth += w * (distance[s, m] - distance[s, 0]) + 0.5 * c[BLEND] * w * w
            gap[s] = sign[s] * smooth - c[OFFSET]


@lang.func
def _frame(lag_a: lang.template(), s: lang.i32, j: lang.i32):
    b = 9 * j
    return mat3(
        lag_a[s, b], lag_a[s, b + 1], lag_a[s, b + 2],
        lag_a[s, b + 3], lag_a[s, b + 4], lag_a[s, b + 5],
        lag_a[s, b + 6], lag_a[s, b + 7], lag_a[s, b + 8],
    )  # fmt: skip


@lang.func
def _elastic_slip(
    x: lang.template(), x_start: lang.template(), own: lang.template(), used: lang.template(), weights: lang.template(),
    triangles: lang.template(), lag: lang.template(), lag_a: lang.template(), lag_n: lang.template(),
    anchor: lang.template(), s: lang.i32,
):  # fmt: skip
    """Elastic slip [m] and projector, against the frame of the triangle under the sample at the start."""
    move = sample_at(x, own, used, weights, s) - sample_at(x_start, own, used, weights, s)
    for j in range(3):
        i = triangles[lag[s, 0], j]
        move -= _frame(lag_a, s, j) @ (row(x, i) - row(x_start, i))
    t = tangent_projector(row(lag_n, s))
    return t @ (row(anchor, s) + move), t


@lang.kernel
def add_energy(
    x: F2, x_start: F2, own: I2, used: I1, weights: F2, triangles: I2, areas: F1, c: F1, limit: F1, lag: I2, lag_a: F2,
    lag_n: F2, anchor: F2, gap: F1, added: F2, out: F1,
):  # fmt: skip
    lang.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        e = areas[s] * (potential(gap[s], c) + added[s, 0])
        if limit[s] > 0.0:
            u, _t = _elastic_slip(x, x_start, own, used, weights, triangles, lag, lag_a, lag_n, anchor, s)
            e += friction_potential(u, limit[s], c[STIFFNESS] * areas[s])
        out[0] = out[0] + e


@lang.kernel
def add_gradient(
    x: F2, x_start: F2, own: I2, used: I1, weights: F2, triangles: I2, areas: F1, c: F1, limit: F1, lag: I2, lag_a: F2,
    lag_n: F2, anchor: F2, gap: F1, added: F2, number: I1, chosen: I2, at: F2, direction: F2, share: F2,
    force: F2, load: F1, out: F2,
):  # fmt: skip
    """Also write the force on each sample [N] and the part of it that keeps the surfaces apart [N]."""
    lang.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        load[s] = areas[s] * pressure(gap[s], c)
        for j in range(3):
            force[s, j] = 0.0
        whole = load[s] + areas[s] * added[s, 1]
        if whole != 0.0:
            for m in range(number[s]):
                push = share[s, m] * whole
                for j in range(3):
                    force[s, j] = force[s, j] + push * direction[s, 3 * m + j]
                for k in range(3):
                    i = triangles[chosen[s, m], k]
                    for j in range(3):
                        out[i, j] = out[i, j] + at[s, 3 * m + k] * push * direction[s, 3 * m + j]
        if limit[s] > 0.0:
            u, _t = _elastic_slip(x, x_start, own, used, weights, triangles, lag, lag_a, lag_n, anchor, s)
            rub = friction_force(u, limit[s], c[STIFFNESS] * areas[s])
            for j in range(3):
                force[s, j] = force[s, j] - rub[j]
            for k in range(3):
                i = triangles[lag[s, 0], k]
                back = _frame(lag_a, s, k).transpose() @ rub
                for j in range(3):
                    out[i, j] = out[i, j] - back[j]
        if whole != 0.0 or limit[s] > 0.0:
            for a in range(used[s]):
                for j in range(3):
                    out[own[s, a], j] = out[own[s, a], j] - weights[s, a] * force[s, j]


@lang.func
def _participant(
    own: lang.template(),
    weights: lang.template(),
    triangles: lang.template(),
    s: lang.i32,
    t: lang.i32,
    a: lang.i32,
    count: lang.i32,
):
    """Node, block of the second derivative, and weight in it of the a-th of ``count + 3`` participants."""
    node = triangles[t, lang.max(a - count, 0)]
    block = a - count + 1
    weight = 1.0
    if a < count:
        node = own[s, a]
        block = 0
        weight = weights[s, a]
    return node, block, weight


@lang.func
def _node(
    own: lang.template(), triangles: lang.template(), chosen: lang.template(), s: lang.i32, a: lang.i32, count: lang.i32
):
    """Node of the a-th participant: ``count`` own, then the corners of each triangle that shares in the gap."""
    node = own[s, lang.min(a, count - 1)]
    if a >= count:
        node = triangles[chosen[s, (a - count) // 3], (a - count) % 3]
    return node


@lang.kernel
def add_hessian(
    x: F2, x_start: F2, own: I2, used: I1, weights: F2, triangles: I2, areas: F1, c: F1, limit: F1, lag: I2, lag_a: F2,
    lag_n: F2, anchor: F2, gap: F1, added: F2, number: I1, chosen: I2, at: F2, direction: F2, share: F2, kind: I2,
    sign: F1, exact: I1, start: I1, column: I1, place: I1, slopes: F3, second: F3, out: F1,
):  # fmt: skip
    """``slopes``: scratch, gradients of the gap of each triangle with respect to all participants (own nodes,
    then the corners of each triangle), the last row their mean with their shares; ``second``: scratch,
    blocks (4 x 4) of the second derivative of a gap in (p, y0, y1, y2) [1/m]."""
    lang.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        count = used[s]
        if gap[s] < c[REACH]:
            total = count + 3 * number[s]
            load = areas[s] * (pressure(gap[s], c) + added[s, 1])
            stiff = areas[s] * (slope(gap[s], c) + added[s, 2])
            if exact[0] == 0:
                stiff = lang.max(stiff, 0.0)
            members = 0
            for a in range(total):
                for r in range(3):
                    slopes[MOST, a, r] = 0.0
                    slopes[MOST + 1, a, r] = 0.0
            for m in range(number[s]):
                if share[s, m] > 0.0:
                    members += 1
                    for a in range(total):
                        weight = 0.0
                        if a < count:
                            weight = weights[s, a]
                        elif (a - count) // 3 == m:
                            weight = -at[s, a - count]
                        for r in range(3):
                            slopes[m, a, r] = weight * direction[s, 3 * m + r]
                            slopes[MOST, a, r] += share[s, m] * slopes[m, a, r]
                            slopes[MOST + 1, a, r] += slopes[m, a, r]
            # The smoothing stiffens against leaving the crease: curvature of the smallest distance.
            crease = 0.0
            if members > 1 and (sign[s] * load > 0.0 or exact[0] == 1):
                crease = sign[s] * load / c[BLEND]
            for a in range(total):
                i = _node(own, triangles, chosen, s, a, count)
                for d in range(a, total):
                    j = _node(own, triangles, chosen, s, d, count)
                    h = lang.Matrix.zero(lang.f64, 3, 3)
                    for r in range(3):
                        for q in range(3):
                            h[r, q] = stiff * slopes[MOST, a, r] * slopes[MOST, d, q]
                            if crease != 0.0:
                                h[r, q] -= crease * slopes[MOST + 1, a, r] * slopes[MOST + 1, d, q] / members
                                for m in range(number[s]):
                                    if share[s, m] > 0.0:
                                        h[r, q] += crease * slopes[m, a, r] * slopes[m, d, q]
                    if a != d and i == j:
                        h = h + h.transpose()
                    add_block(start, column, place, out, i, j, h)
            if exact[0] == 1 and load != 0.0:
                p = sample_at(x, own, used, weights, s)
                for m in range(number[s]):
                    if share[s, m] > 0.0:
                        t = chosen[s, m]
                        b = vec3(at[s, 3 * m], at[s, 3 * m + 1], at[s, 3 * m + 2])
                        y0, y1, y2 = row(x, triangles[t, 0]), row(x, triangles[t, 1]), row(x, triangles[t, 2])
                        distance_second_derivative(p, y0, y1, y2, b, kind[s, m], sign[s], second)
                        for a in range(count + 3):
                            i, qa, wa = _participant(own, weights, triangles, s, t, a, count)
                            for d in range(a, count + 3):
                                j, qd, wd = _participant(own, weights, triangles, s, t, d, count)
                                h = lang.Matrix.zero(lang.f64, 3, 3)
                                for r in range(3):
                                    for q in range(3):
                                        h[r, q] = -load * share[s, m] * wa * wd * second[4 * qa + qd, r, q]
                                add_block(start, column, place, out, i, j, h)
        if limit[s] > 0.0:
            u, projector = _elastic_slip(x, x_start, own, used, weights, triangles, lag, lag_a, lag_n, anchor, s)
            stiff = friction_stiffness(u, limit[s], c[STIFFNESS] * areas[s], projector)
            t = lag[s, 0]
            for a in range(count + 3):
                i, qa, wa = _participant(own, weights, triangles, s, t, a, count)
                left = wa * stiff
                if qa > 0:
                    left = -_frame(lag_a, s, qa - 1).transpose() @ stiff
                for d in range(a, count + 3):
                    j, qd, wd = _participant(own, weights, triangles, s, t, d, count)
                    h = wd * left
                    if qd > 0:
                        h = -left @ _frame(lag_a, s, qd - 1)
                    add_block(start, column, place, out, i, j, h)
