"""How far two primitives can go along straight paths before they touch: additive conservative advancement.

Within a time t in which the primitives' distance d cannot shrink by more than l t (l: sum of the largest moves
of each, common motion taken out) they stay apart for t < (d - offset) / l; that time is stepped again and
again. Li, Kaufman & Jiang, Codimensional Incremental Potential Contact, ACM Trans. Graph. 40(4), 2021, sec. 6.

A path ends where the gap d - offset falls below ``keep`` times that of its start. Primitives that overlap at
the start may part, not come nearer.
"""

from sim_core.contact.closest import closest_point
from sim_core.contact.segments import closest_on_segments
from sim_core.contact.shapes import signed_distance
from sim_core.core import language as lang

MOST_ADVANCES = 20000
ADVANCE = 0.8
"""Share of the safe time that is stepped; less than 1 - ``keep``, or the first step could end a path."""
NEAREST_M = 1e-9
"""Gap that primitives which overlap at the start are taken to have."""


@lang.func
def _point_triangle(p, y0, y1, y2):
    b, _feature = closest_point(p, y0, y1, y2)
    return (p - b[0] * y0 - b[1] * y1 - b[2] * y2).norm()


@lang.func
def _segments(p0, p1, q0, q1):
    s, t = closest_on_segments(p0, p1, q0, q1)
    return (p0 + s * (p1 - p0) - q0 - t * (q1 - q0)).norm()


@lang.func
def point_triangle_way(p, y0, y1, y2, dp, d0, d1, d2, offset: lang.f64, keep: lang.f64):
    """Share of the moves ``dp`` of a point and ``d0, d1, d2`` of a triangle's corners that is free."""
    common = 0.25 * (dp + d0 + d1 + d2)
    a = dp - common
    b0 = d0 - common
    b1 = d1 - common
    b2 = d2 - common
    reach = a.norm() + lang.max(b0.norm(), lang.max(b1.norm(), b2.norm()))
    way = 1.0
    distance = _point_triangle(p, y0, y1, y2)
    if distance - offset < reach:
        start = distance - offset
        if start <= 0.0:
            start = NEAREST_M
        zero = distance - start
        gap = start
        way = 0.0
        for _ in range(MOST_ADVANCES):
            ahead = way + ADVANCE * gap / reach
            if ahead >= 1.0:
                way = 1.0
                break
            gap = _point_triangle(p + ahead * a, y0 + ahead * b0, y1 + ahead * b1, y2 + ahead * b2) - zero
            if gap < keep * start:
                break
            way = ahead
    return way


@lang.func
def segments_way(p0, p1, q0, q1, a0, a1, b0, b1, offset: lang.f64, keep: lang.f64):
    """Share of the moves ``a0, a1`` of one segment's ends and ``b0, b1`` of another's that is free."""
    common = 0.25 * (a0 + a1 + b0 + b1)
    c0 = a0 - common
    c1 = a1 - common
    e0 = b0 - common
    e1 = b1 - common
    reach = lang.max(c0.norm(), c1.norm()) + lang.max(e0.norm(), e1.norm())
    way = 1.0
    distance = _segments(p0, p1, q0, q1)
    if distance - offset < reach:
        start = distance - offset
        if start <= 0.0:
            start = NEAREST_M
        zero = distance - start
        gap = start
        way = 0.0
        for _ in range(MOST_ADVANCES):
            ahead = way + ADVANCE * gap / reach
            if ahead >= 1.0:
                way = 1.0
                break
            gap = _segments(p0 + ahead * c0, p1 + ahead * c1, q0 + ahead * e0, q1 + ahead * e1) - zero
            if gap < keep * start:
                break
            way = ahead
    return way


@lang.func
def point_shape_way(y, dy, shape: lang.template(), offset: lang.f64, keep: lang.f64):
    """Share of the move ``dy`` of a point in the frame of a rigid shape that is free."""
    reach = dy.norm()
    way = 1.0
    distance, _n, _second = signed_distance(y, shape)
    if distance - offset < reach:
        start = distance - offset
        if start <= 0.0:
            start = NEAREST_M
        zero = distance - start
        gap = start
        way = 0.0
        for _ in range(MOST_ADVANCES):
            ahead = way + ADVANCE * gap / reach
            if ahead >= 1.0:
                way = 1.0
                break
            there, _m, _h = signed_distance(y + ahead * dy, shape)
            gap = there - zero
            if gap < keep * start:
                break
            way = ahead
    return way
