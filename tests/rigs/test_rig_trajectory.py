"""Pose trajectories: they stay in SE(3), pass through their samples, and refuse what is no motion."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.errors import RecordingError
from sim_core.rigs.trajectory import PoseTrajectory, minimum_jerk, trapezoidal, trapezoidal_timing


def wild(seed: int = 0, n: int = 20) -> PoseTrajectory:
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.01, 0.3, n))
    return PoseTrajectory.from_samples(times, rng.normal(size=(n, 3)), Rotation.random(n, rng=seed).as_quat())


def test_it_passes_through_its_samples() -> None:
    path = wild()
    positions, quaternions = path.sample(path.times)
    np.testing.assert_allclose(positions, path.positions)
    np.testing.assert_allclose(quaternions, path.quaternions, atol=1e-12)


def test_orientations_stay_unit_and_do_not_jump() -> None:
    path = wild()
    times = np.linspace(path.times[0], path.times[-1], 5000)
    _, quaternions = path.sample(times)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0, atol=1e-12)
    assert np.abs(np.diff(quaternions, axis=0)).max() < 0.1


def test_it_holds_before_and_after() -> None:
    path = wild()
    for time, index in [(-5.0, 0), (1e6, -1)]:
        position, quaternion = path.at(time)
        np.testing.assert_allclose(position, path.positions[index])
        np.testing.assert_allclose(quaternion, path.quaternions[index], atol=1e-12)


def test_the_result_does_not_depend_on_the_base_frame() -> None:
    path = wild()
    base = Rotation.from_euler("xyz", [0.3, -1.0, 2.0])
    moved = PoseTrajectory.from_samples(
        path.times,
        base.apply(path.positions) + [1, 2, 3],
        (base * Rotation.from_quat(path.quaternions)).as_quat(),
    )
    times = np.linspace(path.times[0], path.times[-1], 97)
    positions, quaternions = path.sample(times)
    moved_positions, moved_quaternions = moved.sample(times)
    np.testing.assert_allclose(moved_positions, base.apply(positions) + [1, 2, 3], atol=1e-12)
    difference = (base * Rotation.from_quat(quaternions)).inv() * Rotation.from_quat(moved_quaternions)
    assert difference.magnitude().max() < 1e-7


def test_one_pose_is_a_trajectory() -> None:
    path = PoseTrajectory.from_samples(np.array([3.0]), np.array([[1.0, 2.0, 3.0]]), np.array([[0, 0, 0, 1.0]]))
    np.testing.assert_allclose(path.at(0.0)[0], [1, 2, 3])
    assert path.duration == 0.0


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        (lambda t, p, q: (t[::-1], p, q), "does not advance in time at sample 1"),
        (lambda t, p, q: (t * 0.0, p, q), "does not advance"),
        (lambda t, p, q: (t[:0], p[:0], q[:0]), "holds no pose"),
        (lambda t, p, q: (t, p[:-1], q), r"Give shapes"),
        (lambda t, p, q: (t, p * np.nan, q), "not finite in sample 0"),
        (lambda t, p, q: (t, p, q * 0.5), "length 0.5"),
        (lambda t, p, q: (np.where(t > 1.0, t + 5.0, t), p, q), r"gap of 5\.\d+ s"),
    ],
)
def test_what_is_no_motion_is_refused(change, pattern: str) -> None:
    path = wild()
    with pytest.raises(RecordingError, match=pattern):
        PoseTrajectory.from_samples(*change(path.times, path.positions, path.quaternions), max_gap_s=1.0)


@pytest.mark.parametrize("profile", [minimum_jerk, trapezoidal(0.1), trapezoidal(0.5)])
def test_profiles_go_from_rest_to_rest(profile) -> None:
    share = np.linspace(0.0, 1.0, 10_001)
    way = profile(share)
    speed = np.gradient(way, share)
    assert way[0] == pytest.approx(0.0, abs=1e-12)
    assert way[-1] == pytest.approx(1.0, abs=1e-12)
    assert (np.diff(way) >= -1e-15).all()
    assert speed[0] == pytest.approx(0.0, abs=2e-3)
    assert speed[-1] == pytest.approx(0.0, abs=2e-3)


@pytest.mark.parametrize(("distance", "reaches"), [(0.1, True), (0.0001, False)])
def test_trapezoidal_moves_keep_to_speed_and_acceleration(distance: float, reaches: bool) -> None:
    speed, acceleration = 0.02, 0.5
    duration, ramp = trapezoidal_timing(distance, speed, acceleration)
    times = np.linspace(0.0, duration, 20_001)
    way = distance * trapezoidal(ramp)(times / duration)
    speeds = np.gradient(way, times)
    assert speeds.max() <= speed * (1 + 1e-6)
    assert (speeds.max() > 0.999 * speed) == reaches
    assert np.abs(np.gradient(speeds, times))[2:-2].max() <= acceleration * 1.001
