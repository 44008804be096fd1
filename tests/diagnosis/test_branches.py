"""The branch of contact that recordings follow is found: sticking or sliding, to the one side or the other."""

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
from sysid.diagnosis.baseline import best_branch
from sysid.diagnosis.known_priors import with_known_priors
from sysid.model.parameters import FitParameter, fit_parameters, rig_at, start_of
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
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
        parameters = with_known_priors(rig, fit_parameters(rig, ["contacts.gel-card.friction"]))
        truth = rig_at(rig, parameters, np.array([friction]))
        data = readings(truth) + SIGMA * np.random.default_rng(0).standard_normal((len(T), 6))
        run = Run("run", "", (), {}, (Measured("wrist", "wrench", T, data, tuple("abcdef")),), float(T[-1]))
        noise = {"wrist": ChannelNoise(np.full(6, SIGMA), np.zeros(6), "test")}
        return Problem([run], noise, cast(Any, Snapping()), prior=True), rig, parameters

    return build


def model(problem: Problem, rig: Rig, parameters: list[FitParameter], at: float) -> Fitted:
    return problem.evaluate(rig, parameters, np.array([at]))


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
