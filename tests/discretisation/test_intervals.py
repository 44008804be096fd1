"""What a known discretisation error makes of residuals, and of what is known of parameters under it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import discretisation_model
import numpy as np
import pytest
from discretisation_model import NOISE, PARAMETERS, SIGMA, TRUTH, Linear, T, Vector, coarse, fit, measured, own, run_of

from sim_core.simulate import Trace
from sysid.discretisation.refinement import large_discretisation_errors
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.solve import SOLVE
from sysid.solve.covariance import uncertainty
from sysid.solve.discretisation_basis import ErrorShape, basis_of
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


def test_intervals_hold_the_truth_as_often_as_they_say(vectors: None) -> None:
    """Errors drawn from the very prior, 300 recordings: 95 % intervals hold in 91 to 98 % of them."""
    rng = np.random.default_rng(5)
    shape = own(TRUTH)
    known = ErrorShape("mesh", ({"gauge": shape},))
    knots = [(np.linspace(0.0, 1.0, count), strength) for count, strength in SOLVE.error_course_levels]
    hats = [a * np.clip(1.0 - np.abs(T[:, None] - k) * (len(k) - 1), 0.0, None) for k, a in knots]
    fine = hats[-1] > 0.0
    variances, turned = np.linalg.eigh(shape.T @ shape)
    assert variances.min() > 0.0
    courses = shape @ turned
    about = (
        hats[-1]
        / SOLVE.error_course_levels[-1][1]
        @ np.max(np.where(fine[:, :, None], np.abs(courses)[:, None], 0.0), axis=0)
    )

    def drift(levels: int = len(SOLVE.error_course_levels)) -> np.ndarray:
        return np.asarray(rng.standard_normal() + sum(h @ rng.standard_normal(h.shape[1]) for h in hats[:levels]))

    inside = np.zeros(2)
    for _ in range(300):
        drifts = [drift() for _ in range(3)]
        size = 0.5 + SOLVE.error_size_sd * (drifts[0][:, None] + np.column_stack(drifts[1:]))
        others = (
            SOLVE.error_size_sd * (about * np.column_stack([drift(SOLVE.pattern_levels) for _ in range(2)])) @ turned.T
        )
        values = coarse(TRUTH) + size * shape + others + SIGMA * rng.standard_normal((len(T), 2))
        problem = Problem([run_of(values)], NOISE, cast(ParallelPredictor, Linear()), [known])
        fitted = problem.fit(cast(Any, Vector(np.zeros(2))), PARAMETERS)
        inside += np.abs(fitted.scaled - TRUTH) < 1.96 * uncertainty(fitted).sd
    assert np.all((inside > 0.91 * 300) & (inside < 0.98 * 300)), inside


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_an_error_without_the_shape_is_allowed_for(vectors: None, rho: float) -> None:
    """Where the known error passes through zero, the true one is there all the same: it weighs samples down."""
    rng = np.random.default_rng(8)
    shape, rms = np.column_stack([np.sin(60 * T), np.cos(60 * T)]), 0.5**0.5
    known = ErrorShape("mesh", ({"gauge": shape},))
    inside = np.zeros(2)
    for _ in range(100):
        values = coarse(TRUTH) + 0.5 * shape + rms * SOLVE.rough_error_share * rng.standard_normal((len(T), 2))
        noise = {"gauge": ChannelNoise(NOISE["gauge"].sigma, rho, "test")}
        problem = Problem([run_of(values)], noise, cast(ParallelPredictor, Linear()), [known])
        fitted = problem.fit(cast(Any, Vector(np.zeros(2))), PARAMETERS)
        assert fitted.misfit < 1.5
        inside += np.abs(fitted.scaled - TRUTH) < 1.96 * uncertainty(fitted).sd
    assert np.all(inside >= 90), inside


def with_a_fast_error(n: int, errors: np.ndarray | float, amplitude: float = 1.0) -> Fitted:
    """The two parameters at the truth, by ``n`` samples of eight columns with a discretisation error of a given
    ``amplitude`` that oscillates faster than its size drifts, in each column otherwise; the readings are off by
    ``errors`` ``(n, 8)``."""
    t, j = np.linspace(0.0, 1.0, n)[:, None], np.arange(8)
    slopes = np.stack([np.cos(0.7 * j * t + j), np.sin(1.1 * j * t + 1.0)], axis=-1)
    shape = amplitude * np.sin((250.0 + 20.0 * j) * t)
    values = slopes @ TRUTH + 0.5 * shape + errors
    run = Run("run", "", (), {}, (Measured("gauge", "markers", t[:, 0], values, tuple("abcdefgh")),), 1.0)
    noise = {"gauge": ChannelNoise(np.full(8, SIGMA), np.zeros(8), "test")}
    problem = Problem([run], noise, cast(ParallelPredictor, None), [ErrorShape("mesh", ({"gauge": shape},))])
    there = Prediction({"gauge": slopes @ TRUTH}, {"gauge": slopes}, cast(Trace, None))
    return problem.compare([there], cast(Any, Vector(np.zeros(2))), PARAMETERS, TRUTH)


def test_an_error_without_the_shape_may_stay_for_a_while(vectors: None) -> None:
    """It is drawn anew 23 times in a run, not from sample to sample."""
    n, rng = 1200, np.random.default_rng(9)
    block = np.minimum((np.linspace(0.0, 1.0, n) * 23).astype(int), 22)
    scores = []
    for _ in range(100):
        fitted = with_a_fast_error(n, 0.5**0.5 * SOLVE.rough_error_share * rng.standard_normal((23, 8))[block])
        miss = np.linalg.lstsq(fitted.jacobian, fitted.residual, rcond=None)[0]
        scores.append(miss / uncertainty(fitted).sd)
    assert np.std(scores, axis=0) == pytest.approx(np.ones(2), abs=0.3)


def test_intervals_with_a_discretisation_error_do_not_shrink_with_the_rate(vectors: None) -> None:
    few, many = with_a_fast_error(1200, 0.0), with_a_fast_error(4800, 0.0)
    alone = [uncertainty(with_a_fast_error(n, 0.0, 1e-9)).sd for n in (1200, 4800)]
    assert alone[1] == pytest.approx(0.5 * alone[0], rel=0.01), "by noise alone they do"
    assert uncertainty(many).sd == pytest.approx(uncertainty(few).sd, rel=0.2)


def test_where_error_and_readings_change_alike_less_is_known(vectors: None) -> None:
    """An error of -c/2 that changes with the parameters as the readings c do takes a quarter of the derivatives, in the
    mean of its sizes."""
    problem, fitted = fit(Linear(lambda x: -0.5 * coarse(x)), run_of(coarse(TRUTH)))
    blind = [replace(d, slopes=(), at=None) for d in problem.error_shapes]
    plain = Problem(problem.runs, NOISE, problem.engine, blind).compare(
        fitted.predictions, cast(Any, Vector(np.zeros(2))), PARAMETERS, fitted.scaled
    )
    wider = uncertainty(fitted).sd / uncertainty(plain).sd
    assert np.max(wider) == pytest.approx(1.0 / 0.75, rel=0.05)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_what_only_the_error_depends_on_is_not_determined(
    vectors: None, monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    """Readings depend on the first parameter, the error on the second, and nobody knows how much of it there is."""
    for module in (discretisation_model.__name__, __name__):
        monkeypatch.setattr(f"{module}.coarse", lambda x: x[0] * np.column_stack([T, np.cos(2.0 * T)]))

    def ripple(x: np.ndarray) -> np.ndarray:
        return 0.05 * np.column_stack([np.sin(60.0 * T + x[1]), np.cos(60.0 * T + x[1])])

    rng = np.random.default_rng(4)
    readings = coarse(TRUTH) + share * ripple(TRUTH) + SIGMA * rng.standard_normal((len(T), 2))
    _, fitted = fit(Linear(ripple), run_of(readings))
    assert fitted.still is not None, "its slopes are known"
    known = uncertainty(fitted)
    assert abs(fitted.scaled[0] - TRUTH[0]) < 1.96 * known.sd[0] < 0.1
    assert any(said.startswith("The data do not determine b:") for said in known.sentences)


def test_slopes_are_used_near_where_they_were_measured() -> None:
    shape, slopes = np.ones((len(T), 2)), np.full((len(T), 2, 2), 3.0)
    known = ErrorShape("mesh", ({"gauge": shape},), slopes=({"gauge": slopes},), at=TRUTH, reach=np.array([0.1, 0.2]))
    basis = basis_of([known], 0, run_of(shape), run_of(shape).measured[0])
    near, far = TRUTH + [0.05, -0.1], TRUTH + [0.05, -9.0]
    assert basis.mean_error(near)[0, 0] == pytest.approx(known.mean * (1.0 + 3.0 * (0.05 - 0.1)))
    assert basis.mean_error(far)[0, 0] == pytest.approx(known.mean * (1.0 + 3.0 * (0.05 - 0.2)))
    assert basis.in_reach(near).tolist() == [1.0, 1.0] and basis.in_reach(far).tolist() == [1.0, 0.0]


def test_readings_after_a_gap_are_whitened_like_the_error_in_them(vectors: None) -> None:
    """With an error of ten times the noise, a tenth of the readings missing: what is left is noise."""
    rng, rho = np.random.default_rng(2), np.array([0.9, 0.9])
    t = np.linspace(0.0, 1.0, 400)
    coloured = np.zeros((len(t), 2))
    for k in range(len(t)):
        coloured[k] = rho * coloured[max(k - 1, 0)] + np.sqrt(1.0 - rho**2) * rng.standard_normal(2)
    shape = np.full((len(t), 2), 10.0 * SIGMA)
    values = 0.5 * shape + SIGMA * coloured
    values[rng.uniform(size=len(t)) < 0.1] = np.nan
    run = Run("run", "", (), {}, (Measured("gauge", "markers", t, values, ("u", "v")),), 1.0)
    noise = {"gauge": ChannelNoise(NOISE["gauge"].sigma, rho, "test")}
    problem = Problem([run], noise, cast(ParallelPredictor, None), [ErrorShape("mesh", ({"gauge": shape},), sd=1e-6)])
    nothing = Prediction({"gauge": np.zeros((len(t), 2))}, {}, cast(Trace, None))
    residual = problem.assemble([nothing], [])[0]
    weight = problem.basis(0, run.measured[0]).weights(noise["gauge"])
    assert residual @ residual < 1.2 * np.sum(weight[np.isfinite(values)] ** 2)


def test_what_was_not_measured_does_not_weigh_down_what_was(vectors: None) -> None:
    """A wrench of which one force alone is measured; its error is small, that of another force large."""
    values = np.full((len(T), 6), np.nan)
    values[:, 2] = 0.0
    shape = np.tile([100.0, 0.0, 0.1, 0.0, 0.0, 0.0], (len(T), 1))
    run = Run("run", "", (), {}, (Measured("cell", "wrench", T, values, tuple("abcdef")),), 1.0)
    noise = {"cell": ChannelNoise(np.ones(6), np.zeros(6), "test")}
    problem = Problem([run], noise, cast(ParallelPredictor, None), [ErrorShape("mesh", ({"cell": shape},))])
    rough = problem.basis(0, run.measured[0]).rough[:, 2]
    assert rough == pytest.approx(SOLVE.rough_error_share * 0.1, rel=1e-12)


def test_derivatives_are_those_of_the_residual(vectors: None) -> None:
    rng = np.random.default_rng(1)
    slopes = ({"gauge": rng.standard_normal((len(T), 2, 2))},)
    known = ErrorShape("mesh", ({"gauge": own(TRUTH)},), slopes=slopes, at=np.array([0.2, 0.1]))
    problem = Problem([run_of(measured(rng))], NOISE, cast(ParallelPredictor, Linear()), [known], prior=True)
    rig = cast(Any, Vector(np.zeros(2)))
    here = problem.evaluate(rig, PARAMETERS, TRUTH)
    for k in range(2):
        step = 1e-4 * np.eye(2)[k]
        ahead, behind = (problem.evaluate(rig, PARAMETERS, TRUTH + s * step).residual for s in (1.0, -1.0))
        assert here.jacobian[:, k] == pytest.approx((ahead - behind) / 2e-4, rel=1e-6, abs=1e-5)


def test_an_error_far_above_the_noise_is_said() -> None:
    def problem(size: float) -> Problem:
        known = ErrorShape("mesh", ({"gauge": np.full((len(T), 2), size)},))
        return Problem([run_of(coarse(TRUTH))], NOISE, cast(ParallelPredictor, Linear()), [known])

    assert large_discretisation_errors(problem(9.0 * SIGMA)) == []
    (said,) = large_discretisation_errors(problem(40.0 * SIGMA))
    assert "position of gauge may be 40 times the noise" in said and "finer cells" in said


def test_a_reading_that_a_refinement_does_not_move_may_be_off_for_long() -> None:
    """Relative to one that it moves by 1: by a quarter of their largest rms, and the same all through a run."""
    shape = np.column_stack([np.ones(len(T)), np.zeros(len(T))])
    run = run_of(np.zeros((len(T), 2)))
    basis = basis_of([ErrorShape("mesh", ({"gauge": shape},))], 0, run, run.measured[0])
    lasting = [p.shape[:, 1:] * p.functions[:, :1] for p in basis.own if len(p.instants)]
    assert np.hypot.reduce(lasting) == pytest.approx(np.full((len(T), 1), SOLVE.rough_error_share * 0.5**0.5))


def test_each_column_may_have_its_own_multiple_of_the_error(vectors: None) -> None:
    """With its sign: half as much again all through a run takes one coefficient, also where the error changes sign."""
    shape = 100.0 * SIGMA * np.column_stack([np.sin(15 * T), np.cos(11 * T)])
    problem = Problem(
        [run_of(shape * [1.0, 0.5])], NOISE, cast(ParallelPredictor, None), [ErrorShape("mesh", ({"gauge": shape},))]
    )
    nothing = Prediction({"gauge": np.zeros(shape.shape)}, {}, cast(Trace, None))
    assert problem.compare([nothing], cast(Any, Vector(TRUTH)), [], np.zeros(0)).chi2 < 1.0


def test_errors_of_a_rig_that_is_right_are_the_noise(vectors: None) -> None:
    """With a discretisation error of ten times the noise, which is not in the readings, of a wrench that was not
    tared."""
    rng, bias = np.random.default_rng(3), np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.0])
    noise = {"cell": ChannelNoise(np.full(6, SIGMA), np.zeros(6), "test")}
    values = bias + SIGMA * rng.standard_normal((len(T), 6))
    run = Run("run", "", (), {}, (Measured("cell", "wrench", T, values, tuple("abcdef")),), 1.0)
    known = ErrorShape("mesh", ({"cell": np.full((len(T), 6), 10.0 * SIGMA)},))
    problem = Problem([run], noise, cast(ParallelPredictor, None), [known], bias=True)
    nothing = Prediction({"cell": np.zeros((len(T), 6))}, {}, cast(Trace, None))
    fitted = problem.compare([nothing], cast(Any, Vector(TRUTH)), [], np.zeros(0))
    left = values - problem.tared(fitted, 0, run.measured[0])
    assert np.sqrt(np.mean(left**2)) == pytest.approx(SIGMA, rel=0.05)
