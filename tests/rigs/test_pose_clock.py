"""Whether poses were taken at their stamps or at the ticks of a clock, on motions that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs.pose_clock import taken_at
from sim_core.rigs.trajectory import PoseTrajectory, minimum_jerk

TICKS = 0.4 + 0.01 * np.arange(600)
POSITION_SIGMA, TURN_SIGMA, JITTER = 1e-6, 5e-5, 1e-3


def turned(t: np.ndarray) -> np.ndarray:
    """By 180 degrees about y from 1.5 s to 4.5 s [rad]."""
    return np.asarray(np.pi * minimum_jerk(np.clip((t - 1.5) / 3.0, 0.0, 1.0)))


def measured(taken: np.ndarray, stamps: np.ndarray, rng: np.random.Generator) -> PoseTrajectory:
    """Poses of a hand that turns and moves along x, with noise."""
    n = len(taken)
    positions = np.column_stack([0.05 * turned(taken), np.zeros(n), np.zeros(n)])
    positions = positions + POSITION_SIGMA * rng.standard_normal((n, 3))
    turns = Rotation.from_rotvec(turned(taken)[:, None] * [0.0, 1.0, 0.0])
    turns = turns * Rotation.from_rotvec(TURN_SIGMA * rng.standard_normal((n, 3)))
    return PoseTrajectory.from_samples(stamps, positions, turns.as_quat())


@pytest.mark.parametrize("lost", [0, 60])
def test_jitter_of_stamps_is_no_motion(lost: int) -> None:
    """Along the curve through poses at their jittering stamps the hand shakes by several times the noise of its
    encoders, and it does not at the ticks, some of which have no pose."""
    rng = np.random.default_rng(lost)
    kept = np.sort(rng.permutation(len(TICKS))[lost:])
    taken = TICKS[kept]
    own = measured(taken, taken + JITTER * rng.standard_normal(len(taken)), rng)
    found = own.smoothed()
    np.testing.assert_allclose(found.times[1:-1], taken[1:-1], atol=6.0 * JITTER / np.sqrt(len(taken)))
    assert found.times[0] <= own.times[0] and found.times[-1] >= own.times[-1]
    assert found.noise[1] == pytest.approx(TURN_SIGMA, rel=0.15)
    within = np.arange(2.0, 4.0, 0.0037)

    def shaken(by: PoseTrajectory) -> float:
        quaternions = by.sample(within)[1]
        angle = np.unwrap(2.0 * np.arctan2(quaternions[:, 1], quaternions[:, 3]))
        error = angle - turned(within)
        return float(np.std(error - np.polyval(np.polyfit(within, error, 3), within)))

    assert shaken(found) < 0.6 * TURN_SIGMA
    noise = (found.noise[0], found.noise[1])
    assert shaken(PoseTrajectory(own.times, own.positions, own.quaternions, noise)) > 4.0 * TURN_SIGMA


def test_poses_that_are_taken_at_their_stamps_keep_them() -> None:
    rng = np.random.default_rng(3)
    taken = TICKS + JITTER * rng.standard_normal(len(TICKS))
    own = measured(taken, taken, rng)
    assert own.smoothed().times is own.times


def test_a_clock_that_steps_keeps_its_stamps() -> None:
    """The line through all stamps is half a step off on both sides of it."""
    rng = np.random.default_rng(4)
    stamps = TICKS + 0.02 * (TICKS > 3.0)
    own = measured(stamps, stamps, rng)
    assert own.smoothed().times is own.times


def test_few_poses_tell_nothing_of_a_clock() -> None:
    few = np.cumsum(np.full(19, 0.01))
    assert taken_at(few, np.zeros((19, 3)), np.zeros((19, 4))) is few
