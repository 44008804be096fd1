"""Evaluations of a fit are counted over all of its searches, and limited."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from readings import TRUTH, Readings, column, run_of

from sim_core.errors import ConfigError, ConvergenceError
from sysid.fit import FitOptions, fit
from sysid.fit import multistart as starts
from sysid.fit.multistart import Evaluations, Searches, Step
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import fit_parameters
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.settings.fit import FIT
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.residuals import Problem

pytestmark = pytest.mark.usefixtures("declared")


def test_a_restart_that_cannot_be_simulated_is_left_out(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, calls = Problem.fit, []

    def once(problem: Problem, *given: Any, **more: Any) -> Any:
        calls.append(given)
        if len(calls) > 1:
            raise ConvergenceError("The step does not converge.")
        return plain(problem, *given, **more)

    monkeypatch.setattr(Problem, "fit", once)
    monkeypatch.setattr(starts, "UNCERTAINTY", replace(UNCERTAINTY, good_misfit=0.0))
    parameters = fit_parameters(small_rig(), ["gel.E"])
    noise = {"markers": ChannelNoise(np.array([0.01]), 0.0, "test")}
    problem = Problem([run_of("press", "markers")], noise, cast(ParallelPredictor, Readings()))
    evaluations = Evaluations(FitOptions())
    found = Searches(small_rig(), parameters, FitOptions(), evaluations)(problem, np.array([11.0]))
    assert len(calls) == 1 + FIT.most_restarts
    assert evaluations.done == found.evaluations + FIT.most_restarts, "each has cost an evaluation"
    assert np.exp(found.scaled[0]) == pytest.approx(TRUTH, rel=0.05)


class Counted(Readings):
    """Counts the evaluations with derivatives."""

    def __init__(self) -> None:
        super().__init__()
        self.evaluations = 0

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        self.evaluations += bool(parameters)
        return super().predict_all(rig, runs, parameters, scaled)


def fit_within(rig: Any, most: int | None) -> tuple[int, list[int], fit.FitResult]:
    """Evaluations made and reported, and the result, of a fit with all that may follow its first search."""
    engine, steps = Counted(), []
    result, _ = fit.fit_runs(
        rig, [run_of("press", "markers")], ["gel.E"], FitOptions(nuisance=("none",), max_evaluations=most),
        engine=cast(ParallelPredictor, engine), on_step=lambda step: steps.append(step.evaluations),
    )  # fmt: skip
    return engine.evaluations, steps, result


def test_a_fit_makes_no_more_evaluations_than_it_may(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither in restarts, which no misfit prevents here, nor in further looks, nor at the ends of intervals."""
    monkeypatch.setattr(starts, "UNCERTAINTY", replace(UNCERTAINTY, good_misfit=0.0))
    monkeypatch.setattr(fit, "without_outliers", lambda runs, *given: (list(runs), []))
    monkeypatch.setattr(fit, "worth_another_fit", lambda *given: True)
    made, steps, free = fit_within(small_rig(), None)
    assert free.converged
    assert made == len(steps) + 2, "an interval has two ends"
    for most in range(1, len(steps)):
        made, steps, result = fit_within(small_rig(), most)
        assert steps == list(range(1, most + 1))
        assert made == result.evaluations == most
        assert not result.converged
        assert result.message.startswith(f"the evaluations allowed, {most}, are used up")
    with pytest.raises(ConfigError, match="Allow at least one"):
        fit_within(small_rig(), 0)


def test_a_rig_that_is_only_compared_is_evaluated_once(small_rig: Any) -> None:
    """Though its misfit is large, there is nothing to search and no other place to measure its discretisation error
    at."""
    steps: list[Step] = []
    result, _ = fit.fit_runs(
        small_rig(), [run_of("press", "markers")], [], FitOptions(robust=False),
        engine=cast(ParallelPredictor, Readings()), on_step=steps.append,
    )  # fmt: skip
    assert result.misfit > 10.0 and result.converged
    assert result.evaluations == len(steps) == 1


def test_evaluations_that_fail_are_counted(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first steps of a search, and starts of others, beyond what can be simulated."""
    monkeypatch.setattr(starts, "UNCERTAINTY", replace(UNCERTAINTY, good_misfit=0.0))
    monkeypatch.setattr(fit, "without_outliers", lambda runs, *given: (list(runs), []))

    class Brittle(Counted):
        def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
            found = super().predict_all(rig, runs, parameters, scaled)
            if self.evaluations > 1 and parameters:
                raise ConvergenceError("The step does not converge.")
            return found

    monkeypatch.setitem(globals(), "Counted", Brittle)
    made, steps, result = fit_within(small_rig(), 6)
    assert steps == list(range(1, made + 1))
    assert made == result.evaluations <= 6


def test_a_fit_counts_its_evaluations_over_all_searches_and_stops_at_the_most_allowed(small_rig: Any) -> None:
    parameters = fit_parameters(small_rig(), ["gel.E"])
    noise = {"markers": ChannelNoise(np.array([0.01]), 0.0, "test")}
    problem = Problem([run_of("press", "markers")], noise, cast(ParallelPredictor, Readings()))
    steps: list[Step] = []
    evaluations = Evaluations(FitOptions(max_evaluations=2), on_step=steps.append)
    first = problem.fit(small_rig(), parameters, np.array([11.0]), 1, on_evaluation=evaluations)
    second = problem.fit(small_rig(), parameters, np.array([11.5]), evaluations.left, on_evaluation=evaluations)
    assert evaluations.left == 0
    assert [s.evaluations for s in steps] == list(range(1, 1 + first.evaluations + second.evaluations))
    assert first.evaluations == 1 and second.evaluations == 1
    assert not first.converged and not second.converged
    assert steps[0].values == {"gel.E_pa": pytest.approx(np.exp(first.scaled[0]))}
    assert steps[0].misfit == pytest.approx(first.misfit)


def test_the_misfit_of_a_result_is_that_of_its_last_step(small_rig: Any) -> None:
    """One measure while a fit runs and at its end: whitened residuals squared, over their number."""
    steps: list[Step] = []
    run = run_of("press", "markers")
    options = FitOptions(nuisance=("none",), intervals="quadratic", robust=False)
    result, _ = fit.fit_runs(
        small_rig(), [run], ["gel.E"], options, engine=cast(ParallelPredictor, Readings()), on_step=steps.append
    )
    assert result.misfit == pytest.approx(steps[-1].misfit)
    white = (run.measured[0].values - column(result.estimates[0].value)) / 0.01
    assert result.misfit == pytest.approx(float(np.mean(white**2)), rel=1e-6)
    assert result.misfit < result.reduced_chi2
