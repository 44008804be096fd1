"""Whether poses were taken at their stamps or at the ticks of a clock, on motions that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs.pose_clock import FEWEST_TICKS
from sim_core.rigs.trajectory import PoseTrajectory, minimum_jerk
from sysid.model.load import _clock_notes

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


def test_no_tick_is_lost_count_of() -> None:
    """Jitter of 1.5 ms, a tenth of the poses lost, and a clock that is not quite that of the recording."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        kept = np.sort(rng.permutation(len(TICKS))[60:])
        taken = TICKS[0] + (TICKS[kept] - TICKS[0]) * 1.003
        own = measured(taken, taken + 1.5e-3 * rng.standard_normal(len(taken)), rng)
        np.testing.assert_allclose(own.smoothed().times[1:-1], taken[1:-1], atol=4e-4)


def test_poses_that_are_taken_at_their_stamps_keep_them() -> None:
    rng = np.random.default_rng(3)
    taken = TICKS + JITTER * rng.standard_normal(len(TICKS))
    own = measured(taken, taken, rng)
    assert own.smoothed().times is own.times


@pytest.mark.parametrize("moves", [True, False])
@pytest.mark.parametrize("off_s", [0.002, 0.02])
def test_a_clock_whose_rate_wanders_keeps_its_stamps(moves: bool, off_s: float) -> None:
    """By a part of an interval, or two of them: the motion is as smooth along either, and poses of a hand that rests do
    not tell at all."""
    stamps = TICKS + off_s * np.sin(2.0 * TICKS)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        own = measured(stamps if moves else np.zeros(len(stamps)), stamps, rng)
        assert own.smoothed().times is own.times


def test_a_clock_that_wanders_and_jitters_keeps_its_stamps() -> None:
    """Ticks of a line would make the motion smoother, and late by two milliseconds for a second and a half."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        taken = TICKS + 0.002 * np.sin(2.0 * TICKS)
        own = measured(taken, taken + JITTER * rng.standard_normal(len(taken)), rng)
        assert own.smoothed().times is own.times


def test_a_hand_that_rests_does_not_tell_of_jitter() -> None:
    for seed in range(16):
        rng = np.random.default_rng(seed)
        own = measured(np.zeros(len(TICKS)), TICKS + JITTER * rng.standard_normal(len(TICKS)), rng)
        assert own.smoothed().times is own.times


def test_that_poses_are_not_taken_at_their_stamps_is_said() -> None:
    rng = np.random.default_rng(5)
    own = measured(TICKS, TICKS + JITTER * rng.standard_normal(len(TICKS)), rng)
    (note,) = _clock_notes("current_pose", own, own.smoothed())
    assert "jitter by 0.98 ms" in note and "a clock of 100 Hz" in note
    assert _clock_notes("current_pose", own, own) == []


def test_few_poses_tell_nothing_of_a_clock() -> None:
    rng = np.random.default_rng(6)
    few = slice(200, 200 + FEWEST_TICKS - 1)
    own = measured(TICKS[few], TICKS[few] + JITTER * rng.standard_normal(FEWEST_TICKS - 1), rng)
    assert own.smoothed().times is own.times
