"""Mistakes of trackers are found and left out; what moves, drifts, steps or is missing from the model is not."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np
import pytest

from sim_core.simulate import Trace
from sysid.fit.engine import Prediction
from sysid.fit.noise import ChannelNoise
from sysid.fit.outliers import FAR, mistakes, without_outliers, worth_another_fit
from sysid.fit.runs import Measured, Run

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


def test_what_was_left_out_is_told() -> None:
    miss = np.zeros((N, M, 2))
    miss[36, [12, 17]] = 5.0
    miss[40, 12] = 5.0
    run = Run("press", "", (), {}, (track(miss),), T[-1])
    prediction = Prediction({"video": PLACE.reshape(N, -1)}, {}, cast(Trace, None))
    (clean,), (told,) = without_outliers([run], [prediction], KNOWN)
    assert told.markers == {"12": [T[36], T[40]], "17": [T[36]]}
    assert told.sentence == (
        "press: 0.05 % of the marker readings of video are treated as outliers: markers 12 (2 from 1.20 s), "
        "17 (at 1.20 s)."
    )
    gone = np.isnan(clean.measured[0].values)
    assert gone.sum() == 6 and gone[36, [24, 25, 34, 35]].all()
    assert worth_another_fit([run], [clean]) and not worth_another_fit([clean], [clean])
    assert worth_another_fit([clean], [run])


def test_too_many_are_kept_and_told() -> None:
    """Nine of the thirty in every frame."""
    rng = np.random.default_rng(7)
    miss = np.zeros((N, M, 2))
    for k in range(N):
        miss[k, rng.permutation(M)[:9], 0] = 5.0
    run = Run("press", "", (), {}, (track(miss),), T[-1])
    prediction = Prediction({"video": PLACE.reshape(N, -1)}, {}, cast(Trace, None))
    (clean,), (told,) = without_outliers([run], [prediction], KNOWN)
    assert told.share > 0.2 and told.kept and "too many to be exceptions" in told.sentence
    np.testing.assert_array_equal(clean.measured[0].values, run.measured[0].values)


def test_nothing_near_the_noise_is_a_mistake() -> None:
    """However rare: a normal scatter reaches 5 deviations."""
    miss = np.zeros((N, M, 2))
    miss[60, 9, 0] = 0.6 * FAR * SIGMA - NOISE[60, 9, 0]
    assert not found(miss).any()
