"""Markers followed picture by picture: numbers that stay, markers that are lost and come back, doubtful pictures."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.vision import choose_reference, detect_markers, track_frames
from sysid.vision.live import LiveTracker
from sysid.vision.render import dot_diameter, draw_dots

SIZE = (320, 240)
REST_IMAGES = 4


def layout(columns: int = 9, rows: int = 7) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(40.0, 280.0, columns), np.linspace(30.0, 210.0, rows))
    return np.stack([u.ravel(), v.ravel()], axis=1)


REST = layout()
DIAMETER_PX = dot_diameter(REST)


def pressed(share: float) -> np.ndarray:
    """A finger that slides by more than a pitch of 30 px and twists, in the middle."""
    arm = REST - np.array([160.0, 120.0])
    weight = np.exp(-(arm**2).sum(axis=1) / (2.0 * 80.0**2))[:, None]
    return np.asarray(REST + share * weight * ([34.0, 12.0] + 0.25 * arm[:, ::-1] * [1.0, -1.0]))


def picture(places: np.ndarray, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(0.0, 2.0, SIZE[::-1])
    return np.clip(draw_dots(places, DIAMETER_PX, *SIZE) + noise, 0, 255).astype(np.uint8)


def at_rest() -> tuple[LiveTracker, np.ndarray]:
    """A tracker that has its layout, and the true marker of each of its numbers."""
    tracker = LiveTracker(REST_IMAGES)
    for k in range(REST_IMAGES):
        frame = tracker.take(picture(REST, k))
    assert len(frame.uv) == len(REST) and not frame.note
    return tracker, np.argmin(np.linalg.norm(frame.uv[:, None] - REST[None], axis=2), axis=1)


def test_a_drawn_dot_has_its_centre_where_it_should_be() -> None:
    """The centroid of what is darker than the ground, of dots at all fractions of a pixel and at the rim."""
    for fraction in np.random.default_rng(0).uniform(0.0, 1.0, (20, 2)):
        centre = [20.0, 15.0] + fraction
        dark = 180.0 - draw_dots(np.array([centre, [np.nan, 3.0]]), 9.0, 40, 30)
        v, u = np.mgrid[:30, :40]
        assert np.allclose([(dark * u).sum() / dark.sum(), (dark * v).sum() / dark.sum()], centre, atol=0.02)
        assert dark.sum() / dark.max() == pytest.approx(np.pi * 4.5**2, rel=0.02)
    assert draw_dots(np.array([[-2.0, 5.0], [39.0, 29.0]]), 9.0, 40, 30).min() < 60


def test_numbers_stay_over_a_slide_by_more_than_a_pitch_and_back() -> None:
    tracker, number = at_rest()
    assert sorted(number) == list(range(len(REST)))
    for k, share in enumerate([*np.linspace(0.0, 1.0, 16), *np.linspace(1.0, 0.0, 16)]):
        places = pressed(share)
        frame = tracker.take(picture(places, 100 + k))
        assert np.isfinite(frame.uv).all() and (frame.confidence > 0.3).all()
        assert np.abs(frame.uv - places[number]).max() < 0.3


def test_they_are_those_of_the_offline_command_on_the_same_pictures() -> None:
    pictures = [picture(REST, k) for k in range(REST_IMAGES)] + [picture(pressed(s), 50) for s in (0.1, 0.2, 0.3)]
    tracker = LiveTracker(REST_IMAGES)
    live = [tracker.take(one).uv for one in pictures]
    found = [detect_markers(one) for one in pictures]
    offline = track_frames(found, choose_reference(found))
    assert np.allclose(live[-1], offline.uv[-1], atol=0.05)


def test_a_marker_that_is_covered_is_lost_and_returns_under_its_number() -> None:
    tracker, number = at_rest()
    hidden = np.linalg.norm(REST - [160.0, 120.0], axis=1) < 45.0
    assert 4 < hidden.sum() < 15
    for k, share in enumerate(np.linspace(0.0, 0.6, 12)):
        places = pressed(share)
        seen = np.where(hidden[:, None] & (3 <= k < 9), np.nan, places)
        frame = tracker.take(picture(seen, 200 + k))
        lost = ~np.isfinite(frame.uv[:, 0])
        assert not lost[~hidden[number]].any()
        assert lost[hidden[number]].all() == (3 <= k < 9) and lost.any() == (3 <= k < 9)
        assert (frame.confidence[lost] == 0.0).all()
        assert np.nanmax(np.abs(frame.uv - places[number])) < 0.3


def test_a_picture_without_markers_gives_none_says_why_and_the_next_one_goes_on() -> None:
    tracker, number = at_rest()
    blank = tracker.take(np.full(SIZE[::-1], 120, np.uint8))
    assert blank.note == "the image is uniform (grey 120 to 120)" and not np.isfinite(blank.uv).any()
    places = pressed(0.3)
    half = tracker.take(picture(places[:20], 1))
    assert "20 of 63 markers" in half.note or "which is which is in doubt" in half.note
    frame = tracker.take(picture(places, 2))
    assert not frame.note and np.abs(frame.uv - places[number]).max() < 0.3


def test_glare_that_moves_is_no_marker_and_a_layout_may_be_given() -> None:
    tracker = LiveTracker(12)
    rng = np.random.default_rng(4)
    for k in range(12):
        glare = REST[31] + [15.0, 15.0] + rng.uniform(-1.0, 1.0, 2) if k < 3 else np.full(2, np.nan)
        frame = tracker.take(picture(np.vstack([REST, glare]), k))
    assert len(frame.uv) == len(REST)
    assert tracker.reference is not None
    again = LiveTracker(layout=tracker.reference.uv[::-1])
    moved = again.take(picture(pressed(0.1), 30))
    assert np.abs(moved.uv[::-1] - tracker.take(picture(pressed(0.1), 30)).uv).max() < 0.05
