"""Noise of markers, noise that they have in common, and the discretisation error are one covariance: recordings of a
known truth, without rollouts, have the chi-square, the coefficients, the intervals and the evidence that it says."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple, cast

import numpy as np
import pytest

from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.common_mode import CommonMode
from sysid.observations.observations import Measured, Run
from sysid.solve.covariance import uncertainty
from sysid.solve.discretisation_basis import ErrorShape, added
from sysid.solve.residuals import Problem

MARKERS, FRAMES, RATE_HZ = 16, 60, 20.0
OWN_PX, SHAKE_PX, RHO = 0.08, 0.15, 0.8
EFFECTS, DRAWS = 20, 200
T = np.arange(FRAMES) / RATE_HZ
GRID = np.stack(np.meshgrid(np.linspace(-1.0, 1.0, 4), np.linspace(-1.0, 1.0, 4)), axis=-1).reshape(-1, 2)
PLACES = (300.0 + 200.0 * GRID).ravel()
PRESS = np.clip(T - 0.5, 0.0, 1.5) / 1.5


class Case(NamedTuple):
    """A stand of markers over a pressed gel: the motion of its markers ``(n, m)`` [px], and a problem."""

    signal: np.ndarray
    problem: Problem
    noise: ChannelNoise
    responses: np.ndarray


def channel_noise(rho: float) -> ChannelNoise:
    """The noise as it is, not as estimated. ``rho``: of the shake, over an interval of the pictures."""
    of_shift = MARKERS * SHAKE_PX**2 * (1.0 + rho) / (1.0 - rho) + OWN_PX**2
    share = OWN_PX / np.sqrt(of_shift)
    own = np.full(2 * MARKERS, OWN_PX)
    common = CommonMode(own, np.zeros(2 * MARKERS), np.array([share, share, 1.0, 1.0]))
    return ChannelNoise(np.hypot(own, SHAKE_PX), rho, "known", common=common)


def pattern(seed: int) -> np.ndarray:
    """A smooth field of displacements of the markers, rms 1 ``(m,)``; a part of it shifts them all."""
    rng = np.random.default_rng(seed)
    x, y = GRID.T
    terms = np.stack([np.ones(MARKERS), x, y, x * y, x**2 - 0.5, y**2 - 0.5])
    field = (rng.standard_normal((2, 6)) @ terms).T.ravel()
    return np.asarray(field / np.sqrt(np.mean(field**2)))


@cache
def case(rho: float) -> Case:
    """An empty recording with a mesh error of four times the markers' own noise, and a tenth of the signal."""
    noise = channel_noise(rho)
    signal = 6.0 * PRESS[:, None] * pattern(1)
    shapes = [
        ErrorShape("mesh", ({"below": 4.0 * OWN_PX * PRESS[:, None] * pattern(2)},), mean=0.5, sd=0.5),
        ErrorShape("time step", ({"below": 0.1 * signal},), mean=0.0, sd=1.0),
    ]
    measured = Measured("below", "tracks", T, PLACES + signal, tuple(f"m {k} u" for k in range(2 * MARKERS)))
    run = Run("press", "", (), {}, (measured,), float(T[-1]))
    rng = np.random.default_rng(11)
    courses = [np.sin(2.0 * np.pi * (T * rng.uniform(0.1, 1.5) + rng.random())) for _ in range(EFFECTS)]
    responses = np.stack([c[:, None] * pattern(20 + k) for k, c in enumerate(courses)], axis=-1)
    return Case(signal, Problem([run], {"below": noise}, cast(Any, None), shapes, prior=True), noise, responses)


def drawn(here: Case, rho: float, rng: np.random.Generator, with_error: bool) -> np.ndarray:
    """Noise of one recording ``(n, m)`` [px], with a discretisation error drawn from its prior where asked for."""
    shift = SHAKE_PX * rng.standard_normal((FRAMES, 2))
    for k in range(1, FRAMES):
        shift[k] = rho * shift[k - 1] + np.sqrt(1.0 - rho**2) * shift[k]
    noise = OWN_PX * rng.standard_normal((FRAMES, 2 * MARKERS)) + np.tile(shift, MARKERS)
    if with_error:
        basis = here.problem.basis(0, here.problem.runs[0].measured[0])
        for parts, columns in ((basis.common, 1), (basis.own, 2 * MARKERS)):
            size = rng.standard_normal((sum(len(p.instants) for p in parts), columns, 1))
            noise += added(parts, size)[:, :, 0]
        noise += basis.expected + basis.rough * rng.standard_normal(basis.rough.shape)
    return noise


def assembled(here: Case, noise: np.ndarray) -> Any:
    prediction = Prediction({"below": PLACES + here.signal - noise}, {}, cast(Any, None))
    return here.problem.assemble([prediction], [], np.zeros(0))


def assembled_with(here: Case, noise: np.ndarray, slopes: np.ndarray) -> Any:
    prediction = Prediction({"below": PLACES + here.signal - noise}, {"below": slopes}, cast(Any, None))
    return here.problem.assemble([prediction], [str(k) for k in range(slopes.shape[-1])], np.zeros(0))


def covariances(here: Case, rho: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of all readings in units of the markers' own noise, each ``(n m, n m)``: of the true noise, of what of the error
    follows no shape, and of what the coefficients of the error make."""
    basis = here.problem.basis(0, here.problem.runs[0].measured[0])
    n, m = FRAMES, 2 * MARKERS
    own = np.concatenate([p.shape[:, :, None] * p.functions[:, None] for p in basis.own], axis=2) / OWN_PX
    common = np.concatenate([p.shape[:, :, None] * p.functions[:, None] for p in basis.common], axis=2) / OWN_PX
    each = np.einsum("njl,kjl,ji->njki", own, own, np.eye(m), optimize=True)
    flat = common.reshape(n * m, -1)
    coefficients = each.reshape(n * m, n * m) + flat @ flat.T
    shake = (SHAKE_PX / OWN_PX) ** 2 * rho ** np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
    noise = np.eye(n * m) + np.kron(shake, np.tile(np.eye(2), (MARKERS, MARKERS)))
    return noise, np.diag((basis.rough / OWN_PX).ravel() ** 2), coefficients


def test_chi_square_is_the_number_of_readings() -> None:
    """Over recordings whose error is drawn from its prior."""
    here, rng = case(0.0), np.random.default_rng(1)
    found = [np.sum(assembled(here, drawn(here, 0.0, rng, True)).residual ** 2) for _ in range(DRAWS)]
    number = FRAMES * 2 * MARKERS
    # The mean over draws has a relative standard deviation of sqrt(2 / (number draws)) = 0.15 %.
    assert np.mean(found) / number == pytest.approx(1.0, abs=0.006)
    assert np.std(found) == pytest.approx(np.sqrt(2.0 * number), rel=0.2)


@pytest.mark.parametrize("with_error", [True, False])
@pytest.mark.parametrize("rho", [0.0, RHO])
def test_coefficients_are_as_large_as_the_posterior_says(rho: float, with_error: bool) -> None:
    """Coefficients x ~ N(0, 1) that add X x to readings with noise of the covariance N have the estimate X^T S^-1 y,
    S = N + X X^T, so that their sum of squares is tr(C S^-1 X X^T S^-1) where readings have the covariance C. With the
    error drawn from its prior and a white shake C = S, and it is their number less the trace of their posterior
    covariance. A shake of the camera, white or not, is no error that each marker shows: coefficients eliminated before
    it was weighed were many times larger. N has a coloured shake as white, with the variance of its means."""
    here, rng = case(rho), np.random.default_rng(2)
    noise, rough, made = covariances(here, rho)
    assumed = 1.0 / here.noise.common.shares[0] ** 2 - 1.0  # type: ignore[union-attr]
    picture = np.eye(2 * MARKERS) + assumed * np.tile(np.eye(2), (MARKERS, MARKERS)) / MARKERS
    whole = np.kron(np.eye(FRAMES), picture) + rough + made
    estimate = np.linalg.solve(whole, made)
    drawn_from = noise + rough + made if with_error else noise
    expected = np.trace(np.linalg.solve(whole, drawn_from) @ estimate)
    mean = here.problem.basis(0, here.problem.runs[0].measured[0]).expected
    found = []
    for _ in range(DRAWS):
        draw = drawn(here, rho, rng, with_error)
        sizes = assembled(here, draw if with_error else draw + mean).sizes[(0, "below")]
        found.append(np.sum(sizes.common**2) + np.sum(sizes.own**2))
    assert np.mean(found) == pytest.approx(expected, rel=0.05)


def test_the_best_score_of_empty_recordings_has_its_simulated_level() -> None:
    """Of recordings in which nothing is missing and all of the camera shakes, one in a hundred exceeds the largest
    score of an effect that whitened noise reaches with that probability."""
    here, rng = case(RHO), np.random.default_rng(3)
    scores = []
    for _ in range(DRAWS):
        noise = drawn(here, RHO, rng, True)
        rows = assembled_with(here, noise, here.responses)
        j, r = rows.jacobian, rows.residual
        scores.append((j.T @ r) / np.sqrt(np.sum(j**2, axis=0)))
    information = j.T @ j
    size = np.sqrt(np.diag(information))
    null = np.random.default_rng(5).multivariate_normal(
        np.zeros(len(size)), information / np.outer(size, size), size=20_000
    )
    level = np.quantile(np.max(null**2, axis=1), 0.99)
    # Of 200 recordings 2 are expected, and more than 7 come with a probability of 0.1 %.
    best = np.max(np.array(scores) ** 2, axis=1)
    assert np.count_nonzero(best > level) <= 7
    assert np.quantile(best, 0.99) > level - 6.0


@pytest.mark.parametrize("rho", [0.0, RHO])
def test_intervals_hold_the_true_value(small_rig: Any, rho: float) -> None:
    """The size of an effect that is not eliminated: 95 % of intervals hold it, whether the camera's shake repeats
    itself from picture to picture or not."""
    here, rng = case(rho), np.random.default_rng(4)
    rig = small_rig()
    size = fit_parameters(rig, ["gel.E"])[0]
    start = start_of(rig, [size])
    slopes = here.responses[..., :1]
    inside, scores = 0, []
    for _ in range(DRAWS):
        noise = drawn(here, rho, rng, True)
        prediction = Prediction({"below": PLACES + here.signal - noise}, {"below": slopes}, cast(Any, None))
        found = here.problem.compare([prediction], rig, [size], start)
        data = slice(0, len(found.residual) - found.pulls)
        slope, information = (found.jacobian[data, 0] @ v[data] for v in (found.residual, found.jacobian[:, 0]))
        scores.append(slope / np.sqrt(information))
        inside += abs(slope / information) <= 1.96 * uncertainty(found).sd[0]
    # 95 % of 200 with a standard deviation of 1.5 %; intervals also allow for a wrong colour of the noise.
    assert inside / DRAWS >= 0.91
    assert np.std(scores) == pytest.approx(1.0, abs=0.16)
