"""What contact in a frame does along small changes, pair by pair: the kernels of :mod:`framed_derivatives`.

Four points z, their matrices B_a(z) and the normal m(z), the slip w = anchor + sum_a B_a (z'_a - z_a), friction F(w, m,
limit, spring). Everything is differentiated along one direction at a time, in closed form; the slip is in terms of

    u = w - m (m . w),    F = u f(|u|),    new elastic slip u min(1, u_c / |u|),    slip speed max(0, |u| - u_c) / dt
"""

import numpy as np
import taichi as ti

from sim_core.kernels import F1, F2, F3, I1, I2, BoundKernel, mat3, vec3

ALONG = 7
"""Directions beyond positions: the anchor (3), load and slip speed before, the friction bound itself, and the
spring."""


@ti.func
def _one():
    return mat3(1, 0, 0, 0, 1, 0, 0, 0, 1)


@ti.func
def _skew(v):
    return mat3(0.0, -v[2], v[1], v[2], 0.0, -v[0], -v[1], v[0], 0.0)


@ti.func
def _point(z: ti.template(), n: ti.i32, a: ti.i32):
    return vec3(z[n, 3 * a], z[n, 3 * a + 1], z[n, 3 * a + 2])


@ti.func
def _moved(a: ti.i32, q: ti.i32):
    """Change of point ``a`` along direction ``q`` of the twelve."""
    out = vec3(0.0, 0.0, 0.0)
    for i in ti.static(range(3)):
        if q == 3 * a + i:
            out[i] = 1.0
    return out


@ti.func
def _put(b: ti.template(), n: ti.i32, q: ti.i32, a: ti.i32, value):
    for i in ti.static(range(3)):
        for j in ti.static(range(3)):
            b[n, q, 9 * a + 3 * i + j] = value[i, j]


@ti.kernel
def triangle_frames(count: I1, z: F2, kind: I1, ends: I2, direction: F2, b: F3, m: F3):
    """B and m of samples over triangles at index 12 of the second axis, and their derivatives by the twelve components
    of z before. ``kind``: 3 face, 2 edge, 1 corner; ``ends``: points of z that the edge goes between, or the corner."""
    ti.loop_config(serialize=True)
    for n in range(count[0]):
        p, y0 = _point(z, n, 0), _point(z, n, 1)
        e1, e2, r = _point(z, n, 2) - y0, _point(z, n, 3) - y0, p - y0
        big = e1.cross(e2)
        square = big.norm_sqr()
        size = ti.sqrt(square)
        g1, g2, normal = e2.cross(big) / square, big.cross(e1) / square, big / size
        h = normal.dot(r)
        start, far = ends[n, 0], ends[n, 1]
        along = _point(z, n, far) - _point(z, n, start)
        length = along.norm_sqr()
        out = p - _point(z, n, start)
        share = 0.0
        if kind[n] == 2:
            share = out.dot(along) / length
        away = out - share * along
        apart = away.norm()
        sign = 1.0
        if (kind[n] == 3 and normal.dot(_point(direction, n, 0)) < 0.0) or (
            kind[n] != 3 and away.dot(_point(direction, n, 0)) < 0.0
        ):
            sign = -1.0
        for q in range(13):
            dp, dy0 = _moved(0, q), _moved(1, q)
            de1, de2, dr = _moved(2, q) - dy0, _moved(3, q) - dy0, dp - dy0
            dbig = de1.cross(e2) + e1.cross(de2)
            grown = 2.0 * big.dot(dbig) / square
            dg1 = (de2.cross(big) + e2.cross(dbig)) / square - grown * g1
            dg2 = (dbig.cross(e1) + big.cross(de1)) / square - grown * g2
            dnormal = dbig / size - 0.5 * grown * normal
            dh = dnormal.dot(r) + normal.dot(dr)
            change = dnormal
            if q == 12:
                change = normal
            if kind[n] != 3:
                dstart = _moved(start, q)
                dalong, dout = _moved(far, q) - dstart, dp - dstart
                daway = dout
                if kind[n] == 2:
                    dshare = (dout.dot(along) + out.dot(dalong) - 2.0 * share * along.dot(dalong)) / length
                    daway = dout - dshare * along - share * dalong
                change = (daway - away * (away.dot(daway) / (apart * apart))) / apart
                if q == 12:
                    change = away / apart
            for i in ti.static(range(3)):
                m[n, q, i] = sign * change[i]
            for j in ti.static(range(3)):
                g, dg = -g1 - g2, -dg1 - dg2
                if ti.static(j == 1):
                    g, dg = g1, dg1
                elif ti.static(j == 2):
                    g, dg = g2, dg2
                value = (dg.dot(r) + g.dot(dr)) * _one() - (dh * g + h * dg).outer_product(normal)
                value -= h * g.outer_product(dnormal)
                if q == 12:
                    value = g.dot(r) * _one() - h * g.outer_product(normal)
                    if ti.static(j == 0):
                        value += _one()
                _put(b, n, q, j + 1, -value)
            first = ti.Matrix.zero(ti.f64, 3, 3)
            if q == 12:
                first = _one()
            _put(b, n, q, 0, first)


@ti.kernel
def edge_frames(count: I1, z: F2, at: F2, direction: F2, b: F3, m: F3):
    """As :func:`triangle_frames`, of pairs of edges with the closest points ``at``."""
    ti.loop_config(serialize=True)
    for n in range(count[0]):
        s, t = at[n, 0], at[n, 1]
        free_s, free_t = s > 0.0 and s < 1.0, t > 0.0 and t < 1.0
        u, v = _point(z, n, 1) - _point(z, n, 0), _point(z, n, 3) - _point(z, n, 2)
        gap = _point(z, n, 0) - _point(z, n, 2)
        uu, vv, uv, ug, vg = u.dot(u), v.dot(v), u.dot(v), u.dot(gap), v.dot(gap)
        den = uu * vv - uv * uv
        if free_s and free_t:
            s, t = (uv * vg - vv * ug) / den, (uu * vg - uv * ug) / den
        elif free_s:
            s = (uv * t - ug) / uu
        elif free_t:
            t = (uv * s + vg) / vv
        apart = gap + s * u - t * v
        normal = u.cross(v)
        square = normal.norm_sqr()
        crossing = free_s and free_t and square > 0.0
        h = 0.0
        if crossing:
            h = normal.dot(apart) / square
        length = apart.norm()
        sign = 1.0
        if apart.dot(_point(direction, n, 0)) < 0.0:
            sign = -1.0
        for q in range(13):
            du, dv, dgap = _moved(1, q) - _moved(0, q), _moved(3, q) - _moved(2, q), _moved(0, q) - _moved(2, q)
            duu, dvv, duv = 2.0 * u.dot(du), 2.0 * v.dot(dv), du.dot(v) + u.dot(dv)
            dug, dvg = du.dot(gap) + u.dot(dgap), dv.dot(gap) + v.dot(dgap)
            ds, dt = 0.0, 0.0
            if free_s and free_t:
                dden = duu * vv + uu * dvv - 2.0 * uv * duv
                ds = (duv * vg + uv * dvg - dvv * ug - vv * dug - s * dden) / den
                dt = (duu * vg + uu * dvg - duv * ug - uv * dug - t * dden) / den
            elif free_s:
                ds = (duv * t - dug - s * duu) / uu
            elif free_t:
                dt = (duv * s + dvg - t * dvv) / vv
            dapart = dgap + ds * u + s * du - dt * v - t * dv
            dh = 0.0
            if crossing:
                dnormal = du.cross(v) + u.cross(dv)
                dh = (dnormal.dot(apart) + normal.dot(dapart) - 2.0 * h * normal.dot(dnormal)) / square
            change = (dapart - apart * (apart.dot(dapart) / (length * length))) / length
            if q == 12:
                change = apart / length
            for i in ti.static(range(3)):
                m[n, q, i] = sign * change[i]
            for a in ti.static(range(4)):
                share, dshare, arm, darm = 1.0 - s, -ds, -v, -dv
                if ti.static(a == 1):
                    share, dshare, arm, darm = s, ds, v, dv
                elif ti.static(a == 2):
                    share, dshare, arm, darm = t - 1.0, dt, u, du
                elif ti.static(a == 3):
                    share, dshare, arm, darm = -t, -dt, -u, -du
                value = dshare * _one() + dh * _skew(arm) + h * _skew(darm)
                if q == 12:
                    value = share * _one() + h * _skew(arm)
                _put(b, n, q, a, value)


@ti.func
def _matrix(b: ti.template(), n: ti.i32, q: ti.i32, a: ti.i32):
    out = ti.Matrix.zero(ti.f64, 3, 3)
    for i in ti.static(range(3)):
        for j in ti.static(range(3)):
            out[i, j] = b[n, q, 9 * a + 3 * i + j]
    return out


@ti.kernel
def rub(
    count: I1, z: F2, b: F3, m: F3, motion: F2, anchor: F2, law: F3, dspring: F2, dt: F1,
    force: F2, force_start: F3, force_along: F3, slip_start: F3, slip_end: F3, slip_along: F3,
):  # fmt: skip
    """Friction of pairs and its derivatives. ``motion``: of the four points; ``law[n, k]``: limit and spring (k = 0),
    and their changes along the directions 3 to 6 of :data:`ALONG` (k = 1 to 4); ``dspring``: change of the spring by
    the twelve components of z. Writes the ``force`` on the points ``(n, 12)`` and its derivatives by the start
    ``(12, 12)`` and along the others ``(12, 7)``; of the new elastic slip and the slip speed, four rows, those by
    start, end and the others."""
    ti.loop_config(serialize=True)
    for n in range(count[0]):
        w = _point(anchor, n, 0)
        for a in range(4):
            w += _matrix(b, n, 12, a) @ _point(motion, n, a)
        normal = vec3(m[n, 12, 0], m[n, 12, 1], m[n, 12, 2])
        limit, spring = law[n, 0, 0], law[n, 0, 1]
        u = w - normal * normal.dot(w)
        length, longest = u.norm(), 1e300
        if spring > 0.0:
            longest = 2.0 * limit / spring
        beyond = length > longest
        pull = spring
        if beyond:
            pull = limit / length
        elif length > 0.0:
            pull = spring * (1.0 - 0.5 * length / longest)
        push = pull * u
        for a in range(4):
            back = _matrix(b, n, 12, a).transpose() @ push
            for i in ti.static(range(3)):
                force[n, 3 * a + i] = back[i]
        # Directions: the start (12), the end (12), then those of ALONG.
        for q in range(24 + ti.static(ALONG)):
            dw, dm = vec3(0.0, 0.0, 0.0), vec3(0.0, 0.0, 0.0)
            dlimit, dstiff = 0.0, 0.0
            if q < 24:
                column, a = q % 12, (q % 12) // 3
                own = _matrix(b, n, 12, a) @ _moved(a, column)
                dw = own
                if q < 12:
                    dw = -own
                    for c in range(4):
                        dw += _matrix(b, n, q, c) @ _point(motion, n, c)
                    dm = vec3(m[n, q, 0], m[n, q, 1], m[n, q, 2])
                    dstiff = dspring[n, q]
            elif q < 27:
                dw = _moved(0, q - 24)
            else:
                dlimit, dstiff = law[n, q - 26, 0], law[n, q - 26, 1]
            du = dw - dm * normal.dot(w) - normal * (dm.dot(w) + normal.dot(dw))
            dlength = 0.0
            if length > 0.0:
                dlength = u.dot(du) / length
            dlongest = 0.0
            if spring > 0.0:
                dlongest = 2.0 * (dlimit - limit * dstiff / spring) / spring
            dpull, dspeed = dstiff, 0.0
            dslip = du
            if beyond:
                dpull = (dlimit - pull * dlength) / length
                dslip = (longest / length) * (du - (dlength / length) * u) + (dlongest / length) * u
                dspeed = (dlength - dlongest) / dt[0]
            elif length > 0.0:
                dpull = dstiff * (1.0 - 0.5 * length / longest)
                dpull -= 0.5 * spring * (dlength - length * dlongest / longest) / longest
            dpush = pull * du + dpull * u
            for i in ti.static(range(3)):
                if q < 12:
                    slip_start[n, i, q] = dslip[i]
                elif q < 24:
                    slip_end[n, i, q - 12] = dslip[i]
                else:
                    slip_along[n, i, q - 24] = dslip[i]
            if q < 12:
                slip_start[n, 3, q] = dspeed
            elif q < 24:
                slip_end[n, 3, q - 12] = dspeed
            else:
                slip_along[n, 3, q - 24] = dspeed
            if q < 12 or q >= 24:
                for a in range(4):
                    back = _matrix(b, n, 12, a).transpose() @ dpush
                    if q < 12:
                        back += _matrix(b, n, q, a).transpose() @ push
                    for i in ti.static(range(3)):
                        if q < 12:
                            force_start[n, 3 * a + i, q] = back[i]
                        else:
                            force_along[n, 3 * a + i, q - 24] = back[i]


class Frames:
    """Kernels with the arrays that they write, for as many pairs as there have been."""

    def __init__(self) -> None:
        self._capacity = 0

    def _reserve(self, count: int) -> None:
        if count <= self._capacity:
            return
        self._capacity = n = 2 * count
        self._count, self._dt = np.zeros(1, dtype=np.int32), np.zeros(1)
        self._z, self._direction, self._motion, self._anchor = (np.zeros((n, k)) for k in (12, 3, 12, 3))
        self._kind, self._ends, self._at = (
            np.zeros(n, dtype=np.int32),
            np.zeros((n, 2), dtype=np.int32),
            np.zeros((n, 2)),
        )
        self._law, self._dspring = np.zeros((n, 5, 2)), np.zeros((n, 12))
        frames = np.zeros((n, 13, 36)), np.zeros((n, 13, 3))
        self._found = (
            *(np.zeros((n, 12)), np.zeros((n, 12, 12)), np.zeros((n, 12, ALONG))),
            *(np.zeros((n, 4, 12)), np.zeros((n, 4, 12)), np.zeros((n, 4, ALONG))),
        )
        at = (self._count, self._z)
        self._triangles = BoundKernel(triangle_frames, *at, self._kind, self._ends, self._direction, *frames)
        self._edges = BoundKernel(edge_frames, *at, self._at, self._direction, *frames)
        law = (self._motion, self._anchor, self._law, self._dspring, self._dt)
        self._rub = BoundKernel(rub, *at, *frames, *law, *self._found)

    def of_triangles(self, z: np.ndarray, kind: np.ndarray, at: np.ndarray, direction: np.ndarray) -> None:
        """Frames of samples over triangles. ``z``: sample and corners [m] ``(n, 4, 3)``; ``kind``: 3 face, 2 edge, 1
        corner of the closest point with weights ``at`` ``(n, 3)``; ``direction``: the lagged normal ``(n, 3)``."""
        count = self._place(z, direction)
        self._kind[:count] = kind
        # On an edge, maybe at an end of it: its two corners, as for the Hessian; at a corner: that one first.
        lacks = at == 0.0
        corner = np.where(lacks[:, 0], np.where(lacks[:, 1], 3, 2), 1)
        self._ends[:count, 0] = np.where(kind == 2, np.where(lacks[:, 0], 2, 1), corner)
        self._ends[:count, 1] = np.where(lacks[:, 0] | lacks[:, 1], 3, 2)
        self._dspring[:count] = 0.0
        self._triangles()

    def of_edges(self, z: np.ndarray, at: np.ndarray, direction: np.ndarray, dspring: np.ndarray) -> None:
        """Frames of pairs of edges. ``z``: their ends [m] ``(n, 4, 3)``; ``at``: closest points (s, t) ``(n, 2)``;
        ``dspring``: derivative of the spring by z [N/m^2] ``(n, 4, 3)``."""
        count = self._place(z, direction)
        self._at[:count] = at
        self._dspring[:count] = dspring.reshape(count, 12)
        self._edges()

    def _place(self, z: np.ndarray, direction: np.ndarray) -> int:
        count = len(z)
        self._reserve(count)
        self._count[0] = count
        self._z[:count], self._direction[:count] = z.reshape(count, 12), direction
        return count

    def rub(self, motion: np.ndarray, anchor: np.ndarray, law: np.ndarray, dt: float) -> list[np.ndarray]:
        """What :func:`rub` writes, for the frames made last. ``law``: ``(n, 5, 2)``."""
        count = len(motion)
        self._motion[:count], self._anchor[:count] = motion.reshape(count, 12), anchor
        self._law[:count], self._dt[0] = law, dt
        self._rub()
        return [a[:count] for a in self._found]
