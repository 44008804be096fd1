"""Searches from several starts, and restarts, of a gauge whose misfit has two minima that are known."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.simulate import Trace
from sysid.fit import FitOptions
from sysid.fit import multistart as starts
from sysid.fit.multistart import Evaluations, Searches, Step
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import FitParameter, fit_parameters
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 200)
LOUD, SOFT = np.sin(6.0 * T), np.cos(6.0 * T)
SIGMA = 0.01
MIDDLE = 12.0


class Gauge:
    """Reads (s - 12)^2 sin + tilt (s - 12) cos, s = log(E): minima of the misfit at 11 and at 13 for data of either,
    equally deep without a tilt."""

    def __init__(self, tilt: float, broken_from: float = np.inf, hidden_from: float = np.inf) -> None:
        self.tilt, self.broken_from, self.hidden_from = tilt, broken_from, hidden_from

    def read(self, s: float) -> np.ndarray:
        """Every twelfth reading is out of sight from ``hidden_from`` on."""
        read = (s - MIDDLE) ** 2 * LOUD + self.tilt * (s - MIDDLE) * SOFT
        return np.where((s >= self.hidden_from) & (np.arange(len(T)) % 12 == 0), np.nan, read)[:, None]

    def slope(self, s: float) -> np.ndarray:
        return np.asarray(2.0 * (s - MIDDLE) * LOUD + self.tilt * SOFT)[:, None, None]

    def submit(self, rig: Any, run: Run) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        s = float(np.log(rig.bodies["gel"].material.E_pa))
        if s > self.broken_from:
            future.set_exception(ConvergenceError("The step does not converge."))
        else:
            future.set_result(Prediction({"gauge": self.read(s)}, {}, cast(Trace, None)))
        return future

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        s = float(scaled[0])
        return [Prediction({"gauge": self.read(s)}, {"gauge": self.slope(s)}, cast(Trace, None)) for _ in runs]


def problem(gauge: Gauge, off: float = 0.0) -> Problem:
    """Data of s = 11; ``off``: of a curve that no value reads."""
    rng = np.random.default_rng(2)
    noise = SIGMA * rng.standard_normal((len(T), 1))
    data = gauge.read(11.0) + noise + off * np.sin(40.0 * T)[:, None]
    run = Run("press", "press", (), {}, (Measured("gauge", "markers", T, data, ("u",)),), 1.0)
    return Problem([run], {"gauge": ChannelNoise(np.array([SIGMA]), 0.0, "test")}, cast(ParallelPredictor, gauge))


def searches(rig: Any, evaluations: Evaluations | None = None, **chosen: Any) -> tuple[Searches, list[FitParameter]]:
    parameters = fit_parameters(rig, ["gel.E"])
    options = FitOptions(**chosen)
    return Searches(rig, parameters, options, evaluations or Evaluations(options)), parameters


def test_a_search_from_the_wrong_side_ends_there_and_one_of_several_starts_does_not(small_rig: Any) -> None:
    wrong = np.array([12.8])
    alone, _ = searches(small_rig())
    assert alone(problem(Gauge(0.05)), wrong).scaled[0] == pytest.approx(13.0, abs=0.05)
    assert alone.ends == []
    several, _ = searches(small_rig(), starts=4)
    found = several(problem(Gauge(0.05)), wrong)
    assert found.scaled[0] == pytest.approx(11.0, abs=0.002)
    said, *ways = several.ends
    assert said.startswith("Of searches from 4 starts") and not said.startswith("Of searches from 4 starts 4")
    assert len(ways) == 4 and ways[0].startswith(f"Search 1 began at gel.E_pa {np.exp(12.8):.4g} Pa and ended at")


def test_progress_gives_the_misfit_next_to_what_the_noise_alone_makes(small_rig: Any) -> None:
    """200 readings, each off by three standard deviations of the noise: a mean square of nine."""
    rig = small_rig()
    off = np.full(len(T), 3.0)
    fitted = Fitted(
        fit_parameters(rig, ["gel.E"]), np.array([MIDDLE]), rig, off, np.zeros((len(T), 1)), [(0, "gauge", T)], [], rig,
        1, True, "",
    )  # fmt: skip
    reported: list[str] = []
    Evaluations(FitOptions(), reported.append)(fitted)
    assert reported == ["evaluation 1, misfit 9 (up to 1: noise and discretisation error)"]


def test_starts_are_those_of_many_draws_that_fit_best_and_can_be_simulated(small_rig: Any) -> None:
    gauge = Gauge(0.05, broken_from=13.5)
    several, parameters = searches(small_rig(), starts=5)
    best_of_16 = several._drawn(problem(gauge), np.array([12.8]), cast(Fitted, None))
    misfits = problem(gauge).glance(small_rig(), parameters, best_of_16)
    assert len(misfits) == 4 and misfits == sorted(misfits) and misfits[-1] < np.inf
    others, _ = searches(small_rig(), starts=17)
    best_of_64 = others._drawn(problem(gauge), np.array([12.8]), cast(Fitted, None))
    assert len(best_of_64) == 16
    assert np.mean(problem(gauge).glance(small_rig(), parameters, best_of_64[:4])) < np.mean(misfits)
    (far,) = problem(gauge).glance(small_rig(), parameters, [np.array([13.6])])
    assert far == np.inf
    expected = problem(gauge).evaluate(small_rig(), parameters, best_of_16[0]).chi2
    assert misfits[0] == pytest.approx(expected)


def test_a_start_is_no_better_for_what_it_hides(small_rig: Any) -> None:
    """Of two that miss every reading by the same the one counts as much as the other, and of two outcomes as well."""
    gauge = Gauge(0.0, hidden_from=12.0)
    _, parameters = searches(small_rig())
    places = [np.array([MIDDLE - 0.5]), np.array([MIDDLE + 0.5])]
    seen, hiding = problem(gauge).glance(small_rig(), parameters, places)
    assert hiding == pytest.approx(seen, rel=0.05)
    whole, part = (problem(gauge).evaluate(small_rig(), parameters, at) for at in places)
    assert part.chi2 < 0.95 * whole.chi2
    better = replace(part, residual=1.02 * part.residual)
    assert "2 ended equally well" not in starts._said(places, [whole, better], 0)[0]
    assert starts._said(places, [better, whole], 0)[0].startswith("Of searches from 2 starts 1 ended")


def test_of_searches_that_end_equally_well_the_rigs_is_kept(small_rig: Any) -> None:
    several, _ = searches(small_rig(), starts=5)
    assert several(problem(Gauge(0.0)), np.array([12.8])).scaled[0] == pytest.approx(13.0, abs=0.01)


def test_a_search_that_ends_as_well_but_for_what_it_hides_does_not_take_its_place(small_rig: Any) -> None:
    several, _ = searches(small_rig(), starts=5)
    assert several(problem(Gauge(0.0, hidden_from=12.5)), np.array([11.2])).scaled[0] == pytest.approx(11.0, abs=0.01)
    assert "5 ended equally well" in several.ends[0]


def test_values_that_fit_as_well_are_reported(small_rig: Any) -> None:
    several, _ = searches(small_rig(), starts=4)
    several(problem(Gauge(0.0)), np.array([12.8]))
    assert "4 ended equally well. They ended in different places" in several.ends[0]


def test_other_starts_are_tried_once_and_are_the_same_for_a_seed(small_rig: Any) -> None:
    ends = []
    for _ in range(2):
        reported: list[Step] = []
        several, _ = searches(small_rig(), Evaluations(FitOptions(starts=3), on_step=reported.append), starts=3)
        first = several(problem(Gauge(0.05)), np.array([12.8]))
        made = len(reported)
        again = several(problem(Gauge(0.05)), first.scaled)
        assert len(reported) <= made + 3, "it only stays where it is"
        ends.append((first.scaled[0], again.scaled[0]))
    assert ends[0] == ends[1]


def test_a_restart_that_brings_nothing_is_the_last(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a law is missing the misfit stays, in each of the rounds of a fit; only the first asks for more."""
    fits: list[float] = []
    plain = Problem.fit

    def counted(self: Problem, *given: Any, **more: Any) -> Fitted:
        found = plain(self, *given, **more)
        fits.append(found.misfit)
        return found

    monkeypatch.setattr(Problem, "fit", counted)
    search, _ = searches(small_rig())
    wrong = problem(Gauge(0.05), off=0.2)
    first = search(wrong, np.array([11.2]))
    assert len(fits) == 2 and min(fits) > UNCERTAINTY.good_misfit
    search(wrong, first.scaled)
    assert len(fits) == 3


def with_discretisation_error(wrong: Problem) -> Problem:
    """The same with an error of mesh and time step that is none."""
    none = ErrorShape("mesh", ({"gauge": np.zeros((len(T), 1))},))
    return Problem(wrong.runs, wrong.noise, wrong.engine, [none])


def test_what_is_left_far_from_where_the_discretisation_error_was_measured_is_not_searched_on(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = 0
    plain = Problem.fit

    def counted(self: Problem, *given: Any, **more: Any) -> Fitted:
        nonlocal calls
        calls += 1
        return plain(self, *given, **more)

    monkeypatch.setattr(Problem, "fit", counted)
    search, _ = searches(small_rig())
    wrong = with_discretisation_error(problem(Gauge(0.05), off=0.2))
    first = search(wrong, np.array([11.6]))
    assert first.elsewhere and first.misfit > UNCERTAINTY.good_misfit and first.chi2 < 0.5 * first.began
    assert calls == 1
    again = search(wrong, first.scaled)
    assert not again.elsewhere
    assert calls == 3, "and a restart, now that it stands where the error was measured"
    right, _ = searches(small_rig())
    assert not right(with_discretisation_error(problem(Gauge(0.05))), np.array([11.6])).elsewhere


@pytest.mark.parametrize("chosen", [1, 3])
def test_searches_that_are_compared_are_not_halted(
    chosen: int, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search that is halted wants the error measured again, wherever it ended."""
    monkeypatch.setattr(starts, "_comes_on_slowly", lambda course: len(course) > 1)
    search, _ = searches(small_rig(), starts=chosen)
    found = search(with_discretisation_error(problem(Gauge(0.05))), np.array([11.6]))
    assert found.elsewhere == (chosen == 1)
    assert found.converged == (chosen > 1)


@pytest.mark.parametrize(
    ("course", "slow"),
    [
        ([100.0, 40.0, 39.0, 38.0, 37.0], True),
        ([100.0, 40.0, 39.0, 38.0], False),
        ([100.0, 60.0, 59.0, 58.0, 57.0], False),
        ([100.0, 40.0, 39.0, 38.0, 20.0], False),
        ([1.0, 0.3, 0.3, 0.3, 0.3], True),
    ],
)
def test_a_search_comes_on_slowly(course: list[float], slow: bool) -> None:
    assert starts._comes_on_slowly(course) == slow


def test_evaluations_that_are_used_up_leave_no_draws_of_other_starts(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Any] = []
    plain = Gauge.submit

    def submit(self: Gauge, *given: Any) -> Future[Prediction]:
        drawn.append(given)
        return plain(self, *given)

    monkeypatch.setattr(Gauge, "submit", submit)
    several, _ = searches(small_rig(), starts=4, max_evaluations=1)
    assert several(problem(Gauge(0.05)), np.array([12.8])).limited
    assert not drawn
    several, _ = searches(small_rig(), starts=4)
    several(problem(Gauge(0.05)), np.array([12.8]))
    assert drawn


@pytest.mark.parametrize("later", [1, 2], ids=["its first evaluation", "its second"])
def test_an_interruption_of_a_later_search_keeps_the_best_and_ends_the_fit(
    later: int, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, calls = Gauge.predict_all, []

    def pressed(self: Gauge, *given: Any) -> list[Prediction]:
        calls.append(given)
        if len(calls) == stop:
            raise KeyboardInterrupt
        return plain(self, *given)

    stop = 10**9
    monkeypatch.setattr(Gauge, "predict_all", pressed)
    alone, _ = searches(small_rig())
    best = alone(problem(Gauge(0.05)), np.array([11.2]))
    stop = 2 * len(calls) + later
    several, _ = searches(small_rig(), starts=4)
    found = several(problem(Gauge(0.05)), np.array([11.2]))
    assert len(calls) == stop, "nothing is searched any more"
    assert found.interrupted and not found.converged
    assert found.scaled[0] == best.scaled[0]
    assert not any("could not be simulated" in sentence for sentence in several.ends)


@pytest.mark.parametrize(
    "chosen",
    [
        {"intervals": "bogus"},
        {"per_bag": "friction"},
        {"nuisance": "all"},
        {"nuisance": ["al"]},
        {"starts": 2.5},
        {"starts": 0},
        {"starts": True},
        {"max_evaluations": 0},
        {"seed": -1},
    ],
)
def test_choices_that_mean_nothing_are_refused(chosen: dict[str, Any]) -> None:
    with pytest.raises(ConfigError):
        FitOptions(**chosen)


def test_more_evaluations_than_are_allowed_are_a_limit_too(small_rig: Any) -> None:
    evaluations = Evaluations(FitOptions(max_evaluations=2))
    parameters = fit_parameters(small_rig(), ["gel.E"])
    fitted = problem(Gauge(0.05)).evaluate(small_rig(), parameters, np.array([11.6]))
    for _ in range(3):
        evaluations(fitted)
    assert evaluations.left < 0 and evaluations.limit(fitted).limited
