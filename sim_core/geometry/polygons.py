"""Polygons in a plane: which points they hold, and whether their edges cross."""

from __future__ import annotations

import numpy as np


def in_polygon(points: np.ndarray, polygon: np.ndarray) -> np.ndarray:
    """Which points ``(n, 2)`` a polygon ``(k, 2)`` holds, by the number of its edges that a ray to the right crosses:
    bool ``(n,)``."""
    x, y = points[:, :1], points[:, 1:]
    (x0, y0), (x1, y1) = polygon.T, np.roll(polygon, -1, axis=0).T
    straddles = (y0 > y) != (y1 > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    return np.asarray((straddles & (x < crossing)).sum(axis=1) % 2 == 1)


def area_of(polygon: np.ndarray) -> float:
    """Area of a polygon ``(k, 2)`` that does not cross itself, half the sum of x_i y_i+1 - y_i x_i+1."""
    x, y = polygon.T
    return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


def crossing_edges(one: np.ndarray, other: np.ndarray) -> tuple[int, int] | None:
    """The first edge of each of two polygons ``(k, 2)``, by the corners where they begin, that have a point in common.

    Of one polygon with itself, neighbouring edges share a corner, and have more in common where one turns back on the
    other. Edges p, p + r and q, q + s meet where the cross products (q - p) x s and (q - p) x r lie between 0 and
    r x s.
    """
    itself = one is other
    p, r = one, np.roll(one, -1, axis=0) - one
    q, s = other, np.roll(other, -1, axis=0) - other
    between = q[None] - p[:, None]
    turn = _cross(r[:, None], s[None])
    along, across = _cross(between, s[None]), _cross(between, r[:, None])
    size = np.linalg.norm(r, axis=1)[:, None] * np.linalg.norm(s, axis=1)[None]
    parallel = np.abs(turn) <= 1e-12 * size
    with np.errstate(divide="ignore", invalid="ignore"):
        meet = (
            ~parallel & (along / turn >= 0.0) & (along / turn <= 1.0) & (across / turn >= 0.0) & (across / turn <= 1.0)
        )
        # Parallel edges on one line have points in common where their extents do.
        length2 = np.sum(r**2, axis=1)[:, None]
        begin = np.sum(between * r[:, None], axis=-1) / length2
        end = begin + np.sum(s[None] * r[:, None], axis=-1) / length2
        on_line = np.abs(across) <= 1e-12 * size
        low, high = np.minimum(begin, end), np.maximum(begin, end)
        over = parallel & on_line & (low <= 1.0) & (high >= 0.0)
        more = parallel & on_line & (low < 1.0 - 1e-9) & (high > 1e-9)
    meet |= over
    if itself:
        n = len(one)
        i, j = np.indices((n, n))
        neighbours = ((i - j) % n == 1) | ((j - i) % n == 1)
        meet = np.where(neighbours, more, meet) & (i < j)
    found = np.argwhere(meet)
    return (int(found[0][0]), int(found[0][1])) if len(found) else None


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
