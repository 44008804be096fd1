"""The noise of a recording, from where the hand stands still."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import FROM_DIFFERENCES, by_differences, estimate_noise
from sysid.noise.stillness import moves, moving, quiet, standing_still
from sysid.noise.whitening import whiten
from sysid.observations.observations import Measured, Run

RATE = 100.0


def trajectory(rng: np.random.Generator, jitter: float) -> PoseTrajectory:
    """Rest for 1 s, 20 mm in 1 s, rest for 1 s."""
    t = np.arange(301) / RATE
    x = 0.02 * np.clip(t - 1.0, 0.0, 1.0)
    position = np.column_stack([x, 0 * x, 0 * x]) + jitter * rng.standard_normal((len(t), 3))
    return PoseTrajectory(t, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))


def coloured(rng: np.random.Generator, n: int, rho: float, sigma: float) -> np.ndarray:
    x = np.empty((n, 6))
    x[0] = rng.standard_normal(6)
    for k in range(1, n):
        x[k] = rho * x[k - 1] + np.sqrt(1.0 - rho**2) * rng.standard_normal(6)
    return sigma * x


def run_with(poses: PoseTrajectory, values: np.ndarray) -> Run:
    t = np.arange(len(values)) / RATE
    gauge = Measured("gauge", "wrench", t, values, tuple("abcdef"))
    return Run("run", "", (), {"hand": poses}, (gauge,), float(t[-1]))


@pytest.mark.parametrize("jitter", [0.0, 1e-6, 1e-5, 5e-5])
def test_rest_is_found_whatever_the_noise_of_the_pose(jitter: float) -> None:
    poses = trajectory(np.random.default_rng(1), jitter)
    run = run_with(poses, np.zeros((301, 6)))
    stretches = quiet(run, np.arange(301) / RATE)
    assert len(stretches) == 2
    assert stretches[0][0] == 0 and 80 <= stretches[0][-1] <= 100
    assert 210 <= stretches[1][0] <= 235 and stretches[1][-1] == 300
    spans = moving(poses)
    assert min(s for s, _ in spans) == pytest.approx(1.0, abs=0.15)
    assert max(e for _, e in spans) == pytest.approx(2.0, abs=0.15)


def slow_press(speed: float, jitter: float, rng: np.random.Generator) -> Run:
    """Rest for 1 s, 4 s at ``speed`` [m/s] on a pad of 2 N/mm that stiffens, rest for 1 s; noise of 10 mN."""
    t = np.arange(601) / RATE
    x = speed * np.clip(t - 1.0, 0.0, 4.0)
    position = np.column_stack([x, 0 * x, 0 * x]) + jitter * rng.standard_normal((len(t), 3))
    poses = PoseTrajectory(t, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    force = 2e3 * x * (1.0 + x / 1e-4)
    return run_with(poses, force[:, None] + 0.01 * rng.standard_normal((len(t), 6)))


@pytest.mark.parametrize("jitter", [0.0, 5e-6])
@pytest.mark.parametrize("speed", [0.02e-3, 0.05e-3, 0.09e-3])
def test_a_slow_press_is_no_rest(speed: float, jitter: float) -> None:
    run = slow_press(speed, jitter, np.random.default_rng(8))
    t = run.measured[0].t
    stretches = quiet(run, t)
    assert all(t[s[-1]] < 1.6 or t[s[0]] > 4.4 for s in stretches)
    if jitter == 0.0:
        first, last = stretches
        assert first[0] == 0 and t[first[-1]] > 0.5 and t[last[0]] < 5.5 and last[-1] == 600
    noise = estimate_noise([run], "gauge")
    assert noise.sigma == pytest.approx(0.01, rel=0.15)
    assert np.all(noise.correlation < 0.3)


@pytest.mark.parametrize("turning", [False, True], ids=["shift", "turn"])
def test_a_recording_that_creeps_throughout_has_no_rest(turning: bool) -> None:
    """By 5 um/s, or 50 urad/s, for 6 s: three times what is still."""
    t = np.arange(601) / RATE
    angle = 5e-5 * t if turning else 0.0 * t
    position = np.column_stack([0.0 * t if turning else 5e-6 * t, 0 * t, 0 * t])
    poses = PoseTrajectory(t, position, np.column_stack([0 * t, 0 * t, np.sin(angle / 2), np.cos(angle / 2)]))
    assert quiet(run_with(poses, np.zeros((601, 6))), t) == []


def test_a_servo_that_hunts_about_its_place_rests() -> None:
    """By 8 um, twice a second, a single pose every 20 ms."""
    t = np.arange(301) / RATE
    at = t[::2]
    x = 4e-6 * np.sin(4.0 * np.pi * at)
    poses = PoseTrajectory(at, np.column_stack([x, 0 * at, 0 * at]), np.tile([0.0, 0.0, 0.0, 1.0], (len(at), 1)))
    (stretch,) = quiet(run_with(poses, np.zeros((301, 6))), t)
    assert len(stretch) == 301


@pytest.mark.parametrize("jitter", [0.0, 1e-5])
def test_level_and_colour_come_from_the_rest(jitter: float) -> None:
    rng = np.random.default_rng(2)
    found = []
    for _ in range(8):
        run = run_with(trajectory(rng, jitter), coloured(rng, 301, 0.7, 0.05))
        found.append(estimate_noise([run], "gauge"))
    assert np.mean([f.sigma[0] for f in found]) == pytest.approx(0.05, rel=0.12)
    assert np.mean([f.rho[0] for f in found]) == pytest.approx(0.7, abs=0.08)
    assert found[0].source == "rest at the start"


@pytest.mark.parametrize("lost", [0.01, 0.2])
def test_lost_readings_do_not_hide_a_rest(lost: float) -> None:
    """No column is whole over a rest of 9 s."""
    rng = np.random.default_rng(6)
    n = 900
    values = coloured(rng, n, 0.8, 0.1)
    values[rng.random(values.shape) < lost] = np.nan
    assert not np.isfinite(values).all(axis=0).any()
    t = np.arange(n) / RATE
    still = PoseTrajectory(t, np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)))
    found = estimate_noise([run_with(still, values)], "gauge")
    assert found.source == "rest at the start"
    np.testing.assert_allclose(found.sigma, 0.1, rtol=0.1)
    np.testing.assert_allclose(found.rho, 0.8, atol=0.04)


@pytest.mark.parametrize("missing", ["messages", "readings"])
@pytest.mark.parametrize("n", [100, 900])
def test_lost_messages_do_not_make_noise_whiter(n: int, missing: str) -> None:
    """Of a rest, three readings and then two that are lost, over and over: two of three neighbours are next to each
    other, the others three intervals apart."""
    rng = np.random.default_rng(7)
    there = np.arange(n) % 5 < 3
    t = np.arange(n) / RATE
    still = PoseTrajectory(t, np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1)))
    found = []
    for _ in range(10000 // n):
        values = coloured(rng, n, 0.8, 0.1)
        if missing == "messages":
            gauge = Measured("gauge", "wrench", t[there], values[there], tuple("abcdef"))
        else:
            gauge = Measured("gauge", "wrench", t, np.where(there[:, None], values, np.nan), tuple("abcdef"))
        found.append(estimate_noise([Run("run", "", (), {"hand": still}, (gauge,), float(t[-1]))], "gauge"))
    assert {f.source for f in found} == {"rest at the start"}
    np.testing.assert_allclose(np.mean([f.sigma for f in found]), 0.1, rtol=0.03)
    np.testing.assert_allclose(np.mean([f.rho for f in found]), 0.8, atol=0.02)


def test_a_rest_with_a_pause_drifts_in_time() -> None:
    """Twenty readings, 4 s of nothing, and twenty more, of a sensor that drifts by 0.1 N/s and has coloured noise:
    the line that is taken out is one in time."""
    rng = np.random.default_rng(9)
    there = np.r_[0:20, 420:440]
    t = there / RATE
    still = PoseTrajectory(t, np.zeros((len(t), 3)), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    found = []
    for _ in range(100):
        values = coloured(rng, 440, 0.9, 0.05)[there] + 0.1 * t[:, None]
        gauge = Measured("gauge", "wrench", t, values, tuple("abcdef"))
        found.append(estimate_noise([Run("run", "", (), {"hand": still}, (gauge,), float(t[-1]))], "gauge"))
    assert {f.source for f in found} == {"rest at the start"}
    assert np.mean([f.sigma for f in found]) == pytest.approx(0.05, rel=0.15)


def test_what_is_done_while_messages_are_lost_is_no_noise() -> None:
    """Of a press at 1 N/s in steps of 1 ms, six messages in a row and then 0.1 s of nothing, over and over: of the
    third differences half are across a pause."""
    rng = np.random.default_rng(8)
    t = np.flatnonzero(np.arange(20000) % 106 < 6) / 1000.0
    force = t[:, None] + 0.01 * rng.standard_normal((len(t), 6))
    (found,) = by_differences(force, t)
    assert found == pytest.approx(0.01, rel=0.05)
    (scattered,) = by_differences(force[::3], t[::3])
    assert scattered > 0.01, "where nothing is next to three others, all that there is counts"
    assert by_differences(force[:3], t[:3]) == []


@pytest.mark.parametrize("coloured_group", [0, 1], ids=["forces", "torques"])
def test_forces_and_torques_have_colours_of_their_own(coloured_group: int) -> None:
    rng = np.random.default_rng(5)
    there, other = (
        slice(3 * coloured_group, 3 * coloured_group + 3),
        slice(3 - 3 * coloured_group, 6 - 3 * coloured_group),
    )
    found = []
    for _ in range(8):
        values = rng.standard_normal((301, 6))
        values[:, there] = coloured(rng, 301, 0.9, 1.0)[:, there]
        found.append(estimate_noise([run_with(trajectory(rng, 0.0), values)], "gauge").rho)
    assert np.mean(found, axis=0)[there] == pytest.approx(0.9, abs=0.05)
    np.testing.assert_allclose(np.mean(found, axis=0)[other], 0.0, atol=0.05)


def test_a_long_rest_counts_more_than_a_short_one() -> None:
    """Rests of 15 and of 1000 samples at the start of two recordings, the short one with noise of another colour."""
    rng = np.random.default_rng(6)
    runs = []
    for n, rho, sigma in ((15, 0.0, 0.2), (1000, 0.7, 0.05)):
        t = np.arange(n + 100) / RATE
        x = 0.02 * np.clip(t - n / RATE, 0.0, None)
        poses = PoseTrajectory(t, np.column_stack([x, 0 * t, 0 * t]), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
        runs.append(run_with(poses, coloured(rng, len(t), rho, sigma)))
    noise = estimate_noise(runs, "gauge")
    assert noise.rho[0] == pytest.approx(0.7, abs=0.05)
    assert noise.sigma[0] == pytest.approx(0.05, rel=0.1), "four times the noise of the other is no rest"


def test_each_column_is_whitened_by_its_own_colour() -> None:
    rng = np.random.default_rng(7)
    rho = np.array([0.0, 0.5, 0.95, 0.0, 0.9, 0.2])
    values = np.column_stack([coloured(rng, 4000, r, 0.05)[:, 0] for r in rho])
    white = whiten(values, ChannelNoise(np.full(6, 0.05), rho, "test"), np.arange(4000) / RATE)
    assert np.std(white, axis=0) == pytest.approx(1.0, abs=0.05)
    np.testing.assert_allclose([np.corrcoef(w[1:], w[:-1])[0, 1] for w in white.T], 0.0, atol=0.06)


@pytest.mark.parametrize("still", [True, False], ids=["at rest", "moving"])
def test_white_noise_has_its_level(still: bool) -> None:
    """Of a channel at rest, and of one that goes to and fro with 40 times the noise, twice a second.

    With w = 2 sin(pi f / rate) = 0.25 the n-th differences of a sine of amplitude 40 sigma have amplitude 40 w^n sigma,
    those of the noise a deviation of sqrt(C(2n, n)) sigma: 0.625 against 4.47 for n = 3 (together 0.5 % more than the
    noise alone), 2.5 against 2.45 for n = 2 (23 % more).
    """
    rng = np.random.default_rng(4)
    t = np.arange(301) / RATE
    f = RATE / np.pi * np.arcsin(0.125)
    x = 40.0 * 0.05 * np.sin(2.0 * np.pi * f * t)
    poses = PoseTrajectory(t, np.column_stack([1e-3 * x, 0 * t, 0 * t]), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    found = []
    for _ in range(40):
        noise = 0.05 * rng.standard_normal((len(t), 6))
        run = run_with(trajectory(rng, 0.0), noise) if still else run_with(poses, x[:, None] + noise)
        found.append(estimate_noise([run], "gauge"))
    assert {n.source for n in found} == {"rest at the start" if still else FROM_DIFFERENCES}
    assert np.mean([n.sigma[0] for n in found]) == pytest.approx(0.05, rel=0.03)


def test_readings_in_steps_have_the_noise_of_their_rounding() -> None:
    rng = np.random.default_rng(3)
    force = np.round(np.cumsum(0.02 * rng.standard_normal((301, 6)), axis=0), 1)
    noise = estimate_noise([run_with(trajectory(rng, 0.0), force)], "gauge")
    assert np.all(noise.sigma >= 0.1 / np.sqrt(12.0) - 1e-9)


@pytest.mark.parametrize("noise_m", [0.0, 1e-4])
def test_rests_of_an_end_effector(noise_m: float) -> None:
    """Still for 1 s, on its way for 1 s, still for 0.2 s, on its way for 1 s, still for 2 s."""
    t = np.arange(0.0, 5.2, 0.01)
    x = 0.02 * (np.clip(t - 1.0, 0.0, 1.0) + np.clip(t - 2.2, 0.0, 1.0))
    x = x + noise_m * np.random.default_rng(1).standard_normal(len(t))
    poses = PoseTrajectory(t, np.column_stack([x, 0.0 * t, 0.0 * t]), np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    blur = 0.015 if noise_m == 0.0 else 0.25
    first, last = standing_still(poses, 0.3)
    np.testing.assert_allclose([*first, *last], [0.0, 1.0, 3.2, 5.19], atol=blur)
    lone = PoseTrajectory(t[:1], poses.positions[:1], poses.quaternions[:1])
    assert standing_still(lone, 0.3) == []


@pytest.mark.parametrize("rate_hz", [2.0, 10.0, 500.0])
@pytest.mark.parametrize("speed_m_s", [5e-5, 2e-6])
@pytest.mark.parametrize("noise_m", [0.0, 5e-6])
def test_a_hand_that_moves_slowly_does_not_stand_still(rate_hz: float, speed_m_s: float, noise_m: float) -> None:
    """5 mm in 100 s, and 25 times slower, after 10 s of rest, with and without noise of the poses."""
    t = np.arange(0.0, 110.0, 1.0 / rate_hz)
    x = speed_m_s * np.maximum(t - 10.0, 0.0)
    positions = np.column_stack([x, 0 * x, 0 * x])
    positions += noise_m * np.random.default_rng(0).standard_normal(positions.shape)
    poses = PoseTrajectory(t, positions, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    assert moves(poses)
    still = standing_still(poses, 0.3)
    assert not any(end > 30.0 for _, end in still), still
    rest = PoseTrajectory(t, positions - np.column_stack([x, 0 * x, 0 * x]), poses.quaternions)
    assert not moves(rest)
    (span,) = standing_still(rest, 0.3)
    assert span == pytest.approx((0.0, t[-1]), abs=1e-9)


def test_mistakes_of_a_tracker_are_no_noise() -> None:
    """Two readings in a hundred that are far off leave the noise what it is."""
    rng = np.random.default_rng(11)
    values = 0.1 * rng.standard_normal((301, 6))
    clean = estimate_noise([run_with(trajectory(rng, 0.0), values.copy())], "gauge")
    values[rng.random(values.shape) < 0.02] += 6.0
    spoilt = estimate_noise([run_with(trajectory(rng, 0.0), values)], "gauge")
    assert spoilt.sigma[0] == pytest.approx(clean.sigma[0], rel=0.1)


def test_a_recording_that_still_swings_does_not_make_the_others_loud() -> None:
    rng = np.random.default_rng(12)
    runs = [run_with(trajectory(rng, 0.0), 0.1 * rng.standard_normal((301, 6))) for _ in range(3)]
    swing = 1.0 * np.sin(40.0 * np.arange(301) / RATE)[:, None]
    runs[2] = run_with(trajectory(rng, 0.0), runs[2].measured[0].values + swing)
    assert estimate_noise(runs, "gauge").sigma[0] == pytest.approx(0.1, rel=0.15)


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_what_falls_while_no_hand_moves_is_no_noise(rho: float) -> None:
    rng, declared = np.random.default_rng(8), np.full(6, 1e-3)
    t = np.arange(60) / RATE
    noise = coloured(rng, len(t), rho, 1e-3)
    falling = run_with(trajectory(rng, 0.0), noise - 0.5 * 9.81 * t[:, None] ** 2)
    found = estimate_noise([falling], "gauge", declared)
    assert found.source == FROM_DIFFERENCES
    assert np.all(found.sigma < 1.5e-3)
    lying = run_with(trajectory(rng, 0.0), noise)
    assert estimate_noise([lying], "gauge", declared).source == "rest at the start"


@pytest.mark.parametrize("samples", [30, 50, 101])
@pytest.mark.parametrize("seed", range(10))
def test_noise_that_a_filter_has_smoothed_is_that_of_a_rest(samples: int, seed: int) -> None:
    """A Butterworth filter of fourth order at a tenth of half the rate; the rig declares a tenth of the noise."""
    rng = np.random.default_rng(seed)
    values = lfilter(*butter(4, 0.1), rng.standard_normal((200 + samples, 6)), axis=0)[200:]
    found = estimate_noise([run_with(trajectory(rng, 0.0), values)], "gauge", np.full(6, 0.03))
    assert found.source == "rest at the start"
    assert np.median(found.sigma) > 0.3 * np.sqrt(0.1)  # a line takes away some of so few swings


def test_readings_that_are_held_rest() -> None:
    """A gauge that is read ten times as often as it measures."""
    rng = np.random.default_rng(9)
    held = np.repeat(coloured(rng, 10, 0.9, 0.01), 10, axis=0)
    found = estimate_noise([run_with(trajectory(rng, 0.0), held)], "gauge")
    assert found.source == "rest at the start"
