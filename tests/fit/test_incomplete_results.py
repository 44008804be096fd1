"""Fits of which a part is missing: a held-out recording that fails, points that are predicted out of sight."""

from __future__ import annotations

import importlib
import json
import os
import signal
import time
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConfigError, ConvergenceError
from sim_core.rigs import with_parameters
from sim_core.simulate import Trace
from sysid.fit import FitOptions, fit, held_out, starts
from sysid.fit.engine import Prediction
from sysid.fit.noise import ChannelNoise, channel_noise
from sysid.fit.options import Intervals
from sysid.fit.parameters import fit_parameters
from sysid.fit.pool import PooledEngine
from sysid.fit.problem import Problem
from sysid.fit.profiler import Profiler
from sysid.fit.runs import Measured, Run
from sysid.fit.starts import Evaluations, Searches, Step
from sysid.report import write_fit_report

T = np.linspace(0.0, 1.0, 60)
TRUTH = 1.5e5


def column(young: float) -> np.ndarray:
    return np.log(young) * np.sin(6.0 * T)[:, None]


class Readings:
    """An engine that reads log(E) of the gel; ``broken`` runs fail, ``hidden`` channels are out of sight from their
    sample ``begins`` on."""

    def __init__(self, broken: str = "", hidden: str = "", begins: int = 0) -> None:
        self.broken, self.hidden, self.begins = broken, hidden, begins

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        future.set_result(self._predict(run, rig.bodies["gel"].material.E_pa, 0))
        return future

    def submit_with_derivatives(
        self, rig: Any, run: Run, parameters: Any, scaled: np.ndarray, refine: int = 1, dt: float | None = None
    ) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        future.set_result(self._predict(run, float(np.exp(scaled[0])), len(parameters)))
        return future

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        if any(run.name == self.broken for run in runs):
            raise ConvergenceError("The step does not converge.", "Shorten solver.dt_s.")
        young = float(np.exp(scaled[0])) if parameters else rig.bodies["gel"].material.E_pa
        return [self._predict(run, young, len(parameters)) for run in runs]

    def _predict(self, run: Run, young: float, p: int) -> Prediction:
        values = {m.channel: column(young) for m in run.measured}
        slopes = {c: np.repeat(np.sin(6.0 * T)[:, None, None], p, axis=2) for c in values}
        if self.hidden in values:
            values[self.hidden][self.begins :] = np.nan
        return Prediction(values, slopes, cast(Trace, None))


def run_of(name: str, *channels: str) -> Run:
    rng = np.random.default_rng(3)
    measured = tuple(
        Measured(
            c,
            "tracks" if c == "side" else "markers",
            T,
            column(TRUTH) + 0.01 * rng.standard_normal((len(T), 1)),
            ("u",),
        )
        for c in channels
    )
    return Run(name, name, (), {}, measured, 1.0)


def result_of(engine: Readings, rig: Any, runs: list[Run], held_out: list[Run]) -> fit.FitResult:
    options = FitOptions(nuisance=("none",), intervals="quadratic", robust=False)
    return fit.fit_runs(rig, runs, ["gel.E"], options, held_out=held_out, engine=cast(PooledEngine, engine))[0]


@pytest.fixture(autouse=True)
def declared(monkeypatch: pytest.MonkeyPatch) -> None:
    noise = ChannelNoise(np.array([0.01]), 0.0, "test")
    monkeypatch.setattr(
        fit,
        "channel_noise",
        lambda rig, runs, held_out=(): {m.channel: noise for r in (*runs, *held_out) for m in r.measured},
    )
    monkeypatch.setattr(fit, "provenance", lambda *given: {})


def test_a_held_out_recording_that_fails_does_not_take_the_fit_with_it(small_rig: Any) -> None:
    kept = [run_of("deep", "markers"), run_of("shallow", "markers")]
    result = result_of(Readings(broken="deep"), small_rig(), [run_of("press", "markers")], kept)
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.05)
    assert [(e.run, e.held_out) for e in result.errors] == [("press", False), ("shallow", True)]
    assert result.notes == ["deep: could not be simulated: The step does not converge. Shorten solver.dt_s."]


def test_a_held_out_recording_does_not_change_the_fit(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is a hundred times noisier."""
    monkeypatch.setattr(fit, "channel_noise", channel_noise)
    there, other = run_of("press", "side"), run_of("noisy", "side")
    (m,) = other.measured
    noisy = m.values + np.random.default_rng(4).standard_normal(m.values.shape)
    other = replace(other, measured=(replace(m, values=noisy),))
    alone, beside = (result_of(Readings(), small_rig(), [there], kept) for kept in ([], [other]))
    assert beside.estimates == alone.estimates and beside.noise == alone.noise


def test_a_channel_that_is_predicted_out_of_sight_is_noted(small_rig: Any, tmp_path: Path) -> None:
    result = result_of(Readings(hidden="side"), small_rig(), [run_of("press", "markers", "side")], [])
    assert [e.channel for e in result.errors] == ["markers"]
    assert len(result.notes) == 1 and result.notes[0].startswith("press: side: the simulated points are out of sight")
    result.write(tmp_path / "fit.json")
    assert json.loads((tmp_path / "fit.json").read_text())["errors"][0]["after"] < 0.02
    assert "press" in result.table()
    assert write_fit_report(result, tmp_path / "report.html").stat().st_size > 0


def test_readings_that_are_predicted_out_of_sight_are_not_counted_but_told(small_rig: Any) -> None:
    """As if they had not been recorded."""
    run = run_of("press", "side")
    (m,) = run.measured
    half = len(T) // 2
    blind = result_of(Readings(hidden="side", begins=half), small_rig(), [run], [])
    short = replace(run, measured=(replace(m, values=np.where(np.arange(len(T))[:, None] < half, m.values, np.nan)),))
    alone = result_of(Readings(), small_rig(), [short], [])
    assert blind.misfit == pytest.approx(alone.misfit) and blind.reduced_chi2 == pytest.approx(alone.reduced_chi2)
    assert blind.estimates[0].sd == pytest.approx(alone.estimates[0].sd)
    (note,) = blind.notes
    assert note.startswith("press: side: 50 % of the readings are of points that the fitted rig has out of sight")
    pressed = run_of("press", "markers")
    (late,) = result_of(Readings(hidden="markers", begins=half), small_rig(), [pressed], []).notes
    assert late.startswith("press: markers: 50 % of the readings are of instants before or after the poses")


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


ENDS = [KeyboardInterrupt(), ConvergenceError("It does not converge."), BrokenProcessPool("abruptly")]
WORDS = ["interrupted", "It does not converge.", "A process that simulates has ended"]


@pytest.mark.parametrize(("error", "words"), list(zip(ENDS, WORDS, strict=True)), ids=["ctrl-c", "failed", "worker"])
def test_a_fit_that_is_not_repeated_to_its_end_is_kept(
    error: BaseException, words: str, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The own error is measured first of a fit without mistakes, and first of one from where an interval ends."""
    rig, run = small_rig(), run_of("press", "markers")

    def fitted_with(**options: Any) -> fit.FitResult:
        chosen = FitOptions(nuisance=("none",), intervals="quadratic", **options)
        return fit.fit_runs(rig, [run], ["gel.E"], chosen, engine=cast(PooledEngine, Readings()))[0]

    plain = fit.fit_beside_own_error
    monkeypatch.setattr(fit, "without_outliers", lambda runs, *given: (list(runs), []))
    monkeypatch.setattr(fit, "not_looked_for", lambda *given: [])
    monkeypatch.setattr(fit, "worth_another_fit", lambda *given: True)
    monkeypatch.setattr(fit, "fit_beside_own_error", ending(error, 1, plain))
    looked = fitted_with(robust=True)
    assert "it was not repeated without the readings that are mistakes beside it" in looked.message
    monkeypatch.setattr(fit, "_profiled", lambda problem, fitted, findings, *given: ([], findings, fitted.scaled))
    monkeypatch.setattr(fit, "fit_beside_own_error", ending(error, 1, plain))
    further = fitted_with(robust=False)
    assert "a better fit that is known was not searched from" in further.message
    for result in (looked, further):
        assert not result.converged and words in result.message
        assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    monkeypatch.setattr(fit, "fit_beside_own_error", ending(error))
    with pytest.raises(type(error)):
        fitted_with(robust=True)


def test_a_fit_whose_intervals_cannot_be_looked_at_is_kept(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fit, "_profiled", ending(BrokenProcessPool("abruptly")))
    result = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
    assert result.converged and result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    assert any("not looked at along the likelihood: A process" in sentence for sentence in result.identifiability)


@pytest.mark.parametrize("place", ["scored", "not_from_rest"])
@pytest.mark.parametrize(
    ("error", "words"),
    [(ENDS[0], "interrupted."), (ENDS[2], WORDS[2]), (ValueError("no shape"), "ValueError: no shape")],
    ids=["ctrl-c", "worker", "defect"],
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
    """Its workers end once something was fitted: nothing is predicted any more."""

    gone = False

    def submit(self, *given: Any, **more: Any) -> Future[Prediction]:
        if self.gone:
            raise BrokenProcessPool("abruptly")
        return super().submit(*given, **more)

    def submit_with_derivatives(self, *given: Any, **more: Any) -> Future[Prediction]:
        self.gone = True
        raise BrokenProcessPool("abruptly")

    def predict_all(self, *given: Any) -> list[Prediction]:
        if self.gone:
            raise BrokenProcessPool("abruptly")
        return super().predict_all(*given)


def test_a_fit_is_kept_whose_workers_end_where_its_own_error_is_measured_again(small_rig: Any) -> None:
    """Nothing that follows needs them, but for the held-out recording."""
    rig = with_parameters(small_rig(), {"gel.E_pa": 3.0 * TRUTH})
    result = result_of(Gone(), rig, [run_of("press", "markers")], [run_of("deep", "markers")])
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    assert not result.converged and "its own error is not known. A process that simulates" in result.message
    assert [(e.run, e.held_out) for e in result.errors] == [("press", False)]
    assert result.errors[0].before > 10.0 * result.errors[0].after
    assert any(note.startswith("Held-out recordings deep were not predicted: A process") for note in result.notes)


class Bent(Readings):
    """It reads the more, the further log(E) is from that of the truth on either side."""

    def _predict(self, run: Run, young: float, p: int) -> Prediction:
        away = float(np.log(young / TRUTH))
        values = (np.log(TRUTH) + 1.0 + abs(away)) * np.sin(6.0 * T)[:, None]
        slopes = np.repeat(np.copysign(1.0, away) * np.sin(6.0 * T)[:, None, None], p, axis=2)
        return Prediction(
            {m.channel: values for m in run.measured}, {m.channel: slopes for m in run.measured}, cast(Trace, None)
        )


def test_a_search_that_ends_at_a_kink_is_noted(small_rig: Any) -> None:
    """Readings are lower than any value of E explains, so the best is where the derivative jumps."""
    result = result_of(Bent(), small_rig(), [run_of("press", "markers")], [])
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.01)
    assert any("stands at a kink" in note for note in result.notes) and "stands at a kink" in result.table()
    smooth = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
    assert not any("kink" in note for note in smooth.notes)


def test_a_restart_that_cannot_be_simulated_is_left_out(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, calls = Problem.fit, []

    def once(problem: Problem, *given: Any, **more: Any) -> Any:
        calls.append(given)
        if len(calls) > 1:
            raise ConvergenceError("The step does not converge.")
        return plain(problem, *given, **more)

    monkeypatch.setattr(Problem, "fit", once)
    monkeypatch.setattr(starts, "GOOD_MISFIT", 0.0)
    parameters = fit_parameters(small_rig(), ["gel.E"])
    noise = {"markers": ChannelNoise(np.array([0.01]), 0.0, "test")}
    problem = Problem([run_of("press", "markers")], noise, cast(PooledEngine, Readings()))
    evaluations = Evaluations(FitOptions())
    found = Searches(small_rig(), parameters, FitOptions(), evaluations)(problem, np.array([11.0]))
    assert len(calls) == 1 + starts.MOST_RESTARTS
    assert evaluations.done == found.evaluations + starts.MOST_RESTARTS, "each has cost an evaluation"
    assert np.exp(found.scaled[0]) == pytest.approx(TRUTH, rel=0.05)


@pytest.mark.parametrize("intervals", ["checked", "profiled"])
def test_a_search_that_ended_too_early_goes_on_from_the_better_fit_that_intervals_show(
    intervals: Intervals, small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first search calls its start, which is 1 % off, the best."""
    plain, calls = Problem.fit, 0

    def early(problem: Problem, rig: Any, parameters: Any, start: Any, *given: Any, **more: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == 1:
            return problem.evaluate(rig, parameters, start)
        return plain(problem, rig, parameters, start, *given, **more)

    monkeypatch.setattr(Problem, "fit", early)
    monkeypatch.setattr(starts, "GOOD_MISFIT", 1e9)
    options = FitOptions(nuisance=("none",), intervals=intervals, robust=False)
    rig = with_parameters(small_rig(), {"gel.E_pa": 1.01 * TRUTH})
    shares: list[float] = []
    result, _ = fit.fit_runs(
        rig, [run_of("press", "markers")], ["gel.E"], options, engine=cast(PooledEngine, Readings()),
        on_progress=lambda share, text: shares.append(share),
    )  # fmt: skip
    assert shares == sorted(shares)
    assert result.estimates[0].value == pytest.approx(TRUTH, rel=0.004) and result.converged
    assert not any("too early" in sentence for sentence in result.identifiability)


def test_a_search_that_ends_too_early_each_time_has_not_converged(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        Problem, "fit", lambda problem, rig, parameters, start, *_, **__: problem.evaluate(rig, parameters, start)
    )
    monkeypatch.setattr(Profiler, "better", property(lambda profiler: profiler._best.scaled + 1e-4))
    rig = with_parameters(small_rig(), {"gel.E_pa": 1.01 * TRUTH})
    options = FitOptions(nuisance=("none",), robust=False)
    runs, engine = [run_of("press", "markers")], cast(PooledEngine, Readings())
    result, _ = fit.fit_runs(rig, runs, ["gel.E"], options, engine=engine)
    assert not result.converged and "a better fit is known" in result.message
    assert "did not converge" in result.table()


class Counted(Readings):
    """Counts the evaluations with derivatives."""

    def __init__(self) -> None:
        super().__init__()
        self.evaluations = 0

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        self.evaluations += bool(parameters)
        return super().predict_all(rig, runs, parameters, scaled)


def fit_within(rig: Any, most: int | None) -> tuple[int, list[int], fit.FitResult]:
    """Evaluations made and told, and the result, of a fit with all that may follow its first search."""
    engine, steps = Counted(), []
    result, _ = fit.fit_runs(
        rig, [run_of("press", "markers")], ["gel.E"], FitOptions(nuisance=("none",), max_evaluations=most),
        engine=cast(PooledEngine, engine), on_step=lambda step: steps.append(step.evaluations),
    )  # fmt: skip
    return engine.evaluations, steps, result


def test_a_fit_makes_no_more_evaluations_than_it_may(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither in restarts, which no misfit prevents here, nor in further looks, nor at the ends of intervals."""
    monkeypatch.setattr(starts, "GOOD_MISFIT", 0.0)
    monkeypatch.setattr(fit, "without_outliers", lambda runs, *given: (list(runs), []))
    monkeypatch.setattr(fit, "not_looked_for", lambda *given: [])
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
    """Though its misfit is large, there is nothing to search and no other place to measure its own error at."""
    steps: list[Step] = []
    result, _ = fit.fit_runs(
        small_rig(), [run_of("press", "markers")], [], FitOptions(robust=False), engine=cast(PooledEngine, Readings()),
        on_step=steps.append,
    )  # fmt: skip
    assert result.misfit > 10.0 and result.converged
    assert result.evaluations == len(steps) == 1


def test_evaluations_that_fail_are_counted(small_rig: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first steps of a search, and starts of others, beyond what can be simulated."""
    monkeypatch.setattr(starts, "GOOD_MISFIT", 0.0)
    monkeypatch.setattr(fit, "without_outliers", lambda runs, *given: (list(runs), []))
    monkeypatch.setattr(fit, "not_looked_for", lambda *given: [])

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
    problem = Problem([run_of("press", "markers")], noise, cast(PooledEngine, Readings()))
    steps: list[Step] = []
    shares: list[float] = []
    evaluations = Evaluations(FitOptions(max_evaluations=2), lambda share, words: shares.append(share), steps.append)
    first = problem.fit(small_rig(), parameters, np.array([11.0]), 1, on_evaluation=evaluations)
    second = problem.fit(small_rig(), parameters, np.array([11.5]), evaluations.left, on_evaluation=evaluations)
    assert evaluations.left == 0
    assert [s.evaluations for s in steps] == list(range(1, 1 + first.evaluations + second.evaluations))
    assert first.evaluations == 1 and second.evaluations == 1
    assert not first.converged and not second.converged
    assert shares == sorted(shares)
    assert steps[0].values == {"gel.E_pa": pytest.approx(np.exp(first.scaled[0]))}
    assert steps[0].misfit == pytest.approx(first.misfit)


def test_what_did_not_converge_says_so_before_its_values(small_rig: Any) -> None:
    good = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
    assert good.converged and good.table().startswith("parameter")
    result = replace(good, converged=False, message="the evaluations allowed, 1, are used up")
    first = result.table().splitlines()[0]
    assert first.startswith("The fit did not converge: the evaluations allowed, 1, are used up."), first
    assert first.endswith("Take its values as a start, not as a result.")
    assert result.table().count("did not converge") == 1


def test_the_misfit_of_a_result_is_that_of_its_last_step(small_rig: Any) -> None:
    """One measure while a fit runs and at its end: whitened residuals squared, over their number."""
    steps: list[Step] = []
    run = run_of("press", "markers")
    options = FitOptions(nuisance=("none",), intervals="quadratic", robust=False)
    result, _ = fit.fit_runs(
        small_rig(), [run], ["gel.E"], options, engine=cast(PooledEngine, Readings()), on_step=steps.append
    )
    assert result.misfit == pytest.approx(steps[-1].misfit)
    white = (run.measured[0].values - column(result.estimates[0].value)) / 0.01
    assert result.misfit == pytest.approx(float(np.mean(white**2)), rel=1e-6)
    assert result.misfit < result.reduced_chi2


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
    result = result_of(Readings(), small_rig(), [run_of("press", "markers")], [])
    assert result.converged and result.estimates[0].value == pytest.approx(TRUTH, rel=0.05)
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.0)
