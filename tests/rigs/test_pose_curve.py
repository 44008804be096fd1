"""Curves between poses: their acceleration is that of the motion, noise is smoothed away, and steps do not ring."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs.trajectory import PoseTrajectory

STAMPS = np.arange(0.0, 4.0, 0.01)
WITHIN = np.arange(0.5, 3.5, 0.0011)


def shaken(t: np.ndarray) -> tuple[np.ndarray, Rotation]:
    """A shake of 10 mm and 0.2 rad at 3 Hz about axes that are not those of the frame, amid a turn of a radian."""
    phase = 2.0 * np.pi * 3.0 * t
    position = 0.01 * np.sin(phase)[:, None] * [0.6, 0.0, 0.8] + np.array([0.3, 0.1, 0.2])
    turn = Rotation.from_rotvec((0.2 * np.sin(phase + 0.4) + 0.25 * t)[:, None] * [0.0, 0.6, 0.8])
    return position, turn * Rotation.from_euler("xyz", [0.4, 2.0, -1.0])


def recorded(t: np.ndarray, noise: tuple[float, float] = (0.0, 0.0), seed: int = 0) -> PoseTrajectory:
    rng = np.random.default_rng(seed)
    position, rotation = shaken(t)
    rotation = Rotation.from_rotvec(noise[1] * rng.normal(size=(len(t), 3))) * rotation
    return PoseTrajectory.from_samples(t, position + noise[0] * rng.normal(size=(len(t), 3)), rotation.as_quat())


def acceleration(path: PoseTrajectory, t: np.ndarray, step: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    """Second differences of positions and of turns."""
    (p0, q0), (p1, q1), (p2, q2) = (path.sample(t + k * step) for k in (-1, 0, 1))
    before, now, after = (Rotation.from_quat(q) for q in (q0, q1, q2))
    turned = (after * now.inv()).as_rotvec() - (now * before.inv()).as_rotvec()
    return (p2 - 2.0 * p1 + p0) / step**2, turned / step**2


def test_the_acceleration_between_samples_is_that_of_the_motion() -> None:
    linear, angular = acceleration(recorded(STAMPS), WITHIN)
    fine = np.arange(0.0, 4.0, 0.0005)
    true_linear, true_angular = acceleration(recorded(fine), WITHIN)
    assert np.abs(linear - true_linear).max() < 0.01 * np.abs(true_linear).max()
    assert np.abs(angular - true_angular).max() < 0.01 * np.abs(true_angular).max()


def test_velocity_and_acceleration_are_continuous_at_samples() -> None:
    path, at = recorded(STAMPS), STAMPS[50:350]
    for k in range(2):
        before = acceleration(path, at - 2e-4)[k]
        after = acceleration(path, at + 2e-4)[k]
        assert np.abs(after - before).max() < 0.02 * np.abs(before).max()


def test_the_noise_is_found_and_smoothed_away() -> None:
    noisy = recorded(STAMPS, noise=(2e-5, 1e-4)).smoothed()
    assert noisy.noise == pytest.approx((2e-5, 1e-4), rel=0.2)
    position, quaternion = noisy.sample(WITHIN)
    true_position, rotation = shaken(WITHIN)
    assert np.sqrt(np.mean((position - true_position) ** 2)) < 0.7 * 2e-5
    turned = (Rotation.from_quat(quaternion) * rotation.inv()).as_rotvec()
    assert np.sqrt(np.mean(turned**2)) < 0.7 * 1e-4
    true = acceleration(recorded(np.arange(0.0, 4.0, 0.0005)), WITHIN)[0]
    rough = acceleration(recorded(STAMPS, noise=(2e-5, 1e-4)), WITHIN)[0]
    assert np.std(acceleration(noisy, WITHIN)[0] - true) < 0.4 * np.std(rough - true)


def test_poses_without_noise_have_none() -> None:
    exact = recorded(STAMPS).smoothed()
    assert exact.noise[0] < 1e-8
    np.testing.assert_allclose(exact.sample(WITHIN)[0], shaken(WITHIN)[0], atol=1e-6)


def still(x: np.ndarray, t: np.ndarray) -> PoseTrajectory:
    return PoseTrajectory.from_samples(
        t, np.column_stack([x, 0.0 * x, 0.0 * x]), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    )


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_a_step_of_a_command_does_not_ring(noise: float) -> None:
    x = np.where(STAMPS < 2.0, 0.0, 0.05) + noise * np.random.default_rng(0).normal(size=len(STAMPS))
    path = still(x, STAMPS).smoothed()
    out = path.sample(np.arange(0.0, 3.99, 0.0007))[0][:, 0]
    assert out.min() > -5.0 * noise - 1e-12
    assert out.max() < 0.05 + 5.0 * noise + 1e-12
    assert np.any(np.abs(path.curve.inner_corners - 2.0) < 0.011)


def test_a_staircase_of_commands_does_not_ring() -> None:
    x = 0.001 * np.floor(STAMPS / 0.1 + 1e-9)
    out = still(x, STAMPS).sample(np.arange(0.0, 3.99, 0.0007))[0][:, 0]
    assert np.diff(out).min() > -1e-4


def test_a_start_at_full_speed_stays_sharp() -> None:
    x = 0.1 * np.maximum(STAMPS - 2.0, 0.0)
    fine = np.arange(0.0, 3.99, 0.0007)
    np.testing.assert_allclose(still(x, STAMPS).sample(fine)[0][:, 0], 0.1 * np.maximum(fine - 2.0, 0.0), atol=1e-9)


def test_a_gap_is_bridged_by_a_straight_line() -> None:
    t = np.concatenate([STAMPS[:100], STAMPS[160:]])
    path = recorded(t)
    share = (1.3 - t[99]) / (t[100] - t[99])
    expected = path.positions[99] + share * (path.positions[100] - path.positions[99])
    np.testing.assert_allclose(path.at(1.3)[0], expected, atol=1e-12)
