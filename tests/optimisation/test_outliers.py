"""Mistakes of trackers are found and left out; what moves, drifts, steps or is missing from the model is not."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from sim_core.simulate import Trace
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.solve import SOLVE
from sysid.solve.outliers import mistakes, without_outliers, worth_another_fit

N, M, SIGMA = 200, 30, 0.1
T = np.arange(N) / 30.0
LABELS = tuple(f"marker {k} {a}" for k in range(M) for a in "uv")
RNG = np.random.default_rng(2)
GRID = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1).reshape(M, 2) * 30.0
PLACE = GRID + 40.0 * np.sin(2.0 * T)[:, None, None] * [1.0, 0.3]
KNOWN = {"video": ChannelNoise(np.full(2 * M, SIGMA), 0.0, "known")}
NOISE = SIGMA * RNG.standard_normal(PLACE.shape)


def track(miss: np.ndarray | float = 0.0) -> Measured:
    return Measured("video", "tracks", T, (PLACE + NOISE + miss).reshape(N, -1), LABELS)


def found(miss: np.ndarray | float = 0.0) -> np.ndarray:
    return mistakes(track(miss), PLACE.reshape(N, -1))


def jumps(share: float, size: float) -> np.ndarray:
    """Jumps of ``size`` px in any direction of a share of the readings ``(N, M, 2)``."""
    rng = np.random.default_rng(7)
    angle = rng.uniform(0.0, 2.0 * np.pi, (N, M))
    hit = rng.uniform(size=(N, M)) < share
    return np.asarray(size * hit[:, :, None] * np.stack([np.cos(angle), np.sin(angle)], axis=2))


def test_a_clean_recording_loses_nothing() -> None:
    assert not found().any()
    assert not mistakes(replace(track(), values=PLACE.reshape(N, -1)), PLACE.reshape(N, -1)).any()


@pytest.mark.parametrize("share", [0.002, 0.05, 0.15])
def test_jumps_are_found_one_by_one(share: float) -> None:
    miss = jumps(share, 5.0)
    true = np.any(miss != 0.0, axis=2)
    mask = found(miss)
    assert np.mean(mask[true]) > 0.97
    assert not mask[~true].any()


def test_mistakes_in_a_shaking_picture_are_found_to_its_last_frame() -> None:
    """All markers of a picture move together, by up to six times the noise of one in the last frame, which has no later
    neighbour."""
    shake = 2.0 * SIGMA * np.sin(9.0 * T + np.array([[0.0], [1.0]])).T[:, None]
    shake[-1] += 6.0 * SIGMA
    miss = jumps(0.03, 5.0)
    miss[-1, [2, 17]] = [[6.0, 1.0], [-2.0, 7.0]]
    true = np.any(miss != 0.0, axis=2)
    mask = found(miss + shake)
    assert np.mean(mask[true]) > 0.97 and mask[-1, [2, 17]].all()
    assert not mask[~true].any()


def test_mistakes_of_some_frames_in_a_row_are_found() -> None:
    miss = np.zeros((N, M, 2))
    miss[50:54, 12] = [4.0, -3.0]
    mask = found(miss)
    assert mask[50:54, 12].all() and mask.sum() == 4


def test_exchanged_markers_are_found_for_as_long_as_they_are() -> None:
    seen = PLACE + NOISE
    seen[90:, [3, 8]] = seen[90:, [8, 3]]
    mask = mistakes(replace(track(), values=seen.reshape(N, -1)), PLACE.reshape(N, -1))
    assert mask[90:, [3, 8]].all() and mask.sum() == 2 * (N - 90)


def test_a_marker_that_has_moved_to_the_place_of_another_stays() -> None:
    miss = np.zeros((N, M, 2))
    miss[:, 4, 0] = np.clip(T - 2.0, 0.0, 1.0) * -30.0
    assert not found(miss).any()


def test_a_marker_at_the_place_of_one_that_left_stays() -> None:
    """Both drift, and nobody has the place of the first: nothing was exchanged."""
    miss = np.zeros((N, M, 2))
    miss[:, 4, 0] = np.clip(T - 2.0, 0.0, 1.0) * -30.0
    miss[:, 3, 1] = np.clip(T - 2.0, 0.0, 1.0) * -45.0
    assert not found(miss).any()


def misses() -> dict[str, np.ndarray]:
    """What a law that is missing leaves: smooth, a step for good, a bump of many markers at once, a steep drift."""
    one = np.zeros((N, M, 2))
    one[:, 4, 0] = 20.0 * np.sin(4.0 * T)
    step = np.zeros((N, M, 2))
    step[70:, :3] = 3.0
    slip = np.zeros((N, M, 2))
    slip[70:76] = [3.0, 0.0]
    ramp = np.zeros((N, M, 2))
    ramp[:, :5, 1] = np.clip(T - 2.0, 0.0, 1.0)[:, None] * 30.0
    return {"one marker": one, "step": step, "all at once": slip, "drift": ramp}


@pytest.mark.parametrize("name", list(misses()))
def test_what_a_missing_law_leaves_stays(name: str) -> None:
    assert found(misses()[name]).sum() <= 1


def line(miss: np.ndarray) -> np.ndarray:
    """What is found of as many markers as ``miss`` ``(N, m, 2)`` has, in a row."""
    m = miss.shape[1]
    place = np.arange(m)[None, :, None] * 30.0 + 40.0 * np.sin(2.0 * T)[:, None, None] * [1.0, 0.3]
    seen = place + SIGMA * np.random.default_rng(2).standard_normal(place.shape) + miss
    labels = tuple(f"marker {k} {a}" for k in range(m) for a in "uv")
    return mistakes(Measured("video", "tracks", T, seen.reshape(N, -1), labels), place.reshape(N, -1))


def bumps(m: int, who: slice | list[int], at: tuple[int, ...] = (70,)) -> np.ndarray:
    """Four frames long, smooth, the same for all of ``who``."""
    miss = np.zeros((N, m, 2))
    for first in at:
        miss[first : first + 4, who, 0] = 5.0 * np.sin(np.pi * (np.arange(4) + 0.5) / 4.0)[:, None]
    return miss


def ring_downs(m: int, who: slice, hertz: float, tau: float) -> np.ndarray:
    """Three that die away with ``tau`` [s]."""
    miss = np.zeros((N, m, 2))
    for start in (2.0, 3.5, 5.0):
        since = np.maximum(T - start, 0.0)
        miss[:, who, 1] += ((T >= start) * 5.0 * np.exp(-since / tau) * np.cos(2.0 * np.pi * hertz * since))[:, None]
    return miss


BURSTS = (30, 55, 80, 105, 130, 155)
SHARED = {
    "bump of 8 of 30": bumps(30, slice(10, 18)),
    "bump of 10 of 30": bumps(30, slice(10, 20)),
    "bump of 2 of 30": bumps(30, slice(10, 12)),
    "stick-slip of 8 of 30": bumps(30, slice(10, 18), BURSTS),
    "stick-slip of 16 of 49": bumps(49, slice(10, 26), BURSTS),
    "ring-down of 6 Hz of 8 of 30": ring_downs(30, slice(5, 13), 6.0, 0.1),
    "ring-down of 10 Hz of 8 of 30": ring_downs(30, slice(5, 13), 10.0, 0.1),
    "ring-down of 4 Hz of 8 of 30": ring_downs(30, slice(5, 13), 4.0, 0.2),
    "ring-down of 12 Hz of 16 of 49": ring_downs(49, slice(5, 21), 12.0, 0.15),
}


@pytest.mark.parametrize("name", list(SHARED))
def test_what_markers_share_stays(name: str) -> None:
    assert not line(SHARED[name]).any()


@pytest.mark.parametrize("who", [slice(8, 10), slice(6, 12), slice(12, 24)])
def test_what_neighbours_on_a_grid_share_stays(who: slice) -> None:
    assert not found(bumps(M, who)).any()


def test_what_markers_apart_from_each_other_share_stays() -> None:
    """A mode of the sheet: none of the six is next to another."""
    assert not found(bumps(M, [0, 2, 4, 13, 15, 17])).any()


def test_a_marker_that_slips_again_and_again_stays() -> None:
    """Once it is one that may as well be a mistake."""
    assert not found(bumps(M, slice(4, 5), BURSTS)).any()
    assert found(bumps(M, slice(4, 5)))[70:74, 4].sum() > 2


@pytest.mark.parametrize("m", [1, 2, 4])
def test_few_markers_lose_nothing(m: int) -> None:
    assert not line(bumps(m, slice(0, 1))).any() and not line(bumps(m, slice(0, 2))).any()
    assert line(bumps(5, slice(0, 1))).sum() == 4


def test_a_frame_with_few_markers_in_sight_loses_nothing() -> None:
    miss = bumps(M, slice(4, 5))
    miss[60:80, 5:, :] = np.nan
    miss[60:80, 0, :] = np.nan
    assert not found(miss).any()


def test_mistakes_among_shared_slips_are_found() -> None:
    """Between the slips, during which more than a third of the markers stand out."""
    slips = bumps(M, slice(6, 18), BURSTS)
    slipping = np.any(slips != 0.0, axis=(1, 2))
    wrong = np.where(slipping[:, None, None], 0.0, jumps(0.05, 5.0))
    true = np.any(wrong != 0.0, axis=2)
    mask = found(slips + wrong)
    assert np.mean(mask[true]) > 0.95
    assert not mask[~true].any()


def test_mistakes_where_a_model_misses_a_landing_are_found() -> None:
    """For three frames it misses most markers by up to 20 noise deviations, the farther the more; nothing of that is
    left out, and what is far from what its neighbours show is."""
    landing = np.zeros(PLACE.shape)
    frames = [k + j for k in (40, 90, 140) for j in range(3)]
    landing[frames] = 20.0 * SIGMA * (GRID[None, :, 0] / GRID[:, 0].max())[..., None] * [0.3, 1.0]
    wrong = np.zeros(PLACE.shape)
    for k, frame in enumerate(frames):
        wrong[frame, (3 + 7 * k) % M] = [6.0, -6.0]
    true = np.any(wrong != 0.0, axis=2)
    mask = found(landing + wrong)
    np.testing.assert_array_equal(mask, true)
    assert not found(landing).any()


def test_exchanges_of_single_frames_are_found() -> None:
    rng = np.random.default_rng(5)
    seen = PLACE + NOISE
    true = np.zeros((N, M), dtype=bool)
    for k in range(5, N, 10):
        pair = rng.permutation(M)[:2]
        seen[k, pair] = seen[k, pair[::-1]]
        true[k, pair] = True
    mask = mistakes(replace(track(), values=seen.reshape(N, -1)), PLACE.reshape(N, -1))
    np.testing.assert_array_equal(mask, true)


def lost(by: float) -> tuple[Run, Prediction]:
    """A recording with jumps, and a model that misses all of it by ``by`` noise deviations."""
    run = Run("press", "", (), {}, (track(jumps(0.05, 5.0)),), T[-1])
    return run, Prediction({"video": (PLACE + [by * SIGMA, 0.0]).reshape(N, -1)}, {}, cast(Trace, None))


@pytest.mark.parametrize("by", [0.5, 2.0, 20.0])
def test_mistakes_are_those_of_the_tracker_however_far_a_model_is_off(by: float) -> None:
    """A model that misses all of a recording by a constant has the same mistakes as one that is right."""
    run, prediction = lost(by * SOLVE.outlier_sd)
    right = replace(prediction, values={"video": PLACE.reshape(N, -1)})
    (of_lost,), (of_right,) = (without_outliers([run], [p], KNOWN)[1] for p in (prediction, right))
    assert of_lost.share == of_right.share > 0.02 and of_lost.markers == of_right.markers


def test_what_was_left_out_is_reported() -> None:
    miss = np.zeros((N, M, 2))
    miss[36, [12, 17]] = 5.0
    miss[40, 12] = 5.0
    run = Run("press", "", (), {}, (track(miss),), T[-1])
    prediction = Prediction({"video": PLACE.reshape(N, -1)}, {}, cast(Trace, None))
    (clean,), (excluded,) = without_outliers([run], [prediction], KNOWN)
    assert excluded.markers == {"12": [T[36], T[40]], "17": [T[36]]}
    assert excluded.sentence == (
        "press: 0.05 % of the marker readings of video are treated as outliers: markers 12 (2 from 1.20 s), "
        "17 (at 1.20 s)."
    )
    gone = np.isnan(clean.measured[0].values)
    assert gone.sum() == 6 and gone[36, [24, 25, 34, 35]].all()
    assert worth_another_fit([run], [clean]) and not worth_another_fit([clean], [clean])
    assert worth_another_fit([clean], [run])


def test_too_many_are_kept_and_reported() -> None:
    """Nine of the thirty in every frame."""
    rng = np.random.default_rng(7)
    miss = np.zeros((N, M, 2))
    for k in range(N):
        miss[k, rng.permutation(M)[:9], 0] = 5.0
    run = Run("press", "", (), {}, (track(miss),), T[-1])
    prediction = Prediction({"video": PLACE.reshape(N, -1)}, {}, cast(Trace, None))
    (clean,), (excluded,) = without_outliers([run], [prediction], KNOWN)
    assert excluded.share > 0.2 and excluded.kept and "too many to be exceptions" in excluded.sentence
    np.testing.assert_array_equal(clean.measured[0].values, run.measured[0].values)


def test_nothing_near_the_noise_is_a_mistake() -> None:
    """However rare: a normal scatter reaches 5 deviations."""
    miss = np.zeros((N, M, 2))
    miss[60, 9, 0] = 0.6 * SOLVE.outlier_sd * SIGMA - NOISE[60, 9, 0]
    assert not found(miss).any()
