"""Values at which a rig cannot be simulated: the search goes around them, and what was found is kept."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sim_core.simulate import Trace
from sysid.discretisation import refinement as discretisation_error
from sysid.discretisation.refinement import Unmeasured, discretisation, fit_with_discretisation_error
from sysid.fit.fit import _fit_without_outliers, _Look
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 40)
X = FitParameter("x", "-", False, -50.0, 50.0, 5.0, "")
TRUTH = 2.0


def run_of(name: str = "run") -> Run:
    """A recording of exp(x) t."""
    gauge = Measured("gauge", "markers", T, np.exp(TRUTH) * T[:, None], ("u",))
    return Run(name, "", (), {}, (gauge,), 1.0)


class Stub:
    """Stands for a rig: the step of its solver."""

    class Solver:
        dt_s = 0.01
        order = 1

    solver = Solver()

    def __init__(self, x: float = 0.0) -> None:
        self.x = x


class Exponential:
    """An engine that reads exp(x) t, and fails beyond ``limit``."""

    def __init__(self, limit: float) -> None:
        self.limit = limit
        self.failed = 0

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        x = float(scaled[0])
        if x > self.limit:
            self.failed += 1
            raise ConvergenceError("The step does not converge.")
        values = np.exp(x) * T[:, None]
        return [Prediction({"gauge": values}, {"gauge": values[:, :, None]}, cast(Trace, None)) for _ in runs]


@pytest.fixture
def stubs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.solve.residuals.rig_at", lambda rig, parameters, scaled: rig)


def test_a_failure_is_worse_than_a_start_with_a_large_misfit(stubs: None) -> None:
    # At the start every whitened residual is far above any fixed charge for a failure.
    engine = Exponential(limit=2.5)
    problem = Problem(
        [run_of()], {"gauge": ChannelNoise(np.array([1e-9]), 0.0, "test")}, cast(ParallelPredictor, engine)
    )
    fitted = problem.fit(cast(Any, Stub()), [X], start=np.array([-2.0]), max_evaluations=60)
    assert engine.failed > 0
    assert fitted.converged, fitted.message
    assert fitted.scaled[0] == pytest.approx(TRUTH, abs=1e-6)


class Blind(Exponential):
    """Sees nothing beyond ``limit``."""

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        x = float(scaled[0])
        self.failed += x > self.limit
        values = np.exp(x) * T[:, None] if x <= self.limit else np.full((len(T), 1), np.nan)
        return [Prediction({"gauge": values}, {"gauge": values[:, :, None]}, cast(Trace, None)) for _ in runs]

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        future.set_result(self.predict_all(rig, [run], [], np.array([rig.x]))[0])
        return future


def test_a_search_does_not_go_to_where_nothing_is_seen(stubs: None, monkeypatch: pytest.MonkeyPatch) -> None:
    engine = Blind(limit=2.5)
    noise = {"gauge": ChannelNoise(np.array([0.01]), np.zeros(1), "test")}
    problem = Problem([run_of()], noise, cast(ParallelPredictor, engine))
    fitted = problem.fit(cast(Any, Stub()), [X], start=np.array([-2.0]), max_evaluations=60)
    assert engine.failed > 0
    assert fitted.converged and fitted.scaled[0] == pytest.approx(TRUTH, abs=1e-3)
    monkeypatch.setattr("sysid.solve.residuals.rig_in", lambda rig, parameters, scaled, bag: Stub(float(scaled[0])))
    near, far, hidden = problem.glance(cast(Any, Stub()), [X], [np.array([x]) for x in (1.9, 1.0, 3.0)])
    assert near < far < hidden == np.inf


class Brittle:
    """An engine whose refined simulations fail."""

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        if refine > 1:
            future.set_exception(ConvergenceError("The step does not converge.", "Shorten solver.dt_s."))
        else:
            future.set_result(Prediction({"gauge": np.zeros((len(T), 1))}, {}, cast(Trace, None)))
        return future


def test_a_failed_refinement_says_what_it_was_for() -> None:
    said = r"error of mesh and time step, pull could not .* finer mesh: The step does not converge\. Shorten solver"
    with pytest.raises(ConvergenceError, match=said):
        discretisation(cast(ParallelPredictor, Brittle()), cast(Any, Stub()), [run_of("pull")])


class BrittleBelow(Exponential):
    """Refined simulations fail where x is above a limit."""

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        if refine > 1 and rig.x > 0.5 * TRUTH:
            future.set_exception(ConvergenceError("The step does not converge.", "Shorten solver.dt_s."))
        else:
            future.set_result(Prediction({"gauge": np.exp(rig.x) * T[:, None]}, {}, cast(Trace, None)))
        return future

    def submit_with_derivatives(
        self, rig: Any, run: Run, parameters: Any, scaled: np.ndarray, refine: int = 1, dt: float | None = None
    ) -> Future[Prediction]:
        return self.submit(Stub(float(scaled[0])), run, refine, dt)


def test_what_was_found_where_the_discretisation_error_cannot_be_measured_is_kept(
    stubs: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(discretisation_error, "rig_in", lambda rig, parameters, scaled, bag: Stub(float(scaled[0])))
    noise = {"gauge": ChannelNoise(np.array([0.01]), 0.0, "test")}
    with pytest.raises(Unmeasured, match=r"finer mesh: The step does not converge\. Shorten") as caught:
        fit_with_discretisation_error(
            cast(ParallelPredictor, BrittleBelow(np.inf)), [run_of()], noise, cast(Any, Stub()), [X], start=np.zeros(1)
        )
    found = caught.value.fitted
    assert found.scaled[0] == pytest.approx(TRUTH, abs=0.01)
    assert not found.converged and "discretisation error is not known" in found.message
    assert caught.value.last_problem.evaluate(cast(Any, Stub()), [X], found.scaled).chi2 == pytest.approx(found.chi2)


def test_a_fit_goes_on_with_what_was_found(monkeypatch: pytest.MonkeyPatch) -> None:
    nothing = cast(Any, None)
    last = Problem([], {}, nothing)
    found = Fitted([X], np.ones(1), nothing, np.ones(4), np.ones((4, 1)), [], [], nothing, 3, True, "")

    def broken(*given: Any, **more: Any) -> None:
        raise Unmeasured(ConvergenceError("The step does not converge.", "Shorten it."), last, found)

    monkeypatch.setattr("sysid.fit.fit.fit_with_discretisation_error", broken)
    monkeypatch.setattr("sysid.fit.fit.channel_noise", lambda rig, runs, held_out: {})
    look = _Look([], [], [], None)
    kept, problem, fitted = _fit_without_outliers(
        nothing, nothing, [X], look, np.zeros(1), runs=[], robust=True, bias=False, search=nothing
    )
    assert kept is look and problem is last and fitted is found
    assert not fitted.converged and "The step does not converge. Shorten it." in fitted.message


class Broken:
    """Reads exp(x) t, with some predictions and derivatives replaced."""

    def __init__(self, values: dict[int, float], slopes: dict[int, float]) -> None:
        self.values, self.slopes = values, slopes

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        values = np.exp(float(scaled[0])) * T[:, None]
        slopes = values[:, :, None].copy()
        values[list(self.values), 0] = list(self.values.values())
        slopes[list(self.slopes), 0, 0] = list(self.slopes.values())
        return [Prediction({"gauge": values}, {"gauge": slopes}, cast(Trace, None)) for _ in runs]


def problem_of(engine: Broken, rho: float = 0.0, run: Run | None = None) -> Problem:
    noise = {"gauge": ChannelNoise(np.array([1e-3]), rho, "test")}
    return Problem([run or run_of()], noise, cast(ParallelPredictor, engine))


@pytest.mark.parametrize("lost", [np.nan, np.inf, -np.inf])
def test_a_broken_derivative_is_not_taken_for_no_effect(stubs: None, lost: float) -> None:
    problem = problem_of(Broken({}, {7: lost}))
    with pytest.raises(ConvergenceError, match=r"run: predictions of the derivative of gauge by x are not numbers"):
        problem.evaluate(cast(Any, Stub()), [X], np.array([1.0]))


def test_an_infinite_prediction_is_no_point_out_of_sight(stubs: None) -> None:
    problem = problem_of(Broken({7: np.inf}, {}))
    with pytest.raises(ConvergenceError, match=r"run: predictions of gauge are not numbers"):
        problem.evaluate(cast(Any, Stub()), [X], np.array([1.0]))


@pytest.mark.parametrize("rho", [0.0, 0.6])
def test_out_of_sight_and_missing_readings_have_the_residual_s_own_derivative(stubs: None, rho: float) -> None:
    """By central differences, with white and with correlated noise."""
    readings = np.exp(TRUTH) * T[:, None]
    readings[[12, 25]] = np.nan
    run = Run("run", "", (), {}, (Measured("gauge", "markers", T, readings, ("u",)),), 1.0)
    problem = problem_of(Broken({6: np.nan, 12: np.nan}, {6: np.nan, 12: np.nan, 25: np.nan}), rho, run)
    at = [problem.evaluate(cast(Any, Stub()), [X], np.array([x])) for x in (1.0 - 1e-6, 1.0, 1.0 + 1e-6)]
    expected = (at[2].residual - at[0].residual) / 2e-6
    assert len(expected) == len(T) - 2
    np.testing.assert_allclose(at[1].jacobian[:, 0], expected, rtol=1e-8, atol=1e-4)
