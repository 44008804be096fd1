"""Closest points of two segments, the derivatives of their distance, and the mollifier of parallel ones.

Segments p0 p1 and q0 q1 with u = p1 - p0, v = q1 - q0. Closest points after Ericson, Real-Time Collision
Detection, sec. 5.1.9. The distance d has a kink where the segments are parallel; energies are multiplied by

    m(c) = (2 - c/e) c/e  for c < e, else 1,    c = |u x v|^2,  e = 1e-3 |u|^2 |v|^2 at rest

(Li et al., Incremental Potential Contact, ACM Trans. Graph. 39(4), 2020, sec. 5), which is C1; parallel edges are
held by their corners and faces.
"""

from sim_core.core import language as lang

PARALLEL = 1e-3
"""Squared sine of the angle below which the energy of two edges fades."""


@lang.func
def closest_on_segments(p0, p1, q0, q1):
    """Parameters s, t in [0, 1] of the closest points p0 + s u and q0 + t v."""
    u = p1 - p0
    v = q1 - q0
    w = p0 - q0
    a = u.dot(u)
    e = v.dot(v)
    b = u.dot(v)
    c = u.dot(w)
    f = v.dot(w)
    den = a * e - b * b
    s = 0.0
    if den > 1e-14 * a * e:
        s = lang.min(1.0, lang.max(0.0, (b * f - c * e) / den))
    t = (b * s + f) / e
    if t < 0.0:
        t = 0.0
        s = lang.min(1.0, lang.max(0.0, -c / a))
    elif t > 1.0:
        t = 1.0
        s = lang.min(1.0, lang.max(0.0, (b - c) / a))
    return s, t


@lang.func
def mollifier(p0, p1, q0, q1, e: lang.f64):
    """m and dm/dc."""
    c = (p1 - p0).cross(q1 - q0).norm_sqr()
    m = 1.0
    slope = 0.0
    if c < e:
        m = (2.0 - c / e) * c / e
        slope = 2.0 * (1.0 - c / e) / e
    return m, slope


@lang.func
def segment_second_derivative(p0, p1, q0, q1, s: lang.f64, t: lang.f64, out: lang.template()):
    """Write the second derivative of the distance [1/m] as 4 x 4 blocks ``(16, 3, 3)`` in (p0, p1, q0, q1).

    With r = sum c_i z_i minimised over the free parameters b, E = |r|^2 / 2:
    hess d = (E_zz - E_zb E_bb^-1 E_bz - n n^T) / d,  n = r / d.
    """
    c = lang.Vector([1.0 - s, s, t - 1.0, -t])
    r = c[0] * p0 + c[1] * p1 + c[2] * q0 + c[3] * q1
    d = lang.max(r.norm(), 1e-12)
    n = r / d
    e1 = p1 - p0
    e2 = q0 - q1
    s1 = lang.Vector([-1.0, 1.0, 0.0, 0.0])
    s2 = lang.Vector([0.0, 0.0, 1.0, -1.0])
    a11 = e1.dot(e1)
    a12 = e1.dot(e2)
    a22 = e2.dot(e2)
    free_s = s > 0.0 and s < 1.0
    free_t = t > 0.0 and t < 1.0
    i11 = 0.0
    i12 = 0.0
    i22 = 0.0
    if free_s and free_t:
        det = lang.max(a11 * a22 - a12 * a12, 1e-14 * a11 * a22)
        i11 = a22 / det
        i12 = -a12 / det
        i22 = a11 / det
    elif free_s:
        i11 = 1.0 / a11
    elif free_t:
        i22 = 1.0 / a22
    for k in range(4):
        f1 = c[k] * e1 + s1[k] * r
        f2 = c[k] * e2 + s2[k] * r
        for w in range(4):
            g1 = c[w] * e1 + s1[w] * r
            g2 = c[w] * e2 + s2[w] * r
            h1 = i11 * g1 + i12 * g2
            h2 = i12 * g1 + i22 * g2
            for i in range(3):
                for j in range(3):
                    value = -c[k] * c[w] * n[i] * n[j] - f1[i] * h1[j] - f2[i] * h2[j]
                    if i == j:
                        value += c[k] * c[w]
                    out[4 * k + w, i, j] = value / d


@lang.func
def parallel_derivatives(p0, p1, q0, q1, first: lang.template(), second: lang.template()):
    """Write dc/dz ``(4, 3)`` and d2c/dz2 as 4 x 4 blocks ``(16, 3, 3)``, c = |u x v|^2, z = (p0, p1, q0, q1)."""
    u = p1 - p0
    v = q1 - q0
    uu = u.dot(u)
    vv = v.dot(v)
    uv = u.dot(v)
    du = 2.0 * vv * u - 2.0 * uv * v
    dv = 2.0 * uu * v - 2.0 * uv * u
    one = lang.Vector([-1.0, 1.0, 0.0, 0.0])
    two = lang.Vector([0.0, 0.0, -1.0, 1.0])
    for k in range(4):
        for i in range(3):
            first[k, i] = one[k] * du[i] + two[k] * dv[i]
        for w in range(4):
            for i in range(3):
                for j in range(3):
                    value = -2.0 * (one[k] * one[w] * v[i] * v[j] + two[k] * two[w] * u[i] * u[j])
                    value += one[k] * two[w] * (4.0 * u[i] * v[j] - 2.0 * v[i] * u[j])
                    value += two[k] * one[w] * (4.0 * v[i] * u[j] - 2.0 * u[i] * v[j])
                    if i == j:
                        value += 2.0 * (one[k] * one[w] * vv + two[k] * two[w] * uu)
                        value -= 2.0 * uv * (one[k] * two[w] + two[k] * one[w])
                    second[4 * k + w, i, j] = value
