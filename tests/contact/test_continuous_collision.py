"""How far primitives can go, against a fine sampling of their paths."""

import numpy as np
import pytest

from sim_core.contact.closest import closest_point
from sim_core.contact.continuous_collision import point_shape_way, point_triangle_way, segments_way
from sim_core.contact.segments import closest_on_segments
from sim_core.contact.shapes import BOX, signed_distance
from sim_core.core import language as lang
from sim_core.core.language import F1, F2, vec3

OFFSET, KEEP = 2e-4, 0.1
SHAPE = np.array([BOX, 1e-3, 2e-3, 1.5e-3, 2e-4])


@lang.func
def _row(a: lang.template(), k: lang.i32):
    return vec3(a[k, 0], a[k, 1], a[k, 2])


@lang.kernel
def _ways(x: F2, d: F2, shape: F1, out: F1):
    out[0] = point_triangle_way(
        _row(x, 0), _row(x, 1), _row(x, 2), _row(x, 3), _row(d, 0), _row(d, 1), _row(d, 2), _row(d, 3), OFFSET, KEEP
    )
    out[1] = segments_way(
        _row(x, 0), _row(x, 1), _row(x, 2), _row(x, 3), _row(d, 0), _row(d, 1), _row(d, 2), _row(d, 3), OFFSET, KEEP
    )
    out[2] = point_shape_way(_row(x, 0), _row(d, 0), shape, OFFSET, KEEP)


@lang.kernel
def _gaps(x: F2, shape: F1, out: F1):
    p, y0, y1, y2 = _row(x, 0), _row(x, 1), _row(x, 2), _row(x, 3)
    b, _feature = closest_point(p, y0, y1, y2)
    out[0] = (p - b[0] * y0 - b[1] * y1 - b[2] * y2).norm() - OFFSET
    s, t = closest_on_segments(p, y0, y1, y2)
    out[1] = (p + s * (y0 - p) - y1 - t * (y2 - y1)).norm() - OFFSET
    distance, _n, _h = signed_distance(p, shape)
    out[2] = distance - OFFSET


def gaps(x):
    out = np.zeros(3)
    _gaps(np.ascontiguousarray(x), SHAPE, out)
    return out


def ways(x, d):
    out = np.zeros(3)
    _ways(np.ascontiguousarray(x), np.ascontiguousarray(d), SHAPE, out)
    return out


@pytest.mark.parametrize("kind", [0, 1, 2], ids=["point and triangle", "edges", "point and box"])
def test_a_path_ends_before_the_touch_and_not_long_before(kind):
    rng = np.random.default_rng(kind)
    cut = 0
    for _ in range(150):
        x, d = 4e-3 * rng.standard_normal((4, 3)), 6e-3 * rng.standard_normal((4, 3))
        before = gaps(x)[kind]
        if before <= 0.0:
            continue
        way = ways(x, d)[kind]
        path = np.array([gaps(x + s * way * d)[kind] for s in np.linspace(0.0, 1.0, 101)])
        assert path.min() >= 0.99 * KEEP * before
        if way < 1.0:
            cut += 1
            beyond = [gaps(x + s * d)[kind] for s in np.linspace(way, min(1.0, way + 0.5), 400)]
            assert min(beyond) < 2.0 * KEEP * before
    assert cut > 5


def test_what_overlaps_may_part_and_not_come_nearer():
    x = np.array([[0.0, 0.0, 1e-4], [-1e-3, -1e-3, 0.0], [1e-3, -1e-3, 0.0], [0.0, 1e-3, 0.0]])
    d = np.zeros((4, 3))
    d[0, 2] = 1e-3
    assert ways(x, d)[0] == 1.0
    assert ways(x, -d)[0] < 1e-5


def test_what_goes_together_is_free():
    x = np.array([[0.0, 0.0, 3e-4], [-1e-3, -1e-3, 0.0], [1e-3, -1e-3, 0.0], [0.0, 1e-3, 0.0]])
    assert ways(x, np.tile([0.0, 0.0, -1.0], (4, 1)))[0] == 1.0


def test_closest_points_of_segments_against_a_fine_sampling():
    rng = np.random.default_rng(4)
    s = np.linspace(0.0, 1.0, 201)
    for k in range(60):
        p0, p1, q0, _ = x = rng.standard_normal((4, 3))
        if k % 3 == 0:
            x[3] = q0 + (p1 - p0) * rng.uniform(0.5, 2.0)  # parallel
        first, second = p0 + s[:, None] * (x[1] - p0), q0 + s[:, None] * (x[3] - q0)
        sampled = np.linalg.norm(first[:, None] - second[None], axis=-1).min()
        found = gaps(x)[1] + OFFSET
        assert found <= sampled + 1e-12
        assert found >= sampled - 0.02
