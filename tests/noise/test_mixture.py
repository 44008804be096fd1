"""A sum of white and coloured noise is distinguished from either alone, and what both do is known from short rests."""

from __future__ import annotations

import numpy as np
import pytest

from sim_core.rigs.trajectory import PoseTrajectory
from sysid.noise.estimate import estimate_noise
from sysid.noise.mixture import Mixture, _correlated, innovation_variance, mixtures_of
from sysid.noise.whitening import whiten
from sysid.observations.observations import Measured, Run

INTERVAL = 0.01


def noisy(rng: np.random.Generator, n: int, columns: int, white: float, coloured: float, rho: float) -> np.ndarray:
    """White noise plus an autoregressive one."""
    x = rng.standard_normal((n, columns))
    for k in range(1, n):
        x[k] = rho * x[k - 1] + np.sqrt(1.0 - rho**2) * x[k]
    return np.asarray(coloured * x + white * rng.standard_normal((n, columns)))


def rests(seed: int, white: float, coloured: float, rho: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Four rests of 0.9 s, which drift."""
    rng = np.random.default_rng(seed)
    t = INTERVAL * np.arange(90)
    return [(noisy(rng, 90, 3, white, coloured, rho) + rng.normal(size=3) + 3.0 * t[:, None], t) for _ in range(4)]


def only(rests: list[tuple[np.ndarray, np.ndarray]]) -> Mixture | None:
    """The parts of one quantity alone."""
    return mixtures_of([rests])[0]


def test_forces_and_torques_have_one_spectrum() -> None:
    """In one rest one of them alone may not show both parts; with another one in two rests they do more often, each
    with a size of its own. Exactly the parts of twice the columns are found where both are of one size. Where they have
    none in common, each has its own."""
    short = [[rests(seed, 0.5, 0.8, 0.95)[:1], rests(seed + 100, 5e-3, 8e-3, 0.95)[:2]] for seed in range(12)]
    alone = [only(quantity) for both in short for quantity in both]
    together = [m for both in short for m in mixtures_of(both)]
    assert sum(m is None for m in alone) > 2 * sum(m is None for m in together)
    for force, torque in zip(together[::2], together[1::2], strict=True):
        if force is not None and torque is not None:
            assert force.sigma / torque.sigma == pytest.approx(100.0, rel=0.5)
            assert force.rho == pytest.approx(torque.rho, abs=0.03)
    for seed in range(4):
        mixed, coloured = mixtures_of([rests(seed, 0.5, 0.8, 0.95), rests(seed + 50, 0.0, 1.0, 0.3)])
        assert mixed is not None and mixed.rho > 0.9 and coloured is None
    one, other = rests(3, 0.5, 0.8, 0.95), rests(4, 0.5, 0.8, 0.95)
    whole = only([(np.hstack([a, b]), t) for (a, t), (b, _) in zip(one, other, strict=True)])
    apart = [m for m in mixtures_of([one, other]) if m is not None]
    assert whole is not None and len(apart) == 2
    assert np.mean([m.sigma for m in apart]) == pytest.approx(whole.sigma, rel=0.05)
    assert np.mean([m.rho for m in apart]) == pytest.approx(whole.rho, abs=0.01)
    assert np.mean([m.white for m in apart]) == pytest.approx(whole.white, abs=0.05)


def test_both_parts_are_found_in_short_rests() -> None:
    found = [only(rests(seed, 0.5, 0.8, 0.95)) for seed in range(8)]
    kept = [m for m in found if m is not None]
    assert len(kept) == len(found)
    assert np.median([m.white for m in kept]) == pytest.approx(0.25 / 0.89, abs=0.05)
    assert np.median([m.rho for m in kept]) == pytest.approx(0.95, abs=0.02)
    assert np.median([m.sigma for m in kept]) == pytest.approx(np.sqrt(0.89), rel=0.1)


@pytest.mark.parametrize(("white", "coloured", "rho"), [(0.3, 0.95, 0.925), (0.5, 0.8, 0.95), (0.7, 0.7, 0.9)])
def test_what_later_samples_are_off_a_prediction_is_as_large_as_short_rests_say(
    white: float, coloured: float, rho: float
) -> None:
    """Residuals of a right model are as large as the noise. The share of slow noise is known badly from four rests; a
    correlation that goes by it alone makes residuals 4 to 14 % too large, on average and in squares."""
    found = [only(rests(seed, white, coloured, rho)) for seed in range(40, 60)]
    true = float(innovation_variance(np.array(white**2), np.array(coloured**2), np.array(rho)))
    ratios = []
    for m in found:
        if m is not None:
            own, rest = m.sigma**2 * m.white, m.sigma**2 * (1.0 - m.white)
            ratios.append(true / float(innovation_variance(np.array(own), np.array(rest), np.array(m.rho))))
    assert len(ratios) > 15
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.03)


def test_the_innovation_variance_is_that_of_a_filter_in_its_steady_state() -> None:
    """The variance of its prediction after 400 samples."""
    for white, coloured, rho in ((0.09, 0.91, 0.925), (0.5, 0.5, 0.3), (0.0, 1.0, 0.8), (1.0, 0.0, 0.9)):
        unknown = coloured
        for _ in range(400):
            left = unknown * white / (unknown + white)
            unknown = rho**2 * left + (1.0 - rho**2) * coloured
        found = innovation_variance(np.array(white), np.array(coloured), np.array(rho))
        assert float(found) == pytest.approx(unknown + white, rel=1e-9)


@pytest.mark.parametrize(("white", "coloured", "rho"), [(1.0, 0.0, 0.9), (0.0, 1.0, 0.6), (0.0, 1.0, 0.95)])
def test_one_part_is_not_made_two(white: float, coloured: float, rho: float) -> None:
    assert [only(rests(seed, white, coloured, rho)) for seed in range(8)] == [None] * 8


def test_the_filter_weighs_values_by_the_covariance_of_both_parts() -> None:
    rng = np.random.default_rng(1)
    at, values = np.cumsum(rng.integers(1, 4, 30)).astype(float), rng.normal(size=(30, 4))
    rho, white = np.array([0.0, 0.6, 0.98]), np.array([0.0, 0.3, 0.9])
    for gram, log_determinant, r, w in zip(*_correlated(values, at, rho, white), rho, white, strict=True):
        covariance = w * np.eye(30) + (1.0 - w) * r ** np.abs(at[:, None] - at)
        np.testing.assert_allclose(gram, values.T @ np.linalg.solve(covariance, values), rtol=1e-10, atol=1e-10)
        assert log_determinant == pytest.approx(np.linalg.slogdet(covariance)[1], abs=1e-10)


def test_blocks_of_such_noise_are_no_misfit() -> None:
    """Sums over blocks of 0.25 s, as a diagnosis looks at them. Noise of one colour that has the correlation of
    neighbouring samples, 0.68, makes them several times as large as they should be."""
    rng = np.random.default_rng(0)
    n = 600
    t = INTERVAL * np.arange(n)
    still = PoseTrajectory.from_samples(t[:1], np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
    runs = []
    for k in range(5):
        values = np.full((n, 6), np.nan)
        values[:, :3] = noisy(rng, n, 3, 0.5, 0.8, 0.95)
        runs.append(Run(f"rec_{k}", "", (), {"hand": still}, (Measured("wrist", "wrench", t, values, ()),), 6.0))
    noise = estimate_noise(runs, "wrist")
    assert noise.correlation[0] == pytest.approx(0.95 * 0.64 / 0.89, abs=0.1)
    white = np.concatenate([whiten(r.measured[0].values, noise, t)[:, :3] for r in runs])
    scores = white.reshape(-1, 25, 3).sum(axis=1) / 5.0
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.1)
    assert np.mean(scores**2) == pytest.approx(1.0, abs=0.25)
