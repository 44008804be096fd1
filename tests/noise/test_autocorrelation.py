"""Intervals where the noise is not what was assumed of its colour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.simulate import Trace
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction
from sysid.noise.autocorrelation import Part, Samples, autocorrelated_scores, unknown_autocorrelation
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import FROM_DIFFERENCES, estimate_noise
from sysid.observations.observations import Measured, Run
from sysid.solve.covariance import uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

N, RATE = 400, 100.0
T = np.arange(N) / RATE
TRUTH = np.array([1.0, -0.5])
PARAMETERS = [FitParameter(name, "-", False, -50.0, 50.0, 5.0, "") for name in "ab"]
SLOPES = np.stack(
    [
        np.column_stack([T, np.sin(2 * T), 1 - np.cos(3 * T), 0 * T, 0 * T, 0 * T]),
        np.column_stack([T**2, T, np.sin(4 * T), 0 * T, 0 * T, 0 * T]),
    ],
    axis=2,
)
"""Forces by two parameters; torques know nothing of them."""

MOVING = PoseTrajectory(
    T, np.column_stack([0.05 * (1 - np.cos(3 * T)), 0 * T, 0 * T]), np.tile([0.0, 0.0, 0.0, 1.0], (N, 1))
)


def coloured(rng: np.random.Generator, rho: float, n: int = N, columns: int = 6) -> np.ndarray:
    x = rng.standard_normal((n, columns))
    for k in range(1, n):
        x[k] = rho * x[k - 1] + np.sqrt(1.0 - rho**2) * x[k]
    return x


def run_of(values: np.ndarray) -> Run:
    return Run("run", "", (), {"hand": MOVING}, (Measured("gauge", "wrench", T, values, tuple("abcdef")),), T[-1])


def solved(run: Run, noise: ChannelNoise, monkeypatch: pytest.MonkeyPatch) -> Fitted:
    """The least-squares fit."""
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, parameters, scaled: rig)
    problem = Problem([run], {"gauge": noise}, cast(Any, None))

    def at(scaled: np.ndarray) -> Fitted:
        there = Prediction({"gauge": SLOPES @ scaled}, {"gauge": SLOPES}, cast(Trace, None))
        return problem.compare([there], cast(Any, None), PARAMETERS, scaled)

    first = at(np.zeros(2))
    return at(np.linalg.lstsq(first.jacobian, -first.residual, rcond=None)[0])


def filtered(order: int, rng: np.random.Generator) -> np.ndarray:
    """White noise behind a low-pass filter of an amplifier, at a tenth of the rate."""
    return np.asarray(lfilter(*butter(order, 0.2), rng.standard_normal((N + 200, 6)), axis=0)[200:])


def drifting(rng: np.random.Generator) -> np.ndarray:
    """White noise and, at two thirds of its size, what changes within 50 samples."""
    return rng.standard_normal((N, 6)) + 0.7 * coloured(rng, 0.98)


@pytest.mark.parametrize("kind", [drifting, lambda rng: filtered(2, rng), lambda rng: filtered(4, rng)])
def test_noise_of_more_than_one_colour_widens_intervals_as_it_should(
    kind: Callable[[np.random.Generator], np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 200 recordings, weighed by what neighbouring samples show: 95 % intervals hold in 90 % or more and are at most
    half too wide. By the level of what is left, taken for white, they would hold in less than 70 %."""
    rng = np.random.default_rng(6)
    off, sd, white = np.zeros((3, 200, 2))
    for k in range(200):
        run = run_of(SLOPES @ TRUTH + 0.15 * kind(rng))
        fitted = solved(run, estimate_noise([run], "gauge"), monkeypatch)
        known = uncertainty(fitted)
        off[k], sd[k] = fitted.scaled - TRUTH, known.sd
        white[k] = np.sqrt(max(1.0, known.reduced_chi2) * np.diag(inverse_of(fitted)))
    assert np.all(np.mean(np.abs(off) < 1.96 * sd, axis=0) >= 0.90)
    assert np.all(np.median(sd, axis=0) < 1.5 * np.std(off, axis=0))
    assert np.all(np.mean(np.abs(off) < 1.96 * white, axis=0) < 0.70)


def test_what_is_predicted_out_of_sight_has_no_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every second reading: the intervals are those of a recording that does not have them."""
    values = SLOPES @ TRUTH + 0.15 * coloured(np.random.default_rng(7), 0.9)
    hidden = np.arange(N)[:, None] % 2 == 0
    noise = estimate_noise([run_of(values)], "gauge")
    lacking = solved(run_of(np.where(hidden, np.nan, values)), noise, monkeypatch)
    problem = Problem([run_of(values)], {"gauge": noise}, cast(Any, None))
    seen = {"gauge": np.where(hidden, np.nan, SLOPES @ lacking.scaled)}
    there = Prediction(seen, {"gauge": SLOPES}, cast(Trace, None))
    blind = problem.compare([there], cast(Any, None), PARAMETERS, lacking.scaled)
    assert blind.samples == lacking.samples
    assert uncertainty(blind).sd == pytest.approx(uncertainty(lacking).sd, rel=1e-9)


def inverse_of(fitted: Fitted) -> np.ndarray:
    return np.asarray(np.linalg.inv(fitted.jacobian.T @ fitted.jacobian))


@pytest.mark.parametrize("rho", [0.0, 0.7, 0.9, 0.97])
def test_intervals_hold_the_truth_as_often_as_they_say(rho: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 200 recordings without a rest: 95 % intervals hold in 90 to 98 %."""
    rng = np.random.default_rng(1)
    inside = np.zeros(2)
    for _ in range(200):
        run = run_of(SLOPES @ TRUTH + 0.15 * coloured(rng, rho))
        noise = estimate_noise([run], "gauge")
        assert noise.source == FROM_DIFFERENCES
        fitted = solved(run, noise, monkeypatch)
        inside += np.abs(fitted.scaled - TRUTH) < 1.96 * uncertainty(fitted).sd
    assert np.all((inside >= 0.90 * 200) & (inside <= 0.98 * 200)), inside


def test_estimates_and_misfit_are_those_of_the_noise_assumed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is known of the colour: a missing law leaves correlated residuals as well."""
    run = run_of(SLOPES @ TRUTH + 0.15 * coloured(np.random.default_rng(2), 0.9))
    sigma = np.full(6, 0.04)
    found = solved(run, ChannelNoise(sigma, 0.0, "rest"), monkeypatch)
    expected = np.linalg.lstsq(SLOPES.reshape(-1, 2), run.measured[0].values.ravel(), rcond=None)[0]
    np.testing.assert_allclose(found.scaled, expected, rtol=1e-9)
    without = uncertainty(replace(found, compared={}))
    assert np.all(uncertainty(found).sd > 1.1 * without.sd)
    assert uncertainty(found).reduced_chi2 == without.reduced_chi2


def test_white_noise_widens_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    run = run_of(SLOPES @ TRUTH + 0.15 * coloured(np.random.default_rng(3), 0.0))
    found = solved(run, estimate_noise([run], "gauge"), monkeypatch)
    np.testing.assert_allclose(uncertainty(found).sd, uncertainty(replace(found, compared={})).sd, rtol=0.05)


def test_the_covariance_of_the_scores_is_that_of_autoregressive_noise() -> None:
    """sum_kl J_k v rho^|k - l| J_l, with samples that are missing, of twice the level and 0.8. Standard deviations
    of 40 draws are 9 % above that in the middle, since variances of long correlations are never below zero."""
    n, m = 500, 4
    apart = np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    ratios = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        there = rng.uniform(size=(n, m)) > 0.2
        jacobian = np.where(there[:, :, None], np.cumsum(rng.standard_normal((n, m, 2)), axis=0), 0.0)
        residual = np.where(there, 2.0 * coloured(rng, 0.8, n, m), 0.0)
        expected = 4.0 * np.einsum("kcp,kl,lcq->pq", jacobian, 0.8**apart, jacobian, optimize=True)
        plain = np.einsum("kcp,kcq->pq", jacobian, jacobian)
        found = plain + autocorrelated_scores([[Part(there, residual, jacobian)]], np.linalg.inv(plain))
        ratios.append(np.sqrt(np.diag(found) / np.diag(expected)))
    middle, low, high = np.quantile(ratios, [0.5, 0.1, 0.9], axis=0)
    np.testing.assert_allclose(middle, 1.0, atol=0.15)
    assert np.all(low > 0.9) and np.all(high < 1.5)


def test_lags_are_lags_in_time() -> None:
    """Rows of messages, some of which are lost, have the places that they would have among all; a pause counts for no
    more than all messages that there are."""
    rng = np.random.default_rng(9)
    n, m, p = 60, 4, 2
    lost = np.isin(np.arange(n), [3, 20, 21, 22, 40])
    t = (np.arange(n) + rng.uniform(-0.2, 0.2, n)) / RATE
    good = rng.uniform(size=(n, m)) > 0.1
    groups = (np.array([0, 1]), np.array([2, 3]))
    residual, jacobian = rng.standard_normal((n, m)), rng.standard_normal((n, m, p))
    sight = rng.uniform(size=(n, m)) > 0.1
    there = good & ~lost[:, None]
    found = Samples(good[~lost], t[~lost], groups).of_rows(residual[there], jacobian[there], sight[there])
    for part, g in zip(found, groups, strict=True):
        np.testing.assert_array_equal(part.there, (there & sight)[:, g])
        np.testing.assert_array_equal(part.residual, np.where(there, residual, 0.0)[:, g])
        np.testing.assert_array_equal(part.jacobian, np.where(there[:, :, None], jacobian, 0.0)[:, g])
    t[30:] += 1e6
    (part,) = Samples(np.ones((n, 1), dtype=bool), t, (np.array([0]),)).of_rows(np.ones(n), np.ones((n, p)))
    np.testing.assert_array_equal(np.flatnonzero(part.there), [*range(30), *range(30 + n, n + n)])


def test_what_is_lost_in_bursts_hides_no_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 150 recordings of twice as many samples, every other four of which are lost, without a rest: 95 % intervals
    hold in 90 to 98 %."""
    rng = np.random.default_rng(10)
    rows = np.flatnonzero(np.arange(2 * N) % 8 < 4)
    t = rows / (2.0 * RATE)
    slopes = np.stack([np.interp(t, T, column) for column in SLOPES.reshape(N, -1).T], axis=1).reshape(N, 6, 2)
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, parameters, scaled: rig)
    inside = np.zeros(2)
    for _ in range(150):
        values = slopes @ TRUTH + 0.15 * coloured(rng, 0.95, 2 * N)[rows]
        gauge = Measured("gauge", "wrench", t, values, tuple("abcdef"))
        run = Run("run", "", (), {"hand": MOVING}, (gauge,), t[-1])
        problem = Problem([run], {"gauge": estimate_noise([run], "gauge")}, cast(Any, None))

        def at(scaled: np.ndarray, problem: Problem = problem) -> Fitted:
            there = Prediction({"gauge": slopes @ scaled}, {"gauge": slopes}, cast(Trace, None))
            return problem.compare([there], cast(Any, None), PARAMETERS, scaled)

        first = at(np.zeros(2))
        fitted = at(np.linalg.lstsq(first.jacobian, -first.residual, rcond=None)[0])
        inside += np.abs(fitted.scaled - TRUTH) < 1.96 * uncertainty(fitted).sd
    assert np.all((inside >= 0.90 * 150) & (inside <= 0.98 * 150)), inside


def test_runs_of_a_quantity_share_a_colour_and_quantities_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Residuals of torques that nothing depends on, however coloured, widen nothing."""
    rng = np.random.default_rng(5)
    values = SLOPES @ TRUTH + 0.15 * coloured(rng, 0.0)
    values[:, 3:] = 0.15 * coloured(rng, 0.97)[:, 3:]
    run = run_of(values)
    found = solved(run, ChannelNoise(np.full(6, 0.15), 0.0, "rest"), monkeypatch)
    np.testing.assert_allclose(uncertainty(found).sd, uncertainty(replace(found, compared={})).sd, rtol=0.05)


def test_what_is_not_known_is_reported() -> None:
    noise = {
        "gauge": ChannelNoise(np.ones(6), 0.0, FROM_DIFFERENCES),
        "video": ChannelNoise(np.ones(6), 0.0, "rest at the start"),
    }
    (sentence,) = unknown_autocorrelation(noise)
    assert "The colour of the noise of gauge is not known" in sentence and "15 of its samples" in sentence


@pytest.mark.parametrize("lengths", [(300, 50), (1000, 200), (300, 20), (300, 2)])
def test_recordings_may_be_of_any_length(lengths: tuple[int, int]) -> None:
    """A long one and a short one tell what the long one alone does, nearly."""
    rng = np.random.default_rng(7)
    parts = []
    for n in lengths:
        there, t = np.ones((n, 3), dtype=bool), np.arange(n)[:, None, None] / 100.0
        parts.append(Part(there, coloured(rng, 0.9, n, 3), np.sin(t + np.arange(3)[:, None] + np.arange(2))))
    plain = sum(np.einsum("kcp,kcq->pq", part.jacobian, part.jacobian) for part in parts)
    both = plain + autocorrelated_scores([parts], np.linalg.inv(plain))
    alone = np.einsum("kcp,kcq->pq", parts[0].jacobian, parts[0].jacobian)
    alone = alone + autocorrelated_scores([parts[:1]], np.linalg.inv(alone))
    assert np.all(np.diag(both) > 0.7 * np.diag(alone)) and np.all(np.diag(both) < 2.0 * np.diag(alone))


@pytest.mark.parametrize("lost", [0, 4])
@pytest.mark.parametrize("length", [20.0, 40.0])
def test_what_a_bias_takes_up_is_allowed_for(length: float, lost: int) -> None:
    """Of 150 recordings that are tared, with white noise and three times as much that changes slowly: scores scatter as
    they are said to, within a tenth and a fifth, also where so many of eight samples are missing."""
    n, t = 400, np.arange(400) / 100.0
    there = (np.arange(n) % 8 >= lost)[:, None]
    jacobian = 3.0 * np.stack([t, np.sin(6.0 * t)], axis=1)[:, None, :]
    jacobian = there[:, :, None] * (jacobian - jacobian[there[:, 0]].mean(axis=0))
    plain = np.einsum("kcp,kcq->pq", jacobian, jacobian)
    inverse = np.linalg.inv(plain)
    rng, off, said = np.random.default_rng(8), [], []
    for _ in range(150):
        noise = 3.0 * coloured(rng, float(np.exp(-1.0 / length)), n, 1) + rng.standard_normal((n, 1))
        noise = there * (noise - noise[there].mean())
        found = inverse @ np.einsum("kcp,kc->p", jacobian, noise)
        part = Part(there, noise - jacobian @ found, jacobian, tared=True)
        off.append(found)
        said.append(np.sqrt(np.diag(inverse + inverse @ autocorrelated_scores([[part]], inverse) @ inverse)))
    ratio = np.sqrt(np.mean(np.square(said), axis=0)) / np.std(off, axis=0)
    assert np.all(ratio > 0.9) and np.all(ratio < 1.25), ratio


@pytest.mark.parametrize("bias", [True, False])
def test_a_wrench_is_known_to_be_tared_where_its_bias_is_eliminated(
    bias: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, parameters, scaled: rig)
    run = run_of(SLOPES @ TRUTH)
    problem = Problem([run], {"gauge": ChannelNoise(np.ones(6), 0.0, "rest")}, cast(Any, None), bias=bias)
    there = Prediction({"gauge": SLOPES @ TRUTH}, {"gauge": SLOPES}, cast(Trace, None))
    fitted = problem.compare([there], cast(Any, None), PARAMETERS, TRUTH)
    assert [part.tared for quantity in fitted.parts for part in quantity] == [bias, bias]
