"""Where the samples and triangles of :mod:`sim_core.contact.surface` are: what does not depend on the contact law.

A sample ``s`` has the nodes ``own[s, :used[s]]`` with ``weights[s]`` and the candidate triangles
``near[first[s]:first[s + 1]]``.
"""

from sim_core.contact.closest import closest_point
from sim_core.contact.continuous_collision import point_triangle_way
from sim_core.contact.pressure_and_friction import OFFSET
from sim_core.core import language as lang
from sim_core.core.language import F1, F2, I1, I2, vec3
from sim_core.kernels import row


@lang.func
def sample_at(x: lang.template(), own: lang.template(), used: lang.template(), weights: lang.template(), s: lang.i32):
    p = vec3(0.0, 0.0, 0.0)
    for a in range(used[s]):
        p += weights[s, a] * row(x, own[s, a])
    return p


@lang.func
def closest_on(x: lang.template(), p, triangles: lang.template(), t: lang.i32):
    """Barycentric weights of the point of triangle ``t`` closest to ``p``, its feature, p minus it."""
    y0, y1, y2 = row(x, triangles[t, 0]), row(x, triangles[t, 1]), row(x, triangles[t, 2])
    b, feature = closest_point(p, y0, y1, y2)
    return b, feature, p - b[0] * y0 - b[1] * y1 - b[2] * y2


@lang.kernel
def sides(x: F2, own: I2, used: I1, weights: F2, triangles: I2, first: I1, near: I1, normals: F2, side: F1):
    """On which side of every candidate its sample is: +1 where the normal points. Also write ``normals``: of the
    nodes, sums over the triangles around, weighted with their areas."""
    lang.loop_config(serialize=True)
    for t in range(triangles.shape[0]):
        for k in range(3):
            for j in lang.static(range(3)):
                normals[triangles[t, k], j] = 0.0
    lang.loop_config(serialize=True)
    for t in range(triangles.shape[0]):
        y0 = row(x, triangles[t, 0])
        n = (row(x, triangles[t, 1]) - y0).cross(row(x, triangles[t, 2]) - y0)
        for k in range(3):
            for j in lang.static(range(3)):
                normals[triangles[t, k], j] = normals[triangles[t, k], j] + n[j]
    lang.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        if first[s] < first[s + 1]:
            p = sample_at(x, own, used, weights, s)
            for k in range(first[s], first[s + 1]):
                b, _feature, r = closest_on(x, p, triangles, near[k])
                n = vec3(0.0, 0.0, 0.0)
                for j in range(3):
                    n += b[j] * row(normals, triangles[near[k], j])
                side[k] = 1.0
                if n.dot(r) < 0.0:
                    side[k] = -1.0


@lang.kernel
def frames(x: F2, own: I2, used: I1, weights: F2, triangles: I2, number: I1, lag: I2, out: F2):
    """How the point of the triangle's frame in which the sample is moves with the corners: A_j, ``out[s, 9 j:]``.

    c' = sum_j beta_j y_j + h n with the height h over the plane, the normal n and the (unclamped) barycentric
    coordinates beta: dc' = sum_j A_j dy_j,  A_j = beta_j 1 - h grad(beta_j) n^T.
    """
    lang.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        if number[s] > 0:
            t = lag[s, 0]
            y0 = row(x, triangles[t, 0])
            e1 = row(x, triangles[t, 1]) - y0
            e2 = row(x, triangles[t, 2]) - y0
            n = e1.cross(e2)
            g1 = e2.cross(n) / n.norm_sqr()
            g2 = n.cross(e1) / n.norm_sqr()
            n = n.normalized()
            r = sample_at(x, own, used, weights, s) - y0
            h = n.dot(r)
            beta = vec3(1.0 - g1.dot(r) - g2.dot(r), g1.dot(r), g2.dot(r))
            for j in lang.static(range(3)):
                g = -g1 - g2
                if lang.static(j == 1):
                    g = g1
                elif lang.static(j == 2):
                    g = g2
                for i in lang.static(range(3)):
                    for k in lang.static(range(3)):
                        out[s, 9 * j + 3 * i + k] = -h * g[i] * n[k]
                    out[s, 9 * j + 4 * i] = out[s, 9 * j + 4 * i] + beta[j]


@lang.kernel
def free_way(
    x: F2, move: F2, own: I2, used: I1, weights: F2, triangles: I2, first: I1, near: I1, c: F1, keep: F1, way: F1
):  # fmt: skip
    """Shorten ``way`` to the share of ``move`` from ``x`` on that no sample ends at a triangle."""
    lang.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        if first[s] < first[s + 1]:
            p = sample_at(x, own, used, weights, s)
            d = sample_at(move, own, used, weights, s)
            for k in range(first[s], first[s + 1]):
                i, j, m = triangles[near[k], 0], triangles[near[k], 1], triangles[near[k], 2]
                free = point_triangle_way(
                    p, row(x, i), row(x, j), row(x, m), d, row(move, i), row(move, j), row(move, m),
                    c[OFFSET], keep[0],
                )  # fmt: skip
                way[0] = lang.min(way[0], free)
