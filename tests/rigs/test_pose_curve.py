"""Curves between poses: their acceleration is that of the motion, noise is smoothed away, and steps do not ring."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.rigs.pose_curve import _Smoothing
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


def test_draws_about_the_curve_have_the_covariance_of_a_smoothing_spline() -> None:
    """Against (V^-1 + lambda K)^-1 from dense second differences and products of hats; through samples without noise
    the curve goes, and is no closer to the others for them than V says."""
    t = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 9))
    h = np.diff(t)
    second, moments = np.zeros((9, 7)), np.zeros((7, 7))
    for k in range(7):
        second[k : k + 3, k] = 1.0 / h[k], -1.0 / h[k] - 1.0 / h[k + 1], 1.0 / h[k + 1]
        moments[k, k] = (h[k] + h[k + 1]) / 3.0
        if k < 6:
            moments[k, k + 1] = moments[k + 1, k] = h[k + 1] / 6.0
    roughness = 0.3 * second @ np.linalg.solve(moments, second.T)
    rng = np.random.default_rng(2)
    for variance in (np.ones(9), np.array([1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0])):
        open_ = np.flatnonzero(variance)
        expected = np.zeros((9, 9))
        expected[np.ix_(open_, open_)] = np.linalg.inv((np.eye(9) + roughness)[np.ix_(open_, open_)])
        smoothing = _Smoothing(t, variance)
        samples = [smoothing.draw(0.3, rng) for _ in range(20000)]
        draws = np.array([s - smoothing.off(s, 0.3) for s in samples])
        np.testing.assert_allclose(draws.T @ draws / len(draws), expected, atol=0.03)
        values = rng.standard_normal(9)
        near = values - smoothing.off(values, 0.3)
        np.testing.assert_allclose(near[variance == 0.0], values[variance == 0.0], atol=1e-12)
        np.testing.assert_allclose((near - values)[open_], -(roughness @ near)[open_], atol=1e-9)


def test_the_true_motion_is_as_far_from_the_curve_as_draws_are() -> None:
    noisy = recorded(STAMPS, noise=(2e-5, 1e-4)).smoothed()
    position, quaternion = noisy.sample(WITHIN)
    true_position, rotation = shaken(WITHIN)
    rng = np.random.default_rng(3)
    draws = [noisy.drawn(rng).sample(WITHIN) for _ in range(20)]
    off = np.sqrt(np.mean((position - true_position) ** 2))
    assert off == pytest.approx(np.sqrt(np.mean([(p - position) ** 2 for p, _ in draws])), rel=0.3)
    turned = np.sqrt(np.mean((Rotation.from_quat(quaternion) * rotation.inv()).as_rotvec() ** 2))
    turns = [(Rotation.from_quat(q) * Rotation.from_quat(quaternion).inv()).as_rotvec() for _, q in draws]
    assert turned == pytest.approx(np.sqrt(np.mean(np.square(turns))), rel=0.3)
    # Poses without noise leave nothing open.
    exact = recorded(STAMPS)
    np.testing.assert_array_equal(exact.drawn(rng).sample(WITHIN)[0], exact.sample(WITHIN)[0])


def test_axes_along_which_a_hand_is_at_rest_are_known_better_than_that_along_which_it_moves() -> None:
    """A straight line through n samples is off by sigma (2 / n)^(1/2), and motion is not to keep it from being one."""
    rng, sigma, least = np.random.default_rng(4), 2e-5, np.sqrt(2.0 / len(STAMPS))
    axes = Rotation.from_euler("xyz", [0.3, -1.1, 0.7]).as_matrix()
    true = np.column_stack([0.01 * np.sin(2.0 * np.pi * 3.0 * STAMPS), 0.0 * STAMPS, 0.0 * STAMPS])
    level = np.tile([0.0, 0.0, 0.0, 1.0], (len(STAMPS), 1))
    off, drawn = [], []
    for _ in range(12):
        noisy = true + sigma * rng.normal(size=true.shape)
        own = PoseTrajectory(STAMPS, noisy, level, (sigma, 0.0))
        near = own.sample(STAMPS)[0]
        turned = PoseTrajectory(STAMPS, noisy @ axes.T, level, (sigma, 0.0))
        np.testing.assert_allclose(turned.sample(STAMPS)[0] @ axes, near, atol=1e-3 * sigma)
        off.append(np.sqrt(np.mean((near - true) ** 2, axis=0)) / sigma)
        drawn.append(np.sqrt(np.mean((own.drawn(rng).sample(STAMPS)[0] - near) ** 2, axis=0)) / sigma)
    for found in (np.array(off), np.array(drawn)):
        assert np.median(found[:, 1:]) < 2.0 * least
        assert found[:, 0].min() > 4.0 * least
    assert np.mean(np.square(drawn)) == pytest.approx(np.mean(np.square(off)), rel=0.3)


@pytest.mark.parametrize("known_to", [0.9, 1.0, 1.1])
def test_the_weight_has_the_least_error_although_the_noise_is_not_known_exactly(known_to: float) -> None:
    """Against the error itself at weights by quarters of a decade."""
    rng, smoothing = np.random.default_rng(6), _Smoothing(STAMPS, np.ones(len(STAMPS)))
    for true in (np.sin(6.0 * STAMPS), 0.01 * STAMPS, 0.1 * np.sin(3.0 * STAMPS)):
        y = true + 1e-3 * rng.normal(size=len(true))

        def error(weight: float, y: np.ndarray = y, true: np.ndarray = true) -> float:
            return float(np.sqrt(np.mean((y - smoothing.off(y, weight) - true) ** 2)))

        least = min(error(weight) for weight in 10.0 ** np.arange(-10.0, 6.0, 0.25))
        assert error(smoothing.weight(y, known_to * 1e-3)) < 1.5 * least


def test_an_axis_without_noise_tells_nothing_of_the_others() -> None:
    """A recording of a motion in a plane has none across it: along the others all of theirs is smoothed away."""
    rng = np.random.default_rng(3)
    noise = 2e-5 * rng.standard_normal((len(STAMPS), 3)) * [1.0, 0.0, 1.0]
    still = np.zeros((len(STAMPS), 3)) + noise
    turns = Rotation.identity(len(STAMPS)).as_quat()
    curve = PoseTrajectory.from_samples(STAMPS, still, turns).smoothed().curve
    left = curve.sample(STAMPS)[0]
    assert left[:, [0, 2]].std() < 0.15 * 2e-5
    assert not left[:, 1].any()
