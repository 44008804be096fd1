"""What was known of a parameter before against what recordings ask for."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from discretisation_model import NOISE, PARAMETERS, SIGMA, TRUTH, Linear, T, Vector, coarse, run_of

from sim_core.simulate import Trace
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.predictor import Prediction
from sysid.solve.covariance import overdispersion, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem
from sysid.uncertainty.prior_data_conflict import _without, prior_data_conflicts

pytestmark = pytest.mark.usefixtures("vectors")


def fitted_with(known: float, sd: float, rng: np.random.Generator, nuisance: bool = False) -> Fitted:
    """The linear model, fitted with the prior a = ``known`` +- ``sd``."""
    values = coarse(TRUTH) + SIGMA * rng.standard_normal((len(T), 2))
    problem = Problem([run_of(values)], NOISE, cast(ParallelPredictor, Linear()))
    first = replace(PARAMETERS[0], known_sd=sd, nuisance=nuisance)
    rig = cast(Any, Vector(np.array([known, 0.0])))
    return problem.fit(rig, [first, PARAMETERS[1]], tolerance=1e-9)


def deviations(fitted: Fitted) -> float:
    """Those that are reported of a."""
    return float(re.search(r"value, ([\d.e+]+) standard", prior_data_conflicts(fitted)["a"])[1])  # type: ignore[index]


@pytest.mark.parametrize("sd", [0.001, 0.01, 0.1])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_they_are_reported_with_the_deviations_between_them(sd: float, side: float) -> None:
    """Of a linear model, from the normal equations; however little the fit leaves the prior."""
    slopes = np.stack([coarse(e).ravel() for e in np.eye(2)], axis=-1) / SIGMA
    own = np.sqrt(np.linalg.inv(slopes.T @ slopes)[0, 0])
    off = 20.0 * np.hypot(own, sd)
    fitted = fitted_with(TRUTH[0] + side * off, sd, np.random.default_rng(1))
    # The data's own value misses the truth by chance, and what scatters is judged by its blocks, too.
    assert deviations(fitted) == pytest.approx(20.0, rel=0.15)
    (words,) = prior_data_conflicts(fitted).values()
    assert f"before, {TRUTH[0] + side * off:g} +- {sd:g} -: without it they ask" in words
    assert f"ask for a {'smaller' if side > 0.0 else 'larger'} value" in words


def test_what_is_right_is_contradicted_as_seldom_as_chance_has_it() -> None:
    rng = np.random.default_rng(0)
    reported = [bool(prior_data_conflicts(fitted_with(rng.normal(TRUTH[0], 0.01), 0.01, rng))) for _ in range(200)]
    assert sum(reported) <= 3  # 0.3 % are expected


def test_nuisances_are_reported_elsewhere() -> None:
    fitted = fitted_with(TRUTH[0] + 1.0, 0.01, np.random.default_rng(1), nuisance=True)
    assert prior_data_conflicts(fitted) == {}


class Alike(Linear):
    """Both parameters do nearly the same."""

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        first, other = (coarse(e) for e in np.eye(2))
        slopes = np.stack([first, first + 0.002 * other], axis=-1)
        return [Prediction({"gauge": slopes @ scaled}, {"gauge": slopes}, cast(Trace, None))]


@pytest.mark.parametrize("lower", [0.0, -50.0])
def test_a_bound_does_not_hide_what_is_contradicted(lower: float) -> None:
    """a = 1 +- 0.01 is known and 0.8 true: only a b of -0.2 could make up for that."""
    values = 0.8 * coarse(np.eye(2)[0]) + SIGMA * np.random.default_rng(1).standard_normal((len(T), 2))
    problem = Problem([run_of(values)], NOISE, cast(ParallelPredictor, Alike()))
    given = [replace(PARAMETERS[0], known_sd=0.01), replace(PARAMETERS[1], lower=lower)]
    fitted = problem.fit(cast(Any, Vector(np.array([1.0, 0.0]))), given, tolerance=1e-9)
    assert list(prior_data_conflicts(fitted)) == (["a"] if lower == 0.0 else [])


def test_recordings_that_are_missed_by_far_are_not_said_to_determine_nothing() -> None:
    """With a prior, and a misfit that no parameter explains."""
    noise = {"gauge": NOISE["gauge"]}
    values = coarse(TRUTH) + 20.0 * SIGMA * np.random.default_rng(1).standard_normal((len(T), 2))
    problem = Problem([run_of(values)], noise, cast(ParallelPredictor, Linear()))
    given = [replace(PARAMETERS[0], known_sd=0.001), PARAMETERS[1]]
    fitted = problem.fit(cast(Any, Vector(TRUTH)), given, tolerance=1e-9)
    (found,) = uncertainty(fitted).findings
    assert found.undetermined == ("a",) and "times their noise. Fit without that" in found.sentence


def test_other_priors_weigh_in_the_step_as_in_the_search() -> None:
    """The misfit goes on from sample to sample; what was known of b is that much heavier, and holds it."""
    rng = np.random.default_rng(2)
    values = coarse(TRUTH) + 20.0 * SIGMA * np.cumsum(rng.standard_normal((len(T), 2)), axis=0) / 10.0
    problem = Problem([run_of(values)], NOISE, cast(ParallelPredictor, Linear()))
    given = [replace(PARAMETERS[0], known_sd=0.1), replace(PARAMETERS[1], known_sd=0.1)]
    fitted = problem.fit(cast(Any, Vector(TRUTH)), given, tolerance=1e-9)
    step, _ = _without(fitted, 0, len(fitted.residual) - 2)
    kappa = overdispersion(fitted)
    slopes = np.stack([coarse(e).ravel() for e in np.eye(2)], axis=-1) / SIGMA
    prior = np.diag([0.0, kappa / 0.1**2])
    right = slopes.T @ (values.ravel() / SIGMA) + prior @ TRUTH
    assert kappa > 10.0
    np.testing.assert_allclose(fitted.scaled + step, np.linalg.solve(slopes.T @ slopes + prior, right), rtol=1e-3)
