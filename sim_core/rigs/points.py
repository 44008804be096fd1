"""Local rest coordinates of the material points that a sensor or a camera follows."""

from __future__ import annotations

import numpy as np

from sim_core.errors import ConfigError
from sim_core.geometry.polygons import in_polygon
from sim_core.rigs.bodies import Affine, Gel, Outline, Rectangle, Sheet
from sim_core.rigs.fields import FloatArray
from sim_core.rigs.gel_shapes import Block, Disc, Dome
from sim_core.rigs.observers import Camera, OrthographicCamera, Points, Sight

IntArray = np.ndarray

_BLOCK_FACES = {
    "bottom": (2, 0, (0, 1)),
    "top": (2, 1, (0, 1)),
    "x_min": (0, 0, (1, 2)),
    "x_max": (0, 1, (1, 2)),
    "y_min": (1, 0, (0, 2)),
    "y_max": (1, 1, (0, 2)),
}
"""Face -> its normal axis, which end of it, and the two axes along the face."""


def marker_positions(points: Points, body: Sheet | Gel | Affine) -> tuple[FloatArray, IntArray]:
    """Local rest positions [m], shape ``(n, 3)``, and ids, int64 ``(n,)``, of the points on a body.

    A grid counts row by row along its first axis. On an outline only the points inside of it and
    outside of its holes are kept, on the ends of a disc those inside of it, on round faces those on the simulated side
    of planes of symmetry; their ids stay those of the full grid.
    """
    if points.positions_m is not None:
        ids = np.arange(points.count) if points.ids is None else np.array(points.ids, dtype=np.int64)
        return np.array(points.positions_m, dtype=np.float64), ids
    assert points.grid is not None
    shape = body.shape
    ids = np.arange(points.count)
    if isinstance(shape, Dome):
        return _within(_on_dome(points, shape), ids, shape.bounds())
    if isinstance(shape, Disc) and points.face == "side":
        return _within(_on_side(points, shape), ids, shape.bounds())
    low, high = shape.bounds()
    normal, end, axes = _BLOCK_FACES[points.face or "top"] if isinstance(shape, Block | Disc) else (2, 1, (0, 1))
    first, second = (
        _stations(low[axis], high[axis], n, points.margin_m) for axis, n in zip(axes, points.grid, strict=True)
    )
    positions = np.zeros((len(ids), 3))
    positions[:, axes[0]] = np.repeat(first, len(second))
    positions[:, axes[1]] = np.tile(second, len(first))
    positions[:, normal] = (low, high)[end][normal]
    if isinstance(shape, Outline):
        inside = _inside(positions[:, :2], shape)
        if not inside.any():
            raise ConfigError("No point of the marker grid lies on the sheet.", "Use a finer grid, or positions_m.")
        return positions[inside], ids[inside]
    if isinstance(shape, Disc):
        kept = np.hypot(positions[:, 0], positions[:, 1]) <= shape.radius_m
        if not kept.any():
            raise ConfigError("No point of the marker grid lies on the disc.", "Use a finer grid, or positions_m.")
        return positions[kept], ids[kept]
    assert isinstance(shape, Rectangle | Block)
    return positions, ids


def seen_points(
    sees: tuple[Sight, ...], bodies: dict[str, Sheet | Gel | Affine]
) -> list[tuple[str, FloatArray, IntArray]]:
    """Body, local rest positions [m] ``(n, 3)`` and ids of everything that a camera follows.

    Without given ids the numbers count on from one body to the next.
    """
    result = []
    offset = 0
    for sight in sees:
        positions, ids = marker_positions(sight.points, bodies[sight.body])
        if sight.points.ids is None:
            ids = ids + offset
            offset += sight.points.count
        result.append((sight.body, positions, ids))
    return result


def track_ids(camera: Camera, bodies: dict[str, Sheet | Gel | Affine]) -> IntArray:
    """Numbers of all tracks of a camera, int64 ``(n,)``: of the points on bodies, then of the origin."""
    ids = [ids for _, _, ids in seen_points(camera.sees, bodies)]
    if isinstance(camera, OrthographicCamera) and camera.origin_id is not None:
        ids.append(np.array([camera.origin_id], dtype=np.int64))
    return np.concatenate(ids)


def _stations(low: float, high: float, count: int, margin: float | None) -> FloatArray:
    if margin is None:
        return low + (high - low) * (np.arange(count) + 0.5) / count
    if 2.0 * margin >= high - low:
        raise ConfigError(
            f"margin_m is {margin:g}, but the face is only {high - low:g} m wide.",
            "Use less than half of the width.",
        )
    return np.linspace(low + margin, high - margin, count) if count > 1 else np.array([(low + high) / 2])


def _on_dome(points: Points, dome: Dome) -> FloatArray:
    """Rings of points about the axis, from the apex to the rim."""
    assert points.grid is not None
    rings, per_ring = points.grid
    radius = dome.cavity_radius_m if points.face == "inner" else dome.radius_m
    angle = 2.0 * np.pi * np.arange(per_ring) / per_ring
    if points.face == "base":
        margin = points.margin_m
        radii = _stations(dome.cavity_radius_m, dome.radius_m, rings, margin)
        heights = np.zeros(rings)
    else:
        margin = None if points.margin_m is None else points.margin_m / radius
        polar = _stations(0.0, np.pi / 2, rings, margin)
        radii, heights = radius * np.sin(polar), radius * np.cos(polar)
    return np.column_stack(
        [
            np.outer(radii, np.cos(angle)).ravel(),
            np.outer(radii, np.sin(angle)).ravel(),
            np.repeat(heights, per_ring),
        ]
    )


def _on_side(points: Points, disc: Disc) -> FloatArray:
    """Rings of points about the axis of a disc, from its bottom to its top."""
    assert points.grid is not None
    rings, per_ring = points.grid
    angle = 2.0 * np.pi * np.arange(per_ring) / per_ring
    heights = _stations(-disc.height_m / 2, disc.height_m / 2, rings, points.margin_m)
    round_about = np.tile(disc.radius_m * np.column_stack([np.cos(angle), np.sin(angle)]), (rings, 1))
    return np.column_stack([round_about, np.repeat(heights, per_ring)])


def _within(positions: FloatArray, ids: IntArray, bounds: FloatArray) -> tuple[FloatArray, IntArray]:
    """Those of the positions [m] that are within ``bounds`` [m] ``(2, 3)``."""
    slack = 1e-9 * float(np.ptp(bounds))
    kept = ((positions >= bounds[0] - slack) & (positions <= bounds[1] + slack)).all(axis=1)
    return positions[kept], ids[kept]


def _inside(points: FloatArray, outline: Outline) -> np.ndarray:
    inside = in_polygon(points, np.array(outline.polygon_m))
    for hole in outline.holes_m:
        inside &= ~in_polygon(points, np.array(hole))
    return inside
