"""Evidence of fitted models: by the recordings given, by those held out, and over time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from effect_hypotheses import hypothesis

from sysid.diagnosis.evidence import (
    deviations,
    distance_from_none,
    held_out_gain,
    inflation_of,
    log_evidence,
    log_likelihood_ratio,
    significance,
)
from sysid.model.parameters import FitParameter
from sysid.solve.covariance import uncertainty
from sysid.solve.optimum import Fitted


def test_the_distance_from_none_is_that_of_the_size_which_is_farthest() -> None:
    h = hypothesis("wrench_offset")
    names = [f"effects.wrench_offset.{a.parameter.name}" for a in h.amplitudes[:2]]
    parameters = [FitParameter(n, "", False, -10.0, 10.0, 1.0, "") for n in names]
    at, sd = np.array([0.3, -0.8]), np.array([0.1, 0.2])
    j = np.diag(1.0 / sd)
    n = 400
    table = np.repeat(j, n, axis=0) / np.sqrt(n)
    noise = np.random.default_rng(0).choice([-1.0, 1.0], size=2 * n)
    fitted = Fitted(
        parameters, at, cast(Any, None), noise, table, [(0, "wrist", np.tile(np.arange(n, dtype=float), 2))], [],
        cast(Any, None), 1, True, "", {},
    )  # fmt: skip
    expected = np.abs(at / uncertainty(fitted).sd).max()
    assert distance_from_none(h, fitted, uncertainty(fitted)) == pytest.approx(expected)
    assert expected == pytest.approx(4.0, rel=0.2)


def fitted_with(columns, residual, parameters):
    nothing, labels = cast(Any, None), [(0, "gauge", np.linspace(0.0, 1.0, len(residual)))]
    scaled = np.zeros(len(parameters))
    return Fitted(parameters, scaled, nothing, residual, columns, labels, [], nothing, 1, True, "")


def test_an_improvement_is_worth_less_where_misfit_is_smooth_in_time():
    """White misfit leaves the likelihood ratio as it is; misfit that drifts over the run deflates it."""
    rng = np.random.default_rng(0)
    drag = [FitParameter("effects.air_drag.drag_coefficient", "-", False, 0.0, 9.0, 1.0, "")]
    column = np.ones((600, 1))
    white = rng.standard_normal(600)
    smooth = white + 2.0 * np.sin(np.linspace(0.0, 2.0 * np.pi, 600))
    effect = hypothesis("air_drag")
    inflated = [
        inflation_of(effect, f, uncertainty(f)) for f in (fitted_with(column, r, drag) for r in (white, smooth))
    ]
    assert significance(inflated[0], 50.0) == pytest.approx(10.0, rel=0.35)
    assert significance(inflated[1], 50.0) < 2.5


def test_an_amplitude_known_only_as_a_ratio_is_no_reason_for_doubt():
    """Drag and density both scale with an unknown factor; that neither is known alone says nothing of drag."""
    rng = np.random.default_rng(0)
    names = ("effects.air_drag.drag_coefficient", "strip.density_kg_m3")
    both = [FitParameter(n, "-", False, 0.0, 9.0, 1.0, "") for n in names]
    shape = rng.standard_normal(600)
    columns = np.column_stack([shape, -shape])
    fitted = fitted_with(columns, rng.standard_normal(600), both)
    assert significance(inflation_of(hypothesis("air_drag"), fitted, uncertainty(fitted)), 800.0) > 20.0


def test_held_out_gain_is_not_decided_by_a_few_samples():
    rng = np.random.default_rng(0)
    plain = rng.standard_normal(2000) * 1.5
    better = plain / 1.5
    assert held_out_gain(plain, better) > 0.3
    spiked = better.copy()
    spiked[:2] = 30.0
    assert held_out_gain(plain, spiked) > 0.2
    assert held_out_gain(better, plain) < 0.0


def test_likelihood_on_held_out_recordings_speaks_for_what_is_there_and_against_what_followed_noise():
    """A column of norm d that is missing is worth d^2 / 2 nats on average, less by mean curvature of the robust loss
    under noise; one that is fitted to the noise of other recordings of the same length costs half a nat on average."""
    rng = np.random.default_rng(0)
    shape = rng.standard_normal(4000)
    shape *= 6.0 / np.linalg.norm(shape)
    there, chance = [], []
    for _ in range(60):
        noise = rng.standard_normal(4000)
        there.append(log_likelihood_ratio(noise + shape, noise).sum())
        chance.append(log_likelihood_ratio(noise, noise - rng.standard_normal() * shape / 6.0).sum())
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    curvature = weights @ (1.0 + nodes**2 / 9.0) ** -1.5 / weights.sum()
    assert np.mean(there) == pytest.approx(18.0 * curvature, rel=0.1)
    assert np.mean(chance) == pytest.approx(-0.5, abs=0.3)
    assert max(chance) < 5.0
    loud = 3.0 * rng.standard_normal(4000)
    assert log_likelihood_ratio(loud + shape, loud).sum() < 0.5 * np.mean(there), "tempered by what is left"


def test_a_likelihood_ratio_counts_by_how_steady_it_is_where_models_differ():
    """What is right wherever it acts, all the time or in a sixth of it, against what is right in each other block and
    wrong by less between. And chance is within two deviations mostly, whichever model is nearer."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((48, 50))

    def found(plain: np.ndarray, amended: np.ndarray) -> float:
        ratios = log_likelihood_ratio(plain.ravel(), amended.ravel()).reshape(48, 50).sum(1)
        return deviations(ratios, ((plain - amended) ** 2).sum(1))

    block = np.arange(48)[:, None]
    missing = np.full((48, 50), 0.6)
    assert found(noise + missing, noise) > 8.0
    assert found(noise + missing * (block < 8), noise) > 5.0
    assert found(noise, noise + missing) < -8.0
    taken = np.where(block % 2 == 0, missing, 0.0)
    given = np.where(block % 2 == 0, 0.0, 0.8 * missing)
    assert 0.0 < found(noise + taken, noise + given) < 2.5
    chance = []
    for _ in range(40):
        change = 0.1 * rng.standard_normal(noise.shape)
        chance.append(found(noise + 0.5 * change, noise - 0.5 * change))
    assert np.mean(np.abs(chance) > 2.5) <= 0.05
    assert found(noise, noise) == 0.0
    assert found(noise + missing * (block == 3), noise) == 0.0, "one block alone says nothing of others"


@pytest.mark.parametrize("temper", [1.0, 10.0])
def test_evidence_does_not_depend_on_where_a_search_of_a_linear_model_ended(temper):
    rng = np.random.default_rng(0)
    parameter = FitParameter("a", "-", False, -9.0, 9.0, 0.5, "")
    slope, miss = rng.standard_normal(50), rng.standard_normal(50)

    def at(value):
        jacobian = np.append(slope, 1.0 / parameter.prior_sd)[:, None]
        residual = np.append(miss + slope * value, value / parameter.prior_sd)
        return cast(Fitted, SimpleNamespace(
            parameters=[parameter], pulls=1, jacobian=jacobian, residual=residual,
            chi2=float(residual @ residual)))  # fmt: skip

    best = -(slope @ miss) / temper / (slope @ slope / temper + parameter.prior_sd**-2)
    values = [log_evidence(at(value), temper) for value in (best, best + 0.3, 0.0)]
    assert values == pytest.approx([values[0]] * 3, abs=1e-9)
    data, pull = miss + slope * best, best / parameter.prior_sd
    exact = -0.5 * (data @ data / temper + pull**2)
    width = -0.5 * np.log((slope @ slope / temper + parameter.prior_sd**-2) * parameter.prior_sd**2)
    assert values[0] == pytest.approx(exact + width, abs=1e-9)


@pytest.mark.parametrize("temper", [1.0, 10.0, 1000.0])
def test_a_parameter_that_the_data_do_not_touch_is_no_evidence(temper):
    rng = np.random.default_rng(0)
    known = FitParameter("a", "-", False, -9.0, 9.0, 0.5, "")
    idle = FitParameter("b", "-", False, -9.0, 9.0, 3.0, "")
    slope, miss = rng.standard_normal((50, 1)), rng.standard_normal(50)

    def fitted(parameters, columns):
        jacobian = np.vstack([columns, np.diag([1.0 / p.prior_sd for p in parameters])])
        residual = np.concatenate([miss, np.zeros(len(parameters))])
        return cast(Fitted, SimpleNamespace(
            parameters=parameters, pulls=len(parameters), jacobian=jacobian, residual=residual,
            chi2=float(residual @ residual)))  # fmt: skip

    alone = log_evidence(fitted([known], slope), temper)
    beside = log_evidence(fitted([known, idle], np.hstack([slope, np.zeros((50, 1))])), temper)
    assert beside == pytest.approx(alone, abs=1e-9)
