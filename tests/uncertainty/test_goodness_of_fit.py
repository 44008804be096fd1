"""More than noise in one quantity is reported, and offsets of end effectors are looked for elsewhere, only then."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sim_core.simulate import Trace
from sysid.fit import FitOptions
from sysid.fit.multistart import Evaluations, Searches
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import fit_parameters, with_bags
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.fit import FIT
from sysid.settings.solve import SOLVE
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem
from sysid.uncertainty.goodness_of_fit import misfit_by_quantity, unexplained, worst

T = np.linspace(0.0, 1.0, 200)
LOUD, SOFT = np.sin(6.0 * T), np.cos(6.0 * T)
SIGMA = 0.01
OWN = 0.1
OFFSET = "finger.offset_x_m"


class Folded:
    """Reads q^2 sin + tilt q cos of the offset q of the finger [0.2 mm]: data of q = -1 have another minimum at 1,
    which leaves more than noise with a tilt."""

    def __init__(self, tilt: float) -> None:
        self.tilt, self.glanced = tilt, 0

    def submit(self, rig: Any, run: Run) -> Future[Prediction]:
        self.glanced += 1
        future: Future[Prediction] = Future()
        q = rig.end_effectors["finger"].offset_x_m / 2e-4
        if q > 4.0:
            future.set_exception(ConvergenceError("The step does not converge."))
        else:
            future.set_result(Prediction({"gauge": self.read(q)}, {}, cast(Trace, None)))
        return future

    def read(self, q: float) -> np.ndarray:
        return np.asarray(q**2 * LOUD + self.tilt * q * SOFT)[:, None]

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        q = float(scaled[-1]) / 2e-4
        slopes = np.zeros((len(T), 1, len(scaled)))
        slopes[:, 0, -1] = (2.0 * q * LOUD + self.tilt * SOFT) / 2e-4
        return [Prediction({"gauge": self.read(q)}, {"gauge": slopes}, cast(Trace, None)) for _ in runs]


def problem(gauge: Folded) -> Problem:
    data = gauge.read(-1.0) + SIGMA * np.random.default_rng(2).standard_normal((len(T), 1))
    run = Run("press", "press", (), {}, (Measured("gauge", "markers", T, data, ("u",)),), 1.0)
    return Problem([run], {"gauge": ChannelNoise(np.array([SIGMA]), 0.0, "test")}, cast(ParallelPredictor, gauge))


def searched(rig: Any, gauge: Folded, **chosen: Any) -> tuple[Searches, Fitted]:
    parameters = fit_parameters(rig, ["gel.E", OFFSET])
    options = FitOptions(**chosen)
    search = Searches(rig, parameters, options, Evaluations(options))
    at = np.array([np.log(rig.bodies["gel"].material.E_pa), 1.6e-4])
    return search, search(problem(gauge), at)


def test_the_wrong_side_of_an_offset_is_left(small_rig: Any) -> None:
    search, found = searched(small_rig(), Folded(0.05))
    assert found.scaled[-1] == pytest.approx(-2e-4, abs=1e-6)
    assert found.misfit < 1.2
    (said,) = search.ends
    assert "other offsets of the end effectors" in said


def test_offsets_are_drawn_once_and_only_where_more_than_noise_is_left(small_rig: Any) -> None:
    plain = Folded(0.0)  # both sides fit as well
    search, found = searched(small_rig(), plain)
    assert found.scaled[-1] == pytest.approx(2e-4, abs=1e-6)
    assert plain.glanced == 0 and search.ends == []
    tilted = Folded(0.05)
    search, found = searched(small_rig(), tilted)
    search(problem(tilted), np.array([found.scaled[0], 2e-4]))
    assert tilted.glanced == FIT.offset_draws


def test_evaluations_that_are_allowed_end_the_searches_from_other_offsets(small_rig: Any) -> None:
    _, free = searched(small_rig(), Folded(0.05))
    search, found = searched(small_rig(), Folded(0.05), max_evaluations=3)
    assert found.limited and not found.converged and found.misfit > free.misfit
    assert search.ends == []


def test_an_interruption_while_offsets_are_compared_keeps_the_best(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def pressed(*given: Any) -> list[float]:
        raise KeyboardInterrupt

    monkeypatch.setattr(Problem, "glance", pressed)
    _, found = searched(small_rig(), Folded(0.05))
    assert found.interrupted and not found.converged
    assert found.scaled[-1] == pytest.approx(2e-4, rel=0.02)


def wrench(forces: float, torques: float, samples: int = 300) -> tuple[Problem, Fitted]:
    """Readings that are so many standard deviations of the noise off, against a model that reads nothing."""
    rng = np.random.default_rng(5)
    values = rng.standard_normal((samples, 6)) * np.repeat([0.2, 0.01], 3)
    values *= np.repeat([forces, torques], 3)
    t = np.linspace(0.0, 1.0, samples)
    run = Run("press", "press", (), {}, (Measured("cell", "wrench", t, values, tuple("abcdef")),), 1.0)
    noise = ChannelNoise(np.repeat([0.2, 0.01], 3), 0.0, "test")
    given = Prediction({"cell": np.zeros_like(values)}, {}, cast(Trace, None))
    return Problem([run], {"cell": noise}, cast(ParallelPredictor, None)), Fitted(
        [], np.zeros(0), cast(Any, None), np.zeros(0), np.zeros((0, 0)), [], [given], cast(Any, None), 1, True, ""
    )


def with_discretisation_error(times: float, rig: Any) -> tuple[Problem, Fitted]:
    """Readings that miss by so many times what one refinement shows, the same all the time."""
    shape = np.full((len(T), 1), OWN)
    data = times * shape + SIGMA * np.random.default_rng(3).standard_normal(shape.shape)
    run = Run("press", "press", (), {}, (Measured("gauge", "markers", T, data, ("u",)),), 1.0)
    noise = {"gauge": ChannelNoise(np.array([SIGMA]), 0.0, "test")}
    problem = Problem([run], noise, cast(ParallelPredictor, None), [ErrorShape("mesh", ({"gauge": shape},))])
    given = [Prediction({"gauge": np.zeros_like(shape)}, {}, cast(Trace, None))]
    return problem, problem.compare(given, rig, [], np.zeros(0))


@pytest.mark.parametrize("times", [1.0, 1.9])
def test_what_may_be_the_discretisation_error_is_not_spoken_of(small_rig: Any, times: float) -> None:
    problem, fitted = with_discretisation_error(times, small_rig())
    assert worst(problem, fitted) < 1.0 and unexplained(problem, fitted) == []


def test_no_more_than_twice_of_what_a_refinement_shows_is_taken_for_the_discretisation_error(small_rig: Any) -> None:
    """The coefficients take up all of it, and what is more than twice is left, over the noise and the rough part."""
    problem, fitted = with_discretisation_error(4.0, small_rig())
    taken = problem.corrected(fitted, 0, problem.runs[0].measured[0])
    assert taken == pytest.approx(4.0 * OWN * np.ones_like(taken), rel=0.05)
    left = 2.0 * OWN / np.hypot(SIGMA, SOLVE.rough_error_share * OWN)
    (found,) = misfit_by_quantity(problem, fitted)
    assert np.sqrt(found.misfit) == pytest.approx(left, rel=0.05)
    (said,) = unexplained(problem, fitted)
    assert f"{np.sqrt(found.misfit):.2g} times the noise in the position of gauge" in said
    assert "Twice the error of mesh" in said


def test_that_a_recording_may_be_of_another_rig_is_said_where_it_is_not_explained() -> None:
    problem, fitted = wrench(1.0, 3.0)
    problem.runs = [replace(problem.runs[0], unlike="27 markers, the rig 33."), *problem.runs[1:]]
    said = unexplained(problem, fitted)
    assert said[0].startswith("The rig does not explain") and said[1] == "press: 27 markers, the rig 33."
    problem, fitted = wrench(1.0, 1.0)
    problem.runs = [replace(problem.runs[0], unlike="27 markers, the rig 33.")]
    assert unexplained(problem, fitted) == []


def test_each_quantity_is_judged_by_itself() -> None:
    problem = wrench(1.0, 3.0)
    forces, torques = misfit_by_quantity(*problem)
    assert (forces.quantity, torques.quantity) == ("force", "torque")
    assert forces.misfit == pytest.approx(1.0, abs=0.15) and torques.misfit == pytest.approx(9.0, rel=0.15)
    assert worst(*problem) == torques.misfit
    (said,) = unexplained(*problem)
    assert f"{np.sqrt(torques.misfit):.2g} times the noise in the torque of cell." in said and "force" not in said


def test_intervals_are_spoken_of_where_something_was_fitted(small_rig: Any) -> None:
    problem_, plain = wrench(1.0, 3.0)
    (nothing,) = unexplained(problem_, plain)
    (said,) = unexplained(problem_, replace(plain, parameters=fit_parameters(small_rig(), ["gel.E"])))
    assert "Intervals" in said and said.startswith(nothing) and "Intervals" not in nothing


def test_noise_alone_says_nothing_however_few_its_readings() -> None:
    assert unexplained(*wrench(1.0, 1.1)) == []
    for samples in (2, 6, 7, 10, 20):
        assert unexplained(*wrench(1.0, 1.1, samples)) == []


def test_readings_that_are_few_in_each_recording_are_judged_together() -> None:
    alone, plain = wrench(1.0, 3.0, samples=4)
    both = Problem(
        [replace(alone.runs[0], name=f"at {k}") for k in range(9)], alone.noise, cast(ParallelPredictor, None)
    )
    (said,) = unexplained(both, replace(plain, predictions=plain.predictions * 9))
    assert said.endswith("times the noise in the torque of cell.")


def test_a_minimum_that_is_better_in_one_quantity_is_kept_however_many_others_there_are(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """900 columns of markers next to one reading that tells the two sides apart: the sum falls by less than 2 %."""
    plain = Folded.predict_all, Folded.submit
    rng = np.random.default_rng(3)
    many = SIGMA * rng.standard_normal((len(T), 900))

    def diluted(one: Problem) -> Problem:
        run = one.runs[0]
        others = Measured("others", "markers", T, many, tuple(f"u{k}" for k in range(900)))
        noise = {**one.noise, "others": ChannelNoise(np.full(900, SIGMA), 0.0, "test")}
        return Problem([replace(run, measured=(*run.measured, others))], noise, one.engine)

    def with_others(found: Prediction, slopes: bool) -> Prediction:
        extra = {"others": np.zeros((len(T), 900, 2))} if slopes else {}
        return replace(
            found, values={**found.values, "others": np.zeros_like(many)}, derivatives={**found.derivatives, **extra}
        )

    def submitted(self: Folded, rig: Any, run: Run) -> Future[Prediction]:
        given: Future[Prediction] = Future()
        try:
            given.set_result(with_others(plain[1](self, rig, run).result(), False))
        except ConvergenceError as error:
            given.set_exception(error)
        return given

    monkeypatch.setattr(Folded, "submit", submitted)
    monkeypatch.setattr(
        Folded, "predict_all", lambda self, *given: [with_others(p, True) for p in plain[0](self, *given)]
    )
    rig, options = small_rig(), FitOptions()
    search = Searches(rig, fit_parameters(rig, ["gel.E", OFFSET]), options, Evaluations(options))
    found = search(diluted(problem(Folded(0.02))), np.array([np.log(1e5), 1.6e-4]))
    assert found.misfit < 1.1 and found.scaled[-1] == pytest.approx(-2e-4, abs=1e-6)
    assert len(search.ends) == 1


def test_offsets_that_each_recording_has_for_itself_are_looked_for_too(small_rig: Any) -> None:
    rig, options = small_rig(), FitOptions()
    parameters = with_bags(fit_parameters(rig, ["gel.E", OFFSET]), [OFFSET], ["one", "two"], rig)
    assert Searches(rig, parameters, options, Evaluations(options))._offsets == [1, 2]


def test_what_is_left_in_several_recordings_is_reported_of_the_worst() -> None:
    (problem_, fitted) = wrench(1.0, 3.0)
    worse, _ = wrench(1.0, 5.0)
    runs = [problem_.runs[0], replace(worse.runs[0], name="second")]
    both = Problem(runs, problem_.noise, cast(ParallelPredictor, None))
    (said,) = unexplained(both, replace(fitted, predictions=fitted.predictions * 2))
    assert "in the torque of cell (second)" in said and "(press)" not in said
