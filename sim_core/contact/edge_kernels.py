"""Kernels of :mod:`sim_core.contact.edges`: the gap of every pair of edges, then energy and derivatives from it.

Pair ``k`` has the ends ``ends[k]`` = (p0, p1, q0, q1), the closest points at ``at[k]`` = (s, t) and the area
``areas[k]``; ``parallel[k]``: value of |u x v|^2 below which its energy fades; ``spring[k]``: stiffness of its elastic
slip [N/m]. ``count[0]``: number of pairs.
"""

from sim_core.contact.continuous_collision import segments_way
from sim_core.contact.pressure_and_friction import (
    GUARD,
    OFFSET,
    RANGE,
    friction_force,
    friction_potential,
    friction_stiffness,
    potential,
    pressure,
    slope,
    tangent_projector,
)
from sim_core.contact.segments import (
    closest_on_segments,
    mollifier,
    parallel_derivatives,
    segment_second_derivative,
)
from sim_core.core import language as lang
from sim_core.core.language import F1, F2, F3, I1, I2, mat3
from sim_core.kernels import add_block, row


@lang.func
def _end(x: lang.template(), ends: lang.template(), k: lang.i32, a: lang.template()):
    return row(x, ends[k, a])


@lang.func
def _apart(x: lang.template(), ends: lang.template(), k: lang.i32, s: lang.f64, t: lang.f64):
    """Vector between the points at s and t."""
    return (
        (1.0 - s) * _end(x, ends, k, 0)
        + s * _end(x, ends, k, 1)
        - (1.0 - t) * _end(x, ends, k, 2)
        - t * _end(x, ends, k, 3)
    )


@lang.func
def _across(x: lang.template(), ends: lang.template(), k: lang.i32):
    """u x v."""
    u = _end(x, ends, k, 1) - _end(x, ends, k, 0)
    return u.cross(_end(x, ends, k, 3) - _end(x, ends, k, 2))


@lang.kernel
def sides(x: F2, count: I1, ends: I2, side: F1):
    """On which side of the plane along both edges the first one is: the sign of (u x v) . (p - q)."""
    lang.loop_config(serialize=True)
    for k in range(count[0]):
        side[k] = 1.0
        if _across(x, ends, k).dot(_end(x, ends, k, 0) - _end(x, ends, k, 2)) < 0.0:
            side[k] = -1.0


@lang.kernel
def measure(
    x: F2, count: I1, ends: I2, parallel: F1, side: F1, c: F1, at: F2, direction: F2, sign: F1, fade: F2, gap: F1
):  # fmt: skip
    """``direction``: gradient of the gap at the first point; ``fade``: mollifier and its slope."""
    lang.loop_config(serialize=True)
    for k in range(count[0]):
        p0, p1, q0, q1 = _end(x, ends, k, 0), _end(x, ends, k, 1), _end(x, ends, k, 2), _end(x, ends, k, 3)
        s, t = closest_on_segments(p0, p1, q0, q1)
        r = _apart(x, ends, k, s, t)
        d = r.norm()
        sign[k] = 1.0
        if c[GUARD] == 0.0 and s > 0.0 and s < 1.0 and t > 0.0 and t < 1.0:
            if side[k] * _across(x, ends, k).dot(r) < 0.0:
                sign[k] = -1.0
        n = sign[k] * r / lang.max(d, 1e-12)
        at[k, 0] = s
        at[k, 1] = t
        for j in lang.static(range(3)):
            direction[k, j] = n[j]
        fade[k, 0], fade[k, 1] = mollifier(p0, p1, q0, q1, parallel[k])
        gap[k] = sign[k] * d - c[OFFSET]


@lang.kernel
def free_way(x: F2, move: F2, count: I1, ends: I2, c: F1, keep: F1, way: F1):
    """Shorten ``way`` to the share of ``move`` from ``x`` on that no edge ends at another."""
    lang.loop_config(serialize=True)
    for k in range(count[0]):
        free = segments_way(
            _end(x, ends, k, 0), _end(x, ends, k, 1), _end(x, ends, k, 2), _end(x, ends, k, 3),
            _end(move, ends, k, 0), _end(move, ends, k, 1), _end(move, ends, k, 2), _end(move, ends, k, 3),
            c[OFFSET], keep[0],
        )  # fmt: skip
        way[0] = lang.min(way[0], free)


@lang.func
def _weight(at: lang.template(), k: lang.i32, a: lang.i32):
    """Weight of the a-th end in the vector between the points."""
    out = 1.0 - at[k, 0]
    if a == 1:
        out = at[k, 0]
    elif a == 2:
        out = at[k, 1] - 1.0
    elif a == 3:
        out = -at[k, 1]
    return out


@lang.kernel
def frames(x: F2, count: I1, ends: I2, at: F2, out: F2):
    """How the slip moves with the ends: du = sum_a A_a dz_a, ``out[k, 9 a:]``.

    The slip is that of p - q beyond h n, the distance along the normal n = u x v / |u x v|, which turns with
    the edges: A_a = w_a 1 - h dn/dz_a. Where an edge ends it has no such frame, and h is taken as zero.
    """
    lang.loop_config(serialize=True)
    for k in range(count[0]):
        s, t = at[k, 0], at[k, 1]
        u = _end(x, ends, k, 1) - _end(x, ends, k, 0)
        v = _end(x, ends, k, 3) - _end(x, ends, k, 2)
        n = u.cross(v)
        length = n.norm()
        h = 0.0
        if s > 0.0 and s < 1.0 and t > 0.0 and t < 1.0 and length > 0.0:
            h = n.dot(_apart(x, ends, k, s, t)) / (length * length)
        for a in lang.static(range(4)):
            # dn = (du x v + u x dv) / |u x v|, within the tangent plane to which the slip is projected.
            arm = v
            if lang.static(a > 1):
                arm = -u
            if lang.static(a == 0 or a == 2):
                arm = -arm
            for i in lang.static(range(3)):
                out[k, 9 * a + 4 * i] = _weight(at, k, a)
            out[k, 9 * a + 1] = -h * arm[2]
            out[k, 9 * a + 2] = h * arm[1]
            out[k, 9 * a + 3] = h * arm[2]
            out[k, 9 * a + 5] = -h * arm[0]
            out[k, 9 * a + 6] = -h * arm[1]
            out[k, 9 * a + 7] = h * arm[0]


@lang.func
def _frame(lag_a: lang.template(), k: lang.i32, a: lang.i32):
    b = 9 * a
    return mat3(
        lag_a[k, b], lag_a[k, b + 1], lag_a[k, b + 2],
        lag_a[k, b + 3], lag_a[k, b + 4], lag_a[k, b + 5],
        lag_a[k, b + 6], lag_a[k, b + 7], lag_a[k, b + 8],
    )  # fmt: skip


@lang.func
def _elastic_slip(
    x: lang.template(), x_start: lang.template(), ends: lang.template(), lag_a: lang.template(), lag_n: lang.template(),
    anchor: lang.template(), k: lang.i32,
):  # fmt: skip
    """Elastic slip [m] and projector, of the points that were closest at the start."""
    projector = tangent_projector(row(lag_n, k))
    move = row(anchor, k)
    for a in lang.static(range(4)):
        move += _frame(lag_a, k, a) @ (_end(x, ends, k, a) - _end(x_start, ends, k, a))
    return projector @ move, projector


@lang.kernel
def add_energy(
    x: F2, x_start: F2, count: I1, ends: I2, areas: F1, c: F1, limit: F1, spring: F1, lag_a: F2, lag_n: F2, anchor: F2,
    fade: F2, gap: F1, out: F1,
):  # fmt: skip
    lang.loop_config(serialize=True)
    for k in range(count[0]):
        e = fade[k, 0] * areas[k] * potential(gap[k], c)
        if limit[k] > 0.0:
            u, _t = _elastic_slip(x, x_start, ends, lag_a, lag_n, anchor, k)
            e += friction_potential(u, limit[k], spring[k])
        out[0] = out[0] + e


@lang.kernel
def add_gradient(
    x: F2, x_start: F2, count: I1, ends: I2, areas: F1, c: F1, limit: F1, spring: F1, lag_a: F2, lag_n: F2, anchor: F2,
    fade: F2, gap: F1, at: F2, direction: F2, load: F1, first: F2, second: F3, out: F2,
):  # fmt: skip
    """Also write the normal force of each pair [N]."""
    lang.loop_config(serialize=True)
    for k in range(count[0]):
        load[k] = 0.0
        if gap[k] < c[RANGE]:
            load[k] = fade[k, 0] * areas[k] * pressure(gap[k], c)
            for a in range(4):
                for j in range(3):
                    i = ends[k, a]
                    out[i, j] = out[i, j] - load[k] * _weight(at, k, a) * direction[k, j]
            if fade[k, 1] > 0.0:
                parallel_derivatives(
                    _end(x, ends, k, 0), _end(x, ends, k, 1), _end(x, ends, k, 2), _end(x, ends, k, 3), first, second
                )
                turning = fade[k, 1] * areas[k] * potential(gap[k], c)
                for a in range(4):
                    for j in range(3):
                        i = ends[k, a]
                        out[i, j] = out[i, j] + turning * first[a, j]
        if limit[k] > 0.0:
            u, _t = _elastic_slip(x, x_start, ends, lag_a, lag_n, anchor, k)
            rub = friction_force(u, limit[k], spring[k])
            for a in range(4):
                push = _frame(lag_a, k, a).transpose() @ rub
                for j in range(3):
                    i = ends[k, a]
                    out[i, j] = out[i, j] + push[j]


@lang.kernel
def add_hessian(
    x: F2, x_start: F2, count: I1, ends: I2, areas: F1, c: F1, limit: F1, spring: F1, lag_a: F2, lag_n: F2, anchor: F2,
    fade: F2, gap: F1, at: F2, direction: F2, sign: F1, parallel: F1, exact: I1, start: I1, column: I1, place: I1,
    first: F2, second: F3, curved: F3, out: F1,
):  # fmt: skip
    lang.loop_config(serialize=True)
    for k in range(count[0]):
        touching = gap[k] < c[RANGE]
        if touching or limit[k] > 0.0:
            p0, p1, q0, q1 = _end(x, ends, k, 0), _end(x, ends, k, 1), _end(x, ends, k, 2), _end(x, ends, k, 3)
            stiff = 0.0
            load = 0.0
            turning = 0.0
            bending = 0.0
            mixed = 0.0
            rub = lang.Matrix.zero(lang.f64, 3, 3)
            bent = False
            if touching:
                stiff = fade[k, 0] * areas[k] * slope(gap[k], c)
                if exact[0] == 1:
                    load = fade[k, 0] * areas[k] * pressure(gap[k], c)
                    segment_second_derivative(p0, p1, q0, q1, at[k, 0], at[k, 1], second)
                    if fade[k, 1] > 0.0:
                        bent = True
                        parallel_derivatives(p0, p1, q0, q1, first, curved)
                        turning = fade[k, 1] * areas[k] * potential(gap[k], c)
                        bending = -2.0 / (parallel[k] * parallel[k]) * areas[k] * potential(gap[k], c)
                        mixed = -fade[k, 1] * areas[k] * pressure(gap[k], c)
            if limit[k] > 0.0:
                u, projector = _elastic_slip(x, x_start, ends, lag_a, lag_n, anchor, k)
                rub = friction_stiffness(u, limit[k], spring[k], projector)
            for a in range(4):
                wa = _weight(at, k, a)
                left = _frame(lag_a, k, a).transpose() @ rub
                for b in range(a, 4):
                    wb = _weight(at, k, b)
                    h = left @ _frame(lag_a, k, b)
                    if touching:
                        for i in range(3):
                            for j in range(3):
                                h[i, j] += stiff * wa * wb * direction[k, i] * direction[k, j]
                                if exact[0] == 1:
                                    h[i, j] -= load * sign[k] * second[4 * a + b, i, j]
                                    if bent:
                                        h[i, j] += turning * curved[4 * a + b, i, j]
                                        h[i, j] += bending * first[a, i] * first[b, j]
                                        h[i, j] += mixed * wb * first[a, i] * direction[k, j]
                                        h[i, j] += mixed * wa * direction[k, i] * first[b, j]
                    add_block(start, column, place, out, ends[k, a], ends[k, b], h)
