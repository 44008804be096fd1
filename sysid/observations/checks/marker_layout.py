"""How markers lie in the first frame, against where the rig has them: scale, mirror image, turn, numbering.

The best affine map from where the rig has the markers to where they were seen tells what is wrong: its determinant is
negative for a mirror image (or a left-handed frame), its singular values are the scale, its rotation is the turn. Where
no map fits, the numbers are not those of the rig. In a picture a plane is foreshortened across the axis about which it
is turned, and never along it, so that its scale is the larger singular value of the map from the plane to the picture:
a strip that hangs where the rig has it straight is no larger for that.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from sim_core.rigs import Rig
from sysid.observations.checks.finding import Finding
from sysid.observations.checks.rig_size import expected_markers, on_body
from sysid.observations.rig_match import marker_numbers
from sysid.recording import Recording
from sysid.settings.observations import OBSERVATIONS


def marker_layout(recording: Recording, rig: Rig) -> Iterator[Finding]:
    """The layout of each sensor's and camera's markers in the first frame that shows most of them."""
    numbers = marker_numbers(rig)
    for name, known in numbers.items():
        stream = recording.markers.get(name) or recording.tracks.get(name)
        expected = expected_markers(rig, name, recording) if stream is not None else None
        if stream is None or expected is None:
            continue
        places = recording.markers[name].position if name in recording.markers else recording.tracks[name].uv
        common, mine, theirs = np.intersect1d(known, stream.ids, return_indices=True)
        early = np.isfinite(places[:20, theirs]).all(axis=-1).sum(axis=1)
        seen = places[int(np.argmax(early)), theirs]
        good = np.isfinite(seen).all(axis=1) & np.isfinite(expected[mine]).all(axis=1)
        if good.sum() < OBSERVATIONS.layout_markers or len(common) < OBSERVATIONS.layout_markers:
            continue
        unit = "m" if name in recording.markers else "px"
        body = on_body(rig, name) if unit == "px" else None
        flat = None if body is None else body[mine][good]
        yield from _compared(name, stream.topic, unit, expected[mine][good], seen[good], flat)


def _compared(
    name: str, topic: str, unit: str, expected: np.ndarray, seen: np.ndarray, body: np.ndarray | None
) -> Iterator[Finding]:
    """``body`` ``(n, 3)``: where the markers are on their body, if that is known."""
    flat, shown = _plane(expected), seen
    if _as_a_set(expected, seen):
        off = _misfit(seen - expected)
        yield Finding(
            "marker_order",
            topic,
            "stops a fit",
            f"The markers of {name} lie where the rig has them, but under other numbers: by their numbers they are "
            f"{off:.3g} {unit} off in the first frame, as a rule.",
            "Number them as the rig does (grids count row by row), or give `ids` in the rig.",
            values=(off,),
            bound=OBSERVATIONS.layout_fit_share,
            part=name,
        )
        return
    if flat is None:
        return
    centre, axes = flat
    local = (expected - centre) @ axes.T
    spacing = float(np.median(cKDTree(local).query(local, k=2)[0][:, 1]))
    design = np.column_stack([local, np.ones(len(local))])
    solution, *_ = np.linalg.lstsq(design, shown, rcond=None)
    left = shown - design @ solution
    linear = solution[:2].T  # plane of the rig to what was seen
    sizes = np.linalg.svd(linear, compute_uv=False)
    scale = float(np.sqrt(sizes[0] * sizes[1]))
    surface = None if body is None else _plane(body)
    if _misfit(left) > OBSERVATIONS.layout_fit_share * spacing * max(scale, 1e-9):
        return  # bent or folded: its layout tells nothing more
    if body is not None and surface is not None:
        on_it = np.column_stack([(body - surface[0]) @ surface[1].T, np.ones(len(body))])
        scale = _largest(on_it, seen) / _largest(on_it, expected)
    known = axes.T[:, :]  # the plane as the rig has it, in what is seen
    target = linear @ axes if seen.shape[1] == expected.shape[1] == 2 else linear
    if not 1.0 / OBSERVATIONS.layout_scale < scale < OBSERVATIONS.layout_scale:
        word = " (millimetres?)" if unit == "m" and 500.0 < scale < 2000.0 else ""
        yield Finding(
            "marker_scale",
            topic,
            "stops a fit",
            f"The markers of {name} are {scale:.3g} times as far apart in the first frame as in the rig{word}: "
            f"neighbours are {scale * spacing:.3g} {unit} apart, in the rig {spacing:.3g} {unit}.",
            "Write `length_unit: mm` into this sensor of the rig, or record metres."
            if unit == "m"
            else "Look at the focal length, the distance of the camera and the size of the picture in the rig.",
            values=(scale * spacing,),
            bound=spacing,
            part=name,
        )
    if seen.shape[1] == 2:
        if np.linalg.det(target) < 0.0:
            yield Finding(
                "mirrored",
                topic,
                "stops a fit",
                f"The markers of {name} lie as in a mirror against those of the rig in the first frame.",
                "Look whether the picture is flipped, whether v points down, and at the pose of the camera.",
                part=name,
            )
            return
        turn = float(np.degrees(np.arctan2(target[1, 0] - target[0, 1], target[0, 0] + target[1, 1])))
    else:
        # In space: the plane's own axes, as seen, against where the rig has them.
        own = linear / np.linalg.norm(linear, axis=0)
        cosine = np.clip(np.sum(own.T * axes, axis=1), -1.0, 1.0)
        turn = float(np.degrees(np.arccos(cosine)).max())
        del known
    if abs(turn) > OBSERVATIONS.layout_turn_deg:
        yield Finding(
            "turned",
            topic,
            "stops a fit",
            f"The markers of {name} lie turned by {turn:.0f} degrees against those of the rig in the first frame (more "
            f"than {OBSERVATIONS.layout_turn_deg:g} degrees).",
            "Look at the pose of the camera or sensor in the rig, and at the order and handedness of its axes.",
            values=(turn,),
            bound=OBSERVATIONS.layout_turn_deg,
            part=name,
        )


def _plane(points: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Middle ``(d,)`` and two axes ``(2, d)`` of points that lie in a plane; None for points on a line."""
    centre = points.mean(axis=0)
    if points.shape[1] == 2:
        spread = np.linalg.svd(points - centre, compute_uv=False)
        return (centre, np.eye(2)) if spread[1] > OBSERVATIONS.layout_line_share * spread[0] else None
    _, spread, axes = np.linalg.svd(points - centre, full_matrices=False)
    return (centre, axes[:2]) if spread[1] > OBSERVATIONS.layout_line_share * spread[0] else None


def _largest(design: np.ndarray, places: np.ndarray) -> float:
    """The larger singular value of the best affine map from a plane to places."""
    solution, *_ = np.linalg.lstsq(design, places, rcond=None)
    return float(np.linalg.svd(solution[:2], compute_uv=False)[0])


def _misfit(left: np.ndarray) -> float:
    return float(np.median(np.linalg.norm(left, axis=1)))


def _as_a_set(expected: np.ndarray, seen: np.ndarray) -> bool:
    """Whether the points ``(n, d)`` lie at the places of the rig's, but under others' numbers.

    A map of second degree allows for sag and perspective. By the points' own numbers it does not fit, by those of the
    nearest it does; which is nearest and the map are found in turns (iterated closest points, Besl & McKay 1992).
    """
    spacing = float(np.median(cKDTree(expected).query(expected, k=2)[0][:, 1]))
    middle, size = expected.mean(axis=0), float(np.ptp(expected, axis=0).max())
    local = (expected - middle) / size
    if expected.shape[1] == 3:
        local = local @ np.linalg.svd(local, full_matrices=False)[2][:2].T
    u, v = local.T
    design = np.column_stack([np.ones(len(u)), u, v, u * u, u * v, v * v])
    if len(expected) < 2 * design.shape[1] or np.linalg.matrix_rank(design, 1e-6) < design.shape[1]:
        return False
    by_number = seen - design @ np.linalg.lstsq(design, seen, rcond=None)[0]
    if _misfit(by_number) < OBSERVATIONS.layout_fit_share * spacing:
        return False
    from scipy.optimize import linear_sum_assignment

    where = expected
    for _ in range(OBSERVATIONS.layout_rounds):
        rows, order = linear_sum_assignment(cdist(where, seen))
        where = design @ np.linalg.lstsq(design[rows], seen[order], rcond=None)[0]
    return _misfit(seen[order] - where) < OBSERVATIONS.layout_fit_share * spacing
