"""Where a hand rests, by poses that have noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs.pose_rest import FEWEST_AT_REST, SCALES, rests
from sim_core.rigs.trajectory import PoseTrajectory, minimum_jerk

STAMPS = np.arange(0.0, 6.0, 0.01)
SIGMA = 1e-5


def there_and_back(t: np.ndarray) -> np.ndarray:
    """At rest to 1.5 s, 20 mm on until 3 s, at rest to 4 s, and back until 5 s [m]."""
    way = minimum_jerk(np.clip((t - 1.5) / 1.5, 0.0, 1.0)) - minimum_jerk(np.clip(t - 4.0, 0.0, 1.0))
    return np.asarray(0.02 * way)


def noisy(seed: int) -> np.ndarray:
    return there_and_back(STAMPS) + SIGMA * np.random.default_rng(seed).standard_normal(len(STAMPS))


def test_rests_between_motions_are_found_and_motions_are_not() -> None:
    """What a motion that begins and ends without acceleration is off by from a rest is less than the noise of a mean.
    The samples at the ends of a rest that are compared with motions are left to these."""
    for seed in range(20):
        found = rests(noisy(seed), SIGMA)
        assert len(found) == 3
        still = np.zeros(len(STAMPS), dtype=bool)
        for span in found:
            still[span] = True
            assert np.ptp(there_and_back(STAMPS[span])) < 0.5 * SIGMA
        sure = (STAMPS < 1.2) | ((STAMPS > 3.25) & (STAMPS < 3.75)) | (STAMPS > 5.25)
        assert still[sure].all()


def test_few_series_of_noise_are_taken_for_motion() -> None:
    """Of each of the scales about a thousandth of the series, and of drifts as many."""
    whole = [
        rests(np.random.default_rng(seed).standard_normal(len(STAMPS)), 1.0) == [slice(0, len(STAMPS))]
        for seed in range(400)
    ]
    assert np.mean(whole) > 1.0 - 3.0 * (len(SCALES) + 1) * 1e-3


@pytest.mark.parametrize("ways", [6.0, 60.0])
def test_a_slow_drift_is_no_rest(ways: float) -> None:
    """A drift by six times the noise in all is far less than it from sample to sample."""
    drift = ways * SIGMA * STAMPS / STAMPS[-1]
    for seed in range(5):
        y = drift + SIGMA * np.random.default_rng(seed).standard_normal(len(STAMPS))
        assert rests(y, SIGMA) == []


def test_a_hand_at_rest_does_not_creep() -> None:
    """Along its curve, and along those that are drawn about it, which say where it rests no better than the mean of the
    samples does."""
    positions = np.zeros((len(STAMPS), 3))
    positions[:, 0] = noisy(0)
    turns = Rotation.identity(len(STAMPS)).as_quat()
    own = PoseTrajectory(STAMPS, positions, turns, (SIGMA, 0.0))
    within = np.arange(0.2, 1.0, 0.0013)
    rng = np.random.default_rng(5)
    places = []
    for curve in (own.curve, *(own.drawn(rng) for _ in range(60))):
        x = curve.sample(within)[0][:, 0]
        assert np.ptp(x) < 1e-3 * SIGMA
        places.append(x.mean())
    first = rests(positions[:, 0], SIGMA)[0]
    assert np.std(places[1:]) == pytest.approx(SIGMA / np.sqrt(first.stop - first.start), rel=0.3)
    moving = own.curve.sample(STAMPS)[0][:, 0] - there_and_back(STAMPS)
    assert np.sqrt(np.mean(moving**2)) < 0.4 * SIGMA


def test_too_few_samples_are_no_rest() -> None:
    assert rests(np.zeros(FEWEST_AT_REST - 1), 1.0) == []
    assert rests(np.zeros(FEWEST_AT_REST), 1.0) == [slice(0, FEWEST_AT_REST)]
