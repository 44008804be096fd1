"""A fit that has ended is kept where Ctrl-C, a failure or the end of a worker process stops what follows it."""

from __future__ import annotations

import importlib
import os
import signal
import time
from concurrent.futures import Future
from typing import Any, cast

import numpy as np
import pytest
from readings import TRUTH, Readings, result_of, run_of

from sim_core.errors import ConvergenceError
from sim_core.rigs import with_parameters
from sysid.fit import FitOptions, fit
from sysid.fit import validation as held_out
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.predictor import Prediction
from sysid.solve.residuals import Problem

pytestmark = pytest.mark.usefixtures("declared")


class Walled(Readings):
    """It cannot be simulated where E is more than 1.05 times the truth."""

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        if parameters and scaled[0] > np.log(1.05 * TRUTH):
            raise ConvergenceError("The step does not converge.")
        return super().predict_all(rig, runs, parameters, scaled)


def test_a_better_point_that_cannot_be_searched_from_leaves_what_was_found(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The look along the intervals says that it is better beyond where it can be simulated."""
    met = []

    def profiled(problem: Problem, fitted: Any, sentences: list[str], *given: Any) -> Any:
        met.append(fitted.scaled + 0.2)
        return [], sentences, met[-1]

    monkeypatch.setattr(fit, "_profiled", profiled)
    result = result_of(Walled(), small_rig(), [run_of("press", "markers")], [])
    assert len(met) == 1 and not result.converged
    assert result.message == "a better fit that is known was not searched from. The step does not converge."
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)


def ending(error: BaseException, before: int = 0, plain: Any = None) -> Any:
    """Does as ``plain`` so many times, and then ends with an error."""
    left = [None] * before

    def called(*given: Any, **more: Any) -> Any:
        if not left:
            raise error
        left.pop()
        return plain(*given, **more)

    return called


ENDS = [KeyboardInterrupt(), ConvergenceError("It does not converge.")]
WORDS = ["interrupted", "It does not converge."]


@pytest.mark.parametrize(("error", "words"), list(zip(ENDS, WORDS, strict=True)), ids=["ctrl-c", "failed"])
def test_a_fit_that_is_not_repeated_to_its_end_is_kept(
    error: BaseException, words: str, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The discretisation error is measured first of a fit without mistakes, and first of one from where an interval
    ends."""
    rig, run = small_rig(), run_of("press", "markers")

    def fitted_with(**options: Any) -> fit.FitResult:
        chosen = FitOptions(nuisance=("none",), intervals="quadratic", **options)
        return fit.fit_runs(rig, [run], ["gel.E"], chosen, engine=cast(ParallelPredictor, Readings()))[0]

    plain = fit.fit_with_discretisation_error
    monkeypatch.setattr(fit, "without_outliers", lambda runs, *given: (list(runs), []))
    monkeypatch.setattr(fit, "worth_another_fit", lambda *given: True)
    monkeypatch.setattr(fit, "fit_with_discretisation_error", ending(error, 1, plain))
    looked = fitted_with(robust=True)
    assert "it was not repeated without its outliers" in looked.message
    monkeypatch.setattr(fit, "_profiled", lambda problem, fitted, findings, *given: ([], findings, fitted.scaled))
    monkeypatch.setattr(fit, "fit_with_discretisation_error", ending(error, 1, plain))
    further = fitted_with(robust=False)
    assert "a better fit that is known was not searched from" in further.message
    for result in (looked, further):
        assert not result.converged and words in result.message
        assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    monkeypatch.setattr(fit, "fit_with_discretisation_error", ending(error))
    with pytest.raises(type(error)):
        fitted_with(robust=True)


def test_a_fit_whose_intervals_cannot_be_looked_at_is_kept(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "_profiled", ending(ENDS[1]))
    result = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
    assert result.converged and result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    assert any("not looked at along the likelihood: It does not" in sentence for sentence in result.identifiability)


@pytest.mark.parametrize("place", ["scored", "not_from_rest"])
@pytest.mark.parametrize(
    ("error", "words"),
    [(ENDS[0], "interrupted."), (ENDS[1], WORDS[1]), (ValueError("no shape"), "ValueError: no shape")],
    ids=["ctrl-c", "failed", "defect"],
)
def test_a_fit_whose_held_out_recordings_are_not_all_predicted_is_kept(
    error: BaseException, words: str, place: str, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    kept = [run_of(name, "markers") for name in ("deep", "flat", "slow")]
    monkeypatch.setattr(held_out, place, ending(error, 1, getattr(held_out, place)))
    result = result_of(Readings(), small_rig(), [run_of("press", "markers")], kept)
    assert result.converged and result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    assert [(e.run, e.held_out) for e in result.errors] == [("press", False), ("deep", True)]
    (note,) = result.notes
    assert note.startswith(f"Held-out recordings flat, slow were not predicted: {words}")


def test_a_recording_that_fails_leaves_the_other_held_out_ones(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    plain = held_out.scored

    def scored(*given: Any) -> Any:
        if given[3].name == "deep":
            raise ValueError("no shape")
        return plain(*given)

    monkeypatch.setattr(held_out, "scored", scored)
    kept = [run_of(name, "markers") for name in ("deep", "flat")]
    result = result_of(Readings(), small_rig(), [run_of("press", "markers")], kept)
    assert [e.run for e in result.errors] == ["press", "flat"]
    assert result.notes == ["Held-out recordings deep were not predicted: ValueError: no shape"]


def test_ctrl_c_while_windows_are_looked_at_keeps_the_fit(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "not_from_rest", ending(KeyboardInterrupt()))
    result = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
    assert result.converged and result.notes == ["Whether windows begin at rest was not looked at: interrupted."]


class Gone(Readings):
    """Nothing can be simulated any more once something was fitted."""

    gone = False

    def submit(self, *given: Any, **more: Any) -> Future[Prediction]:
        if self.gone:
            raise ENDS[1]
        return super().submit(*given, **more)

    def submit_with_derivatives(self, *given: Any, **more: Any) -> Future[Prediction]:
        self.gone = True
        raise ENDS[1]

    def predict_all(self, *given: Any) -> list[Prediction]:
        if self.gone:
            raise ENDS[1]
        return super().predict_all(*given)


def test_a_fit_is_kept_whose_discretisation_error_cannot_be_measured_again(small_rig: Any) -> None:
    """Nothing that follows needs simulations, but for the held-out recording."""
    rig = with_parameters(small_rig(), {"gel.E_pa": 3.0 * TRUTH})
    result = result_of(Gone(), rig, [run_of("press", "markers")], [run_of("deep", "markers")])
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    assert not result.converged and "its discretisation error is not known. It does not converge" in result.message
    assert [(e.run, e.held_out) for e in result.errors] == [("press", False)]
    assert result.errors[0].before > 10.0 * result.errors[0].after
    assert result.notes == ["deep: could not be simulated: It does not converge."]


@pytest.mark.parametrize("part", ["sysid.fit.fit.rms_errors", "sysid.fit.fit.remarks"])
def test_ctrl_c_does_not_take_what_is_being_put_together(
    part: str, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A signal, as the keyboard sends it; afterwards it ends things again."""
    module, name = part.rsplit(".", 1)
    given = getattr(importlib.import_module(module), name)

    def pressed(*arguments: Any, **more: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return given(*arguments, **more)

    monkeypatch.setattr(part, pressed)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    try:
        try:
            result = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
        except KeyboardInterrupt:
            pytest.fail("the fit is lost")
        assert result.converged and result.estimates[0].value == pytest.approx(TRUTH, rel=0.05)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.parametrize("allowed", [1, 30])
def test_what_was_known_is_not_contradicted_by_a_fit_that_has_not_ended(
    allowed: int, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fit, "prior_data_conflicts", lambda fitted: {"gel.E_pa": "They contradict each other."})
    rig = with_parameters(small_rig(), {"gel.E_pa": 1.5 * TRUTH})
    options = FitOptions(nuisance=("none",), intervals="quadratic", robust=False, max_evaluations=allowed)
    result = fit.fit_runs(
        rig, [run_of("press", "markers")], ["gel.E"], options, engine=cast(ParallelPredictor, Readings())
    )[0]
    assert bool(result.contradicted) == result.converged == (allowed == 30)
