"""Spans in which two simulations that nobody can tell apart disagree weigh nothing; the right branch is found."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.rigs import Rig
from sim_core.simulate import Trace
from sysid.diagnosis import predictability
from sysid.diagnosis.baseline import best_branch, fine_enough
from sysid.diagnosis.beliefs import believed
from sysid.diagnosis.predictability import Unpredictable, _joined, members_of, unpredictable, without
from sysid.model.parameters import FitParameter, fit_parameters, rig_at, start_of
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 2.0, 201)
SIGMA, SNAP = 1e-3, (T > 0.8) & (T < 1.1)
LIMIT = 0.4


def readings(rig: Rig) -> np.ndarray:
    """Linear in friction, but for a span in which it snaps through where friction is above a limit."""
    friction = rig.contacts[0].friction
    snapped = np.where(SNAP, 0.5, 0.0) if friction > LIMIT else 0.0 * T
    return np.asarray((friction * np.sin(3.0 * T) + snapped)[:, None] * np.ones(6))


TRACE = cast(Trace, SimpleNamespace(reports=(SimpleNamespace(contacts=0),)))
"""Of a rollout in which nothing touches."""


class Snapping:
    """Predictions of a wrench that snaps."""

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        found: Future[Prediction] = Future()
        found.set_result(Prediction({"wrist": readings(rig)}, {}, TRACE))
        return found

    def predict_all(self, rig: Rig, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        here = rig_at(rig, parameters, scaled)
        slopes = (np.sin(3.0 * T)[:, None] * np.ones(6))[:, :, None]
        return [Prediction({"wrist": readings(here)}, {"wrist": slopes}, TRACE) for _ in runs]


@pytest.fixture
def problem(small_rig: Callable[..., Rig]) -> Callable[[float], tuple[Problem, Rig, list[FitParameter]]]:
    """A recording at some friction."""

    def build(friction: float) -> tuple[Problem, Rig, list[FitParameter]]:
        rig = small_rig()
        parameters = believed(rig, fit_parameters(rig, ["contacts.gel-card.friction"]))
        truth = rig_at(rig, parameters, np.array([friction]))
        data = readings(truth) + SIGMA * np.random.default_rng(0).standard_normal((len(T), 6))
        run = Run("run", "", (), {}, (Measured("wrist", "wrench", T, data, tuple("abcdef")),), float(T[-1]))
        noise = {"wrist": ChannelNoise(np.full(6, SIGMA), np.zeros(6), "test")}
        return Problem([run], noise, cast(Any, Snapping()), prior=True), rig, parameters

    return build


def model(problem: Problem, rig: Rig, parameters: list[FitParameter], at: float) -> Fitted:
    return problem.evaluate(rig, parameters, np.array([at]))


def test_a_snap_that_a_small_change_brings_is_left_out(problem: Any) -> None:
    """Just below the limit members snap and others do not; elsewhere the rollout is as foreseen."""
    there, rig, parameters = problem(LIMIT - 1e-3)
    fitted = model(there, rig, parameters, LIMIT - 1e-3)
    derived = there.engine.predict_all(rig, there.runs, parameters, fitted.scaled)
    (found,) = unpredictable(there.engine, there.runs, fitted, there.noise, derived)
    ((begin, end),) = found.spans
    assert begin == pytest.approx(0.8, abs=0.05) and end == pytest.approx(1.1 + DIAGNOSIS.ringing_s, abs=0.05)
    assert "run: readings from 0.7" in found.sentence
    (run,) = without(there.runs, [found])
    gone = np.isnan(run.measured[0].values[:, 0])
    assert gone[SNAP].all() and gone.sum() < SNAP.sum() + 40


def test_where_one_channel_is_unpredictable_no_other_one_counts(problem: Any) -> None:
    """A hand that snaps through is in another state for its cameras as well, however little they see of it."""
    there, _, _ = problem(LIMIT - 1e-3)
    (run,) = there.runs
    seen = Measured("below", "tracks", T[::3], np.zeros((len(T[::3]), 2)), ("u", "v"))
    (left,) = without([replace(run, measured=(*run.measured, seen))], [Unpredictable("run", ((0.8, 1.1), (1.5, 1.6)))])
    for m in left.measured:
        inside = ((m.t >= 0.8) & (m.t <= 1.1)) | ((m.t >= 1.5) & (m.t <= 1.6))
        assert (np.isnan(m.values).all(axis=1) == inside).all()


def test_spans_of_several_channels_are_joined() -> None:
    assert _joined([(2.0, 3.0), (0.5, 1.0), (0.8, 1.5), (2.2, 2.4)]) == ((0.5, 1.5), (2.0, 3.0))


def test_far_from_the_limit_everything_is_predictable(problem: Any) -> None:
    there, rig, parameters = problem(0.25)
    fitted = model(there, rig, parameters, 0.25)
    derived = there.engine.predict_all(rig, there.runs, parameters, fitted.scaled)
    assert unpredictable(there.engine, there.runs, fitted, there.noise, derived) == []


def test_another_branch_that_follows_the_recording_is_found(problem: Any) -> None:
    """The recording snaps; the model stands on the other side of the limit."""
    there, rig, parameters = problem(0.45)
    fitted = model(there, rig, parameters, 0.38)
    at = best_branch(there.engine, there, fitted)
    assert at is not None and at[0] > LIMIT
    here, rig, parameters = problem(0.45)
    right = model(here, rig, parameters, 0.45)
    assert best_branch(here.engine, here, right) is None
    assert start_of(rig, parameters)[0] > 0.0


def test_recordings_in_which_nothing_touches_are_not_simulated_again(problem: Any) -> None:
    there, rig, parameters = problem(0.45)
    there = Problem([*there.runs, replace(there.runs[0], name="apart")], there.noise, there.engine, prior=True)
    fitted = model(there, rig, parameters, 0.38)
    touching = cast(Trace, SimpleNamespace(reports=(SimpleNamespace(contacts=3),)))
    fitted.predictions[0] = replace(fitted.predictions[0], trace=touching)
    asked: set[str] = set()
    plain = there.engine.submit
    there.engine.submit = lambda rig, run, *a: asked.add(run.name) or plain(rig, run, *a)
    assert best_branch(there.engine, there, fitted) is not None
    assert asked == {"run"}


def test_other_branches_are_looked_for_with_the_steps_of_the_rig(problem: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    there, rig, parameters = problem(0.45)
    there.runs[0] = replace(there.runs[0], steps=np.linspace(0.0, T[-1], 4000))
    fitted = model(there, rig, parameters, 0.38)
    asked: list[object] = []
    plain = there.engine.submit
    monkeypatch.setattr(there.engine, "submit", lambda rig, run, *a: asked.append(run.steps) or plain(rig, run, *a))
    assert best_branch(there.engine, there, fitted) is not None
    assert asked and all(steps is None for steps in asked)


def test_a_recording_that_the_step_cannot_follow_weighs_nothing(problem: Any) -> None:
    """One of two has an error of mesh and step of 20 times the noise; where both have it, both stay."""
    there, _, _ = problem(0.3)
    (run,) = there.runs
    shape = np.ones((len(T), 6))
    good, bad = {"wrist": 0.5 * SIGMA * shape}, {"wrist": 20.0 * SIGMA * shape}
    kept, said = fine_enough([run, run], [ErrorShape("mesh", (good, bad))], there.noise)
    assert kept == [0] and "20 times the noise" in said[0]
    assert fine_enough([run, run], [ErrorShape("mesh", (bad, bad))], there.noise) == ([0, 1], ())


def test_members_are_what_the_recordings_cannot_tell_apart(small_rig: Callable[..., Rig]) -> None:
    """Where they show only the sum of two parameters, its difference may be anything, and the sum may not."""
    rig = small_rig()
    parameters = believed(rig, fit_parameters(rig, ["card.E", "gel.E"]))
    start = start_of(rig, parameters)

    class Sum:
        def predict_all(self, rig: Rig, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
            values = np.sin(3.0 * T)[:, None] * (1.0 + float(np.sum(scaled - start)))
            slopes = np.sin(3.0 * T)[:, None, None] * np.ones(2)
            return [Prediction({"gauge": values}, {"gauge": slopes}, TRACE) for _ in runs]

    data = np.sin(3.0 * T)[:, None] + SIGMA * np.random.default_rng(0).standard_normal((len(T), 1))
    run = Run("run", "", (), {}, (Measured("gauge", "markers", T, data, ("u",)),), float(T[-1]))
    noise = {"gauge": ChannelNoise(np.array([SIGMA]), np.zeros(1), "test")}
    fitted = Problem([run], noise, cast(Any, Sum()), prior=True).evaluate(rig, parameters, start)
    away = np.array(members_of(fitted)) - fitted.scaled
    assert np.abs(away[:, 0]).max() > 0.2, "as far as what is known beforehand"
    assert np.abs(away.sum(axis=1)).max() < 0.05
    np.testing.assert_allclose(away.sum(axis=0), 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("nominal", "members", "stands"),
    [
        (900.0, [850.0, 120.0, 110.0, 700.0], 110.0),  # it snaps the other way in two of them
        (900.0, [850.0, 700.0, 600.0, 500.0], 900.0),  # nothing snaps: the model is wrong
        (190.0, [10.0, 10.0, 10.0, 10.0], 190.0),  # it predicts well enough: nobody looks
    ],
)
def test_which_way_a_strip_snaps_does_not_speak_against_a_model(
    small_rig, monkeypatch, nominal, members, stands
) -> None:
    rig = small_rig()
    parameters = fit_parameters(rig, ["gel.E_pa"])
    at = start_of(rig, parameters)
    ways = [at + 0.01 * (k + 1) for k in range(len(members))]
    monkeypatch.setattr(predictability, "members_of", lambda fitted: ways)
    chi2 = {round(float(at[0]), 6): nominal} | {round(float(w[0]), 6): c for w, c in zip(ways, members, strict=True)}

    def evaluate(rig, *rest):
        return SimpleNamespace(chi2=chi2[round(float(start_of(rig, parameters)[0]), 6)])

    check = cast(Any, SimpleNamespace(runs=[1], evaluate=evaluate))
    plain = cast(Fitted, SimpleNamespace(chi2=100.0))
    fitted = cast(Fitted, SimpleNamespace(rig=rig, parameters=parameters, scaled=at))
    found = predictability.predicted_held_out(check, plain, fitted)
    assert found is not None and found.chi2 == stands
