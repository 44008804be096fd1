"""Identity of markers: known layouts, moved by known smooth fields, shuffled, thinned and blurred."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core.errors import RecordingError
from sysid.vision import (
    Detections,
    Reference,
    choose_reference,
    explain_by_poses,
    match_layout,
    pattern_motion,
    slide_sign,
    track_frames,
)
from sysid.vision.check import cycle_check, flipped_edges, folded_fraction
from sysid.vision.field import neighbour_residual, pitch_of
from sysid.vision.reference import follows_closely

SIZE = (420, 420)
CENTRE = np.array([210.0, 210.0])


def hexagonal(rings: int = 8, pitch: float = 18.0) -> np.ndarray:
    """Return a centred hexagonal layout [px], 217 markers for 8 rings."""
    rows = []
    for q in range(-rings, rings + 1):
        for r in range(max(-rings, -q - rings), min(rings, -q + rings) + 1):
            rows.append((pitch * (q + 0.5 * r), pitch * np.sqrt(0.75) * r))
    return CENTRE + np.array(rows)


def square(columns: int = 11, rows: int = 9, pitch: float = 28.0) -> np.ndarray:
    """Return a square layout [px], such as dots printed on a gel."""
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    grid = np.stack([u.ravel(), v.ravel()], axis=1) - [(columns - 1) / 2, (rows - 1) / 2]
    return CENTRE + pitch * grid


def press(
    points: np.ndarray,
    *,
    shift: tuple[float, float] = (0.0, 0.0),
    rotation_deg: float = 0.0,
    depth: float = 0.0,
    spot: tuple[float, float] = (0.0, 0.0),
    reach: float = 90.0,
) -> np.ndarray:
    """Move a layout as a pressed skin does: a patch slides and turns, spreads by ``depth``, the rim lags."""
    arm = points - CENTRE - np.array(spot)
    weight = np.exp(-np.sum(arm**2, axis=1) / (2.0 * reach**2))[:, None]
    angle = np.radians(rotation_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    moved = arm @ turn - arm + np.array(shift) + depth * arm
    return np.asarray(points + weight * moved)


def seen(uv: np.ndarray, rng: np.random.Generator, *, noise: float = 0.15, quality: float = 0.95) -> Detections:
    """Return detections of ``uv`` with noise, as they are (not shuffled)."""
    n = len(uv)
    return Detections(
        uv=uv + rng.normal(0.0, noise, uv.shape),
        area_px2=np.full(n, 110.0),
        quality=np.full(n, quality),
        merged=np.zeros(n, bool),
        image_size=SIZE,
        typical_area_px2=110.0,
    )


def take(found: Detections, rows: np.ndarray) -> Detections:
    """Return some rows of the detections in the given order."""
    return replace(
        found,
        uv=found.uv[rows],
        area_px2=found.area_px2[rows],
        quality=found.quality[rows],
        merged=found.merged[rows],
    )


def shuffled(found: Detections, rng: np.random.Generator) -> tuple[Detections, np.ndarray]:
    """Return the detections in random order, and where each marker went, shape (n,)."""
    order = rng.permutation(len(found))
    return take(found, order), np.argsort(order)


PRESSES = [
    {"shift": (14.0, -9.0), "rotation_deg": 6.0, "depth": 0.2},
    {"shift": (-30.0, 22.0), "rotation_deg": -8.0, "depth": 0.15, "reach": 140.0},
    {"shift": (26.0, 30.0), "rotation_deg": 10.0, "depth": 0.25, "spot": (30.0, -40.0), "reach": 120.0},
    {"shift": (0.0, 0.0), "rotation_deg": 15.0, "depth": 0.3},
    {"shift": (45.0, 0.0), "rotation_deg": 0.0, "depth": 0.1, "reach": 300.0},
]


@pytest.mark.parametrize("layout", [hexagonal(), square()], ids=["hexagonal", "square"])
@pytest.mark.parametrize("motion", PRESSES)
def test_every_number_is_right_after_a_large_smooth_motion(layout: np.ndarray, motion: dict) -> None:
    rng = np.random.default_rng(3)
    target = press(layout, **motion)
    found, truth = shuffled(seen(target, rng), rng)
    match = match_layout(layout, found.uv, found.quality, view=None)
    assert match.found.mean() > 0.99
    assert (match.index[match.found] == truth[match.found]).all()


def test_the_motions_are_larger_than_what_nearest_neighbours_could_follow() -> None:
    layout = hexagonal()
    rng = np.random.default_rng(3)
    target = seen(press(layout, **PRESSES[2]), rng).uv
    nearest = np.linalg.norm(layout[:, None] - target[None], axis=2).argmin(axis=1)
    assert np.mean(nearest == np.arange(len(layout))) < 0.6


@pytest.mark.parametrize("motion", PRESSES)
def test_lost_markers_are_missing_and_glare_is_not_taken(motion: dict) -> None:
    layout = hexagonal()
    rng = np.random.default_rng(5)
    target = press(layout, **motion)
    kept = np.sort(rng.permutation(len(layout))[:-15])
    glare = seen(np.array([[8.0, 8.0], [410.0, 12.0], [15.0, 400.0]]), rng, quality=0.4)
    thin = take(seen(target, rng), kept)
    found = replace(
        thin,
        uv=np.concatenate([thin.uv, glare.uv]),
        quality=np.concatenate([thin.quality, glare.quality]),
        area_px2=np.concatenate([thin.area_px2, glare.area_px2]),
        merged=np.concatenate([thin.merged, glare.merged]),
    )
    match = match_layout(layout, found.uv, found.quality, view=SIZE)
    truth = np.full(len(layout), -1)
    truth[kept] = np.arange(len(kept))
    assert (match.index[truth < 0] == -1).all()
    right = match.index == truth
    assert right[kept].mean() > 0.99
    assert ((match.index == -1) | right).all()


def test_a_whole_side_out_of_view_does_not_shift_the_numbers() -> None:
    layout = hexagonal()
    rng = np.random.default_rng(6)
    target = press(layout, shift=(70.0, 12.0), depth=0.1, reach=200.0)
    kept = np.flatnonzero(target[:, 0] < SIZE[0] - 30.0)
    assert 5 < len(layout) - len(kept) < 40
    found = take(seen(target, rng), kept)
    match = match_layout(layout, found.uv, found.quality, view=(SIZE[0] - 30, SIZE[1]))
    truth = np.full(len(layout), -1)
    truth[kept] = np.arange(len(kept))
    assert ((match.index == -1) | (match.index == truth)).all()
    assert match.found[kept].mean() > 0.97
    blind = match_layout(layout, found.uv, found.quality, starts={"solved": match.uv}, search=False)
    assert blind.cost > 2.0 * match.cost


def test_a_marker_that_does_not_move_with_its_neighbours_is_lost() -> None:
    layout = hexagonal()
    rng = np.random.default_rng(8)
    target = press(layout, **PRESSES[0])
    target[100] += [7.5, 0.0]
    found = seen(target, rng)
    match = match_layout(layout, found.uv, found.quality)
    assert np.flatnonzero(~match.found).tolist() == [100]
    assert np.isnan(match.residual_px[100])


def reference_of(layout: np.ndarray) -> Reference:
    return Reference(layout, 0, "test")


def still_frames(count: int, seed: int) -> tuple[np.ndarray, list[Detections], list[np.ndarray], np.ndarray]:
    """Return a layout, detections of ``count`` unrelated presses, the true rows, and the presses."""
    layout, rng = hexagonal(), np.random.default_rng(seed)
    frames, truths, poses = [], [], []
    for _ in range(count):
        shift, turn, depth = rng.uniform(-18, 18, 2), rng.uniform(-6, 6), rng.uniform(0.05, 0.25)
        spot = rng.uniform(-30, 30, 2)
        target = press(layout, shift=tuple(shift), rotation_deg=turn, depth=depth, spot=tuple(spot), reach=110.0)
        found, truth = shuffled(seen(target, rng), rng)
        frames.append(found)
        truths.append(truth)
        poses.append([*shift, depth, *spot, np.radians(turn)])
    return layout, frames, truths, np.array(poses)


def test_presses_far_apart_are_tracked_and_pass_the_checks() -> None:
    layout, frames, truths, _ = still_frames(12, 11)
    tracks = track_frames(frames, reference_of(layout))
    assert not tracks.failed.any()
    for k, truth in enumerate(truths):
        rows = tracks.matches[k].found
        assert (tracks.matches[k].index[rows] == truth[rows]).all()
        assert folded_fraction(layout, tracks.uv[k]) == 0.0
    assert tracks.found.mean() > 0.995
    assert tracks.confidence[tracks.found].min() >= 0.0
    assert np.median(tracks.confidence[tracks.found]) > 0.8
    cycle = cycle_check(tracks, frames)
    assert cycle.frames == 12
    assert cycle.rate == 1.0


def test_wrong_numbers_do_not_pass_the_checks() -> None:
    layout, frames, _, _ = still_frames(8, 12)
    tracks = track_frames(frames, reference_of(layout))
    row = np.flatnonzero(np.abs(layout[:, 1] - CENTRE[1]) < 1.0)
    wrong = tracks.uv.copy()
    wrong[3, row[:-1]] = tracks.uv[3, row[1:]]
    swapped = tracks.uv[3].copy()
    swapped[[100, 101]] = swapped[[101, 100]]
    assert folded_fraction(layout, tracks.uv[3]) == 0.0 < folded_fraction(layout, swapped)
    assert flipped_edges(layout, wrong[3]) > flipped_edges(layout, tracks.uv[3]) + 0.02
    index = tracks.matches[3].index.copy()
    index[row[:-1]] = tracks.matches[3].index[row[1:]]
    matches = list(tracks.matches)
    matches[3] = replace(matches[3], index=index)
    cycle = cycle_check(replace(tracks, uv=wrong, matches=tuple(matches)), frames)
    assert cycle.rate < 0.999
    assert cycle.worst_rate < 0.95


def test_a_sequence_follows_motion_far_beyond_the_reach_of_the_search() -> None:
    layout, rng = square(), np.random.default_rng(13)
    path = [press(layout, shift=(4.0 * k, -2.5 * k), rotation_deg=1.0 * k, reach=500.0) for k in range(50)]
    frames = [shuffled(seen(target, rng), rng)[0] for target in path]
    assert follows_closely(frames)
    tracks = track_frames(frames, reference_of(layout))
    assert not tracks.failed.any()
    error = np.linalg.norm(tracks.uv - np.array(path), axis=2)
    assert np.nanmax(error) < 1.0
    assert tracks.found.mean() > 0.99
    assert np.linalg.norm(path[-1] - layout, axis=1).mean() > 5.0 * pitch_of(layout)


def test_a_lattice_that_slides_through_the_view_keeps_its_numbers() -> None:
    layout, rng = square(columns=31), np.random.default_rng(24)
    frames, path = [], []
    for k in range(30):
        target = layout + [3.0 * k, 0.0]
        rows = np.flatnonzero((target[:, 0] > 5.0) & (target[:, 0] < 415.0))
        frames.append(take(seen(target, rng), rng.permutation(rows)))
        path.append(target)
    first = np.flatnonzero((layout[:, 0] > 5.0) & (layout[:, 0] < 415.0))
    tracks = track_frames(frames, reference_of(layout[first]))
    error = np.linalg.norm(tracks.uv - np.array(path)[:, first], axis=2)
    assert np.nanmax(error) < 1.0
    assert tracks.found[-1].sum() == np.sum(path[-1][first, 0] < 415.0)


def test_a_turned_pattern_is_reached_over_the_frames_between() -> None:
    layout, rng = square(), np.random.default_rng(25)
    angles = rng.permutation(np.arange(0.0, 44.0, 4.0))
    path = [press(layout, rotation_deg=angle, reach=1e4) for angle in angles]
    frames = [shuffled(seen(target, rng), rng)[0] for target in path]
    tracks = track_frames(frames, reference_of(layout))
    assert not tracks.failed.any()
    assert np.nanmax(np.linalg.norm(tracks.uv - np.array(path), axis=2)) < 1.0
    assert tracks.found.mean() > 0.98


def test_unrelated_presses_do_not_look_like_a_sequence() -> None:
    _, frames, _, _ = still_frames(12, 14)
    assert not follows_closely(frames)


def test_empty_frames_have_no_tracks() -> None:
    layout, frames, _, _ = still_frames(5, 15)
    frames[2] = replace(take(frames[2], np.arange(0)), note="the image is uniform (grey 0 to 0)")
    tracks = track_frames(frames, reference_of(layout))
    assert tracks.failed.tolist() == [False, False, True, False, False]
    assert not tracks.found[2].any()
    assert (tracks.confidence[2] == 0.0).all()


def test_noise_instead_of_a_pattern_is_given_up() -> None:
    layout, frames, _, _ = still_frames(4, 16)
    rng = np.random.default_rng(16)
    frames[1] = replace(frames[1], uv=rng.uniform(60, 360, frames[1].uv.shape))
    tracks = track_frames(frames, reference_of(layout))
    assert tracks.failed.tolist() == [False, True, False, False]


def test_a_frame_that_is_right_in_part_only_is_given_up() -> None:
    layout, frames, _, _ = still_frames(4, 20)
    rng = np.random.default_rng(20)
    uv = frames[2].uv.copy()
    spoiled = uv[:, 0] > 230.0
    uv[spoiled] += rng.uniform(-9, 9, (int(spoiled.sum()), 2))
    frames[2] = replace(frames[2], uv=uv)
    tracks = track_frames(frames, reference_of(layout))
    assert tracks.matches[2].found.mean() > 0.5
    assert tracks.failed.tolist() == [False, False, True, False]


def test_glare_in_the_reference_is_dropped() -> None:
    layout, frames, _, _ = still_frames(14, 17)
    with_glare = np.concatenate([layout, [[395.0, 60.0]]])
    tracks = track_frames(frames, reference_of(with_glare))
    assert len(tracks.reference) == len(layout)
    assert np.allclose(tracks.dropped, [[395.0, 60.0]])


def test_the_reference_is_the_rest_image_the_lightest_press_or_the_first() -> None:
    _, frames, _, poses = still_frames(12, 18)
    posed = np.ones(12, bool)
    depth = poses[:, 2]
    lightest = choose_reference(frames, posed=posed, depth=depth)
    assert lightest.frame == int(np.argmin(depth))
    assert "lightest press" in lightest.source
    posed[0] = False
    rest = choose_reference(frames, posed=posed, depth=depth)
    assert rest.frame == 0
    assert "unloaded" in rest.source
    assert "most typical" in choose_reference(frames).source
    assert choose_reference(frames, choice=7).frame == 7
    rng = np.random.default_rng(18)
    steps = [seen(hexagonal() + [0.3 * k, 0.0], rng) for k in range(6)]
    assert "follow one another" in choose_reference(steps).source


def test_a_reference_that_cannot_be_is_refused() -> None:
    _, frames, _, _ = still_frames(3, 19)
    empty = [replace(take(frame, np.arange(0)), note="the image is uniform") for frame in frames]
    with pytest.raises(RecordingError, match="No marker pattern in any of 3 images: the image is uniform"):
        choose_reference(empty)
    with pytest.raises(RecordingError, match="frame 9 does not exist"):
        choose_reference(frames, choice=9)
    with pytest.raises(RecordingError, match="no depth is known"):
        choose_reference(frames, choice="shallowest")
    with pytest.raises(RecordingError, match="'deepest' is not known"):
        choose_reference(frames, choice="deepest")


def test_the_neighbour_residual_blames_the_marker_that_is_off() -> None:
    layout = hexagonal()
    target = press(layout, **PRESSES[0])
    target[100] += [6.0, 0.0]
    residual = neighbour_residual(layout, target, pitch=18.0)
    assert residual[100] > 5.0
    assert np.delete(residual, 100).max() < 2.0


@pytest.mark.parametrize("sense", [1.0, -1.0])
@pytest.mark.parametrize("mirror", [1.0, -1.0])
def test_the_sense_of_a_labelled_slide_is_found_whatever_the_camera(sense: float, mirror: float) -> None:
    layout, rng = hexagonal(), np.random.default_rng(21)
    angle = np.radians(rng.uniform(0, 360))
    camera = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ np.diag([1.0, mirror])
    labels, uv = [], []
    for _ in range(150):
        x, y, depth = rng.uniform(-4, 4), rng.uniform(-4, 4), rng.uniform(1, 5)
        rx, ry, rz = np.radians(rng.uniform(-8, 8, 3))
        slide = -sense * 2.0 * depth / 3.0 * camera @ [x, y]
        spot = camera @ (250.0 * np.array([-ry, rx]))
        turn = -sense * mirror * np.degrees(rz) * 0.5
        moved = press(layout, shift=tuple(slide), rotation_deg=turn, depth=0.05 * depth, spot=tuple(spot), reach=60.0)
        uv.append(moved + rng.normal(0, 0.1, moved.shape))
        labels.append([1e-3 * x, 1e-3 * y, 1e-3 * depth, rx, ry, rz])
    check = explain_by_poses(pattern_motion(layout, np.array(uv)), np.array(labels), np.arange(150) % 5 == 0, depth=2)
    assert check.r_squared["displacement_u"] > 0.9
    assert check.r_squared["displacement_v"] > 0.9
    verdict = slide_sign(check)
    assert verdict.alignment * sense > 0.95
    assert verdict.twist * sense > 0.0
    assert verdict.upright == (mirror > 0)


def test_poses_that_have_nothing_to_do_with_the_motion_explain_nothing() -> None:
    layout, frames, _, _ = still_frames(60, 22)
    tracks = track_frames(frames, reference_of(layout))
    poses = np.random.default_rng(23).normal(size=(60, 6))
    check = explain_by_poses(pattern_motion(layout, tracks.uv), poses, np.arange(60) % 3 == 0)
    assert max(check.r_squared.values()) < 0.3
