"""Whitening of noise that goes on between samples, evenly sampled or not."""

from __future__ import annotations

import numpy as np
import pytest

from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.sampling_interval import in_sampling_intervals
from sysid.noise.whitening import Whitening, whiten

INTERVAL = 0.004


def kept(rng: np.random.Generator, n: int, bursts: int, lost: int) -> np.ndarray:
    """Numbers of the messages of ``n`` that are left where ``lost`` in a row are lost so many times."""
    there = np.ones(n, dtype=bool)
    for k in rng.choice(np.arange(1, n // lost - 1), bursts, replace=False):
        there[k * lost : (k + 1) * lost] = False
    return np.flatnonzero(there)


def autoregressive(rng: np.random.Generator, at: np.ndarray, rho: float, columns: int = 1) -> np.ndarray:
    """Of unit variance, correlated by rho^d over d intervals; ``at`` ``(n,)`` in intervals."""
    x = rng.standard_normal((len(at), columns))
    for k in range(1, len(at)):
        a = rho ** (at[k] - at[k - 1])
        x[k] = a * x[k - 1] + np.sqrt(1.0 - a**2) * x[k]
    return x


def covariance(at: np.ndarray, rho: np.ndarray) -> np.ndarray:
    return np.asarray(rho ** np.abs(np.subtract.outer(at, at)))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
@pytest.mark.parametrize("rho", [0.5, 0.95])
@pytest.mark.parametrize("how", ["lost", "NaN", "jittered"])
def test_noise_is_white_afterwards_however_it_was_sampled(rho: float, how: str, share: float) -> None:
    """Exactly: W C W^T = 1, of noise of which half of the messages were lost, in bursts of 20."""
    rng = np.random.default_rng(1)
    n = 400
    rows = kept(rng, n, 10, 20)
    at = np.arange(float(n))
    if how == "jittered":
        at[1:] = np.cumsum(rng.uniform(0.6, 1.4, n - 1))
        at /= np.median(np.diff(at))
    if how == "lost":
        at = at[rows]
    noise = ChannelNoise(np.array([0.3]), rho, "test", white=np.array([share]))
    values = np.eye(len(at))[:, None, :]
    if how == "NaN":
        values[np.setdiff1d(np.arange(n), rows)] = np.nan
    white = whiten(values, noise, INTERVAL * at)[:, 0]
    good = np.isfinite(white).all(axis=1)
    assert good.sum() == (n if how == "jittered" else len(rows))
    whole = (1.0 - share) * covariance(at, np.array(rho)) + share * np.eye(len(at))
    found = 0.09 * white[good] @ whole @ white[good].T
    np.testing.assert_allclose(found, np.eye(len(found)), atol=1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.7, 0.95])
def test_lost_messages_are_no_misfit(rho: float) -> None:
    rng = np.random.default_rng(2)
    rows = kept(rng, 20000, 500, 20)
    values = autoregressive(rng, np.arange(20000.0), rho)[rows]
    white = whiten(values, ChannelNoise(np.ones(1), rho, "test"), INTERVAL * rows)
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.04)


def test_a_message_that_is_lost_is_a_reading_that_is_missing() -> None:
    rng = np.random.default_rng(3)
    rows = kept(rng, 300, 5, 10)
    noise = ChannelNoise(np.array([0.5, 2.0]), np.array([0.9, 0.3]), "test")
    values = rng.standard_normal((300, 2, 3))
    missing = np.full(values.shape, np.nan)
    missing[rows] = values[rows]
    t = INTERVAL * np.arange(300)
    np.testing.assert_allclose(
        whiten(values[rows], noise, t[rows]), whiten(missing, noise, t)[rows], rtol=1e-9, atol=1e-12
    )


def test_even_samples_are_whitened_by_the_sample_before() -> None:
    rng = np.random.default_rng(4)
    values, rho, sigma = rng.standard_normal((500, 3)), np.array([0.0, 0.6, 0.95]), np.array([0.1, 1.0, 7.0])
    expected = values / sigma
    expected[1:] = (values[1:] - rho * values[:-1]) / (sigma * np.sqrt(1.0 - rho**2))
    white = whiten(values, ChannelNoise(sigma, rho, "test"), INTERVAL * np.arange(500))
    np.testing.assert_allclose(white, expected, rtol=1e-10, atol=1e-10)


def test_the_transpose_and_single_columns_are_those_of_the_map() -> None:
    rng = np.random.default_rng(5)
    n, m = 60, 3
    t = INTERVAL * np.sort(rng.choice(np.arange(300.0), n, replace=False))
    good = rng.uniform(size=(n, m)) > 0.3
    sigma, rho, share = rng.uniform(0.5, 2.0, m), np.array([0.0, 0.8, 0.99]), np.array([0.0, 0.4, 0.0])
    noise = ChannelNoise(sigma, rho, "test", white=share)
    whitening = Whitening(noise, good, t, rng.uniform(0.5, 1.0, (n, m)))
    x, y = rng.standard_normal((2, n, m, 2))
    assert np.vdot(whitening(x), y) == pytest.approx(np.vdot(x, whitening.transposed(y)), rel=1e-12)
    assert np.all(whitening(x)[~good] == 0.0) and np.all(whitening.transposed(y)[~good] == 0.0)
    for j in range(m):
        np.testing.assert_allclose(whitening.of_column(j)(x[:, [j]]), whitening(x)[:, [j]], rtol=1e-12)


def test_the_determinant_is_that_of_the_covariance() -> None:
    rng = np.random.default_rng(7)
    at = kept(rng, 60, 4, 5).astype(float)
    noise = ChannelNoise(np.array([0.3]), 0.9, "test", white=np.array([0.3]))
    whitening = Whitening(noise, np.ones((len(at), 1), dtype=bool), INTERVAL * at)
    whole = 0.09 * (0.7 * covariance(at, np.array(0.9)) + 0.3 * np.eye(len(at)))
    assert whitening.log_determinant == pytest.approx(-0.5 * np.linalg.slogdet(whole)[1], rel=1e-9)


@pytest.mark.parametrize(("rho", "share"), [(0.0, 0.0), (0.6, 0.0), (0.9, 0.4), (0.5, 0.9)])
def test_what_independent_values_become_and_the_mean_of_many_samples(rho: float, share: float) -> None:
    noise = ChannelNoise(np.ones(1), rho, "test", white=np.array([share]))
    n = 3000
    values = np.random.default_rng(8).standard_normal((n, 1, 40))
    gain = float(np.mean(whiten(values, noise, INTERVAL * np.arange(n)) ** 2))
    assert noise.whitening_gain[0] == pytest.approx(gain, rel=0.02)
    whole = (1.0 - share) * covariance(np.arange(float(n)), np.array(rho)) + share * np.eye(n)
    assert noise.long_run[0] == pytest.approx(float(np.sum(whole)) / n, rel=0.02)
    assert noise.correlation[0] == pytest.approx(whole[0, 1], abs=1e-12)


def test_two_messages_stamped_at_once_are_not_far_too_unlike() -> None:
    """Even samples with the noise of 0.95 from one to the next, every other stamped together with that before it: what
    differs as it does in one interval counts for at most twice as much."""
    rng = np.random.default_rng(6)
    values = autoregressive(rng, np.arange(20000.0), 0.95)
    t = INTERVAL * np.arange(20000)
    t[1::50] = t[0::50] + 1e-9
    white = whiten(values, ChannelNoise(np.ones(1), 0.95, "test"), t)
    assert np.mean(white**2) < 1.05
    assert np.all(np.diff(in_sampling_intervals(t)) > 0.49)


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_samples_have_a_pace(n: int) -> None:
    np.testing.assert_allclose(in_sampling_intervals(5.0 + INTERVAL * np.arange(n)), np.arange(float(n)))
    noise = ChannelNoise(np.ones(2), 0.5, "test")
    assert whiten(np.ones((n, 2)), noise, INTERVAL * np.arange(n)).shape == (n, 2)


def test_whitening_makes_coloured_noise_white() -> None:
    rng = np.random.default_rng(1)
    rho, sigma = 0.7, 0.02
    noise = np.zeros((20000, 1))
    for k in range(1, len(noise)):
        noise[k] = rho * noise[k - 1] + sigma * np.sqrt(1 - rho**2) * rng.standard_normal(1)
    white = whiten(noise, ChannelNoise(np.array([sigma]), rho, "test"), np.arange(len(noise)) / 100.0)
    assert np.std(white) == pytest.approx(1.0, abs=0.02)
    assert np.mean(white[1:] * white[:-1]) == pytest.approx(0.0, abs=0.03)
