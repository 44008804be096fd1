"""Closest point on a triangle and the second derivative of the distance to it.

Features: 0..2 the corners, 3..5 the edges 01, 12, 20, 6 the inside of the face. Regions after Ericson,
Real-Time Collision Detection, sec. 5.1.5.
"""

from sim_core.core import language as lang
from sim_core.core.language import vec3


@lang.func
def closest_point(p, a, b, c):
    """Barycentric weights of the closest point and the feature that it lies on."""
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = ab.dot(ap)
    d2 = ac.dot(ap)
    bp = p - b
    d3 = ab.dot(bp)
    d4 = ac.dot(bp)
    cp = p - c
    d5 = ab.dot(cp)
    d6 = ac.dot(cp)
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    out = vec3(1.0, 0.0, 0.0)
    feature = 6
    if d1 <= 0.0 and d2 <= 0.0:
        feature = 0
    elif d3 >= 0.0 and d4 <= d3:
        feature = 1
        out = vec3(0.0, 1.0, 0.0)
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        feature = 3
        v = d1 / (d1 - d3)
        out = vec3(1.0 - v, v, 0.0)
    elif d6 >= 0.0 and d5 <= d6:
        feature = 2
        out = vec3(0.0, 0.0, 1.0)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        feature = 5
        w = d2 / (d2 - d6)
        out = vec3(1.0 - w, 0.0, w)
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        feature = 4
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        out = vec3(0.0, 1.0 - w, w)
    else:
        total = 1.0 / (va + vb + vc)
        out = vec3(va * total, vb * total, vc * total)
    return out, feature


@lang.func
def distance_second_derivative(p, y0, y1, y2, b, kind: lang.i32, sign: lang.f64, out: lang.template()):
    """Write sign * hess |p - sum b_j y_j| minimised over b, as 4 x 4 blocks in (p, y0, y1, y2).

    ``kind``: 3 face, 2 edge, 1 corner. ``out``: ``(16, 3, 3)``.
    """
    r = p - (b[0] * y0 + b[1] * y1 + b[2] * y2)
    d = lang.max(r.norm(), 1e-12)
    n = r / d
    c = lang.Vector([1.0, -b[0], -b[1], -b[2]])
    # Free directions of the closest point: (e_1, e_2) on a face, one edge direction on an edge.
    e1 = y1 - y0
    e2 = y2 - y0
    s1 = lang.Vector([0.0, -1.0, 1.0, 0.0])
    s2 = lang.Vector([0.0, -1.0, 0.0, 1.0])
    if kind == 2:
        if b[0] == 0.0:
            e1 = y2 - y1
            s1 = lang.Vector([0.0, 0.0, -1.0, 1.0])
        elif b[1] == 0.0:
            e1 = y2 - y0
            s1 = lang.Vector([0.0, -1.0, 0.0, 1.0])
    a11 = e1.dot(e1)
    a12 = e1.dot(e2)
    a22 = e2.dot(e2)
    i11 = 0.0
    i12 = 0.0
    i22 = 0.0
    if kind == 3:
        det = a11 * a22 - a12 * a12
        i11 = a22 / det
        i12 = -a12 / det
        i22 = a11 / det
    elif kind == 2:
        i11 = 1.0 / a11
    for q in range(4):
        # d2E/dz_q db_k = -(c_q e_k + s_k(q) r), a 3-vector for each free direction.
        f1 = c[q] * e1 + s1[q] * r
        f2 = c[q] * e2 + s2[q] * r
        for w in range(4):
            h1 = i11 * (c[w] * e1 + s1[w] * r) + i12 * (c[w] * e2 + s2[w] * r)
            h2 = i12 * (c[w] * e1 + s1[w] * r) + i22 * (c[w] * e2 + s2[w] * r)
            for i in range(3):
                for j in range(3):
                    value = -c[q] * c[w] * n[i] * n[j] - f1[i] * h1[j] - f2[i] * h2[j]
                    if i == j:
                        value += c[q] * c[w]
                    out[4 * q + w, i, j] = sign * value / d
