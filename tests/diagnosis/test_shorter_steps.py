"""A baseline takes shorter time steps where a vibration asks for them."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.rigs import Rig
from sysid.diagnosis.baseline import _is_far, _shorter_steps, with_steps_that_it_follows
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.model.time_span import rollout_times
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

NAMES = ["card.E"]
T = np.linspace(0.0, 2.0, 401)
OMEGA_PER_S, NOISE, SIZE = 10.0, 1e-3, 0.2


def vibration(modulus_log: float, h: float) -> np.ndarray:
    """A frequency that goes with the root of the modulus, and is lower by (omega h)^2 / 3 of it by BDF2."""
    omega = OMEGA_PER_S * np.exp(0.5 * modulus_log)
    return np.asarray(SIZE * np.sin(omega * (1.0 - (omega * h) ** 2 / 3.0) * T)[:, None])


class Vibrating:
    """Predictions of a vibration."""

    def __init__(self, rig: Rig) -> None:
        self.origin = start_of(rig, fit_parameters(rig, NAMES))

    def _read(self, rig: Rig, run: Run) -> np.ndarray:
        h = float(np.diff(rollout_times([rig], run, rig.solver.dt_s)).max())
        return vibration(float((start_of(rig, fit_parameters(rig, NAMES)) - self.origin)[0]), h)

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        found: Future[Prediction] = Future()
        found.set_result(Prediction({"gauge": self._read(rig, run)}, {}, cast(Any, None)))
        return found

    def predict_all(self, rig: Rig, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        h = rig.solver.dt_s
        at = float((scaled - self.origin)[0])
        slope = (vibration(at + 1e-6, h) - vibration(at - 1e-6, h)) / 2e-6
        return [Prediction({"gauge": vibration(at, h)}, {"gauge": slope[..., None]}, cast(Any, None)) for _ in runs]


@pytest.fixture(autouse=True)
def no_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid.model.time_span.total_delay", lambda *given: 0.0)


@pytest.fixture
def fitted(small_rig: Callable[..., Rig]) -> Callable[[float], tuple[Any, Problem, Fitted]]:
    """The fit with the steps of the rig, 10 ms, to a recording that has those of a length [s]."""

    def build(h: float) -> tuple[Any, Problem, Fitted]:
        rig = small_rig(solver={"dt_s": 0.01, "inertia": True, "integrator": "bdf2"})
        engine = cast(Any, Vibrating(rig))
        values = vibration(0.0, h) + NOISE * np.random.default_rng(0).standard_normal((len(T), 1))
        run = Run("run", "", (), {}, (Measured("gauge", "markers", T, values, ("x",)),), float(T[-1]))
        problem = Problem([run], {"gauge": ChannelNoise(np.array([NOISE]), np.zeros(1), "given")}, engine)
        return engine, problem, problem.fit(rig, fit_parameters(rig, NAMES), max_evaluations=20)

    return build


def test_a_modulus_that_takes_up_the_error_of_the_steps_is_found_out(fitted: Any) -> None:
    """With 10 ms the frequency is 0.3 % low, which a modulus 0.7 % too high makes up for. The recording cannot tell the
    two apart, and steps are shorter unless it tells otherwise."""
    engine, problem, found = fitted(0.0)
    assert float((found.scaled - engine.origin)[0]) == pytest.approx(2.0 / 300.0, rel=0.1)
    (run,), predictions, undecided = _shorter_steps(engine, problem, found, problem.runs, problem.noise)
    assert not undecided
    assert predictions is not None
    (prediction,) = predictions
    assert run.steps is not None and np.diff(run.steps).max() == pytest.approx(0.005)
    expected = vibration(float((found.scaled - engine.origin)[0]), 0.005)
    np.testing.assert_allclose(prediction.values["gauge"], expected)


def test_each_recording_has_the_steps_that_it_follows(fitted: Any) -> None:
    """Another one was simulated with the steps of the rig, and is known to be so by a modulus that is known."""
    engine, _, _ = fitted(0.0)
    rig = fitted(0.0)[2].centre
    rng = np.random.default_rng(1)
    runs = []
    for name, h in (("robot", 0.0), ("simulated", 0.01)):
        values = vibration(0.0, h) + NOISE * rng.standard_normal((len(T), 1))
        runs.append(Run(name, "", (), {}, (Measured("gauge", "markers", T, values, ("x",)),), float(T[-1])))
    parameters = [replace(p, known_sd=1e-4) for p in fit_parameters(rig, NAMES)]
    noise = {"gauge": ChannelNoise(np.array([NOISE]), np.zeros(1), "given")}
    problem = Problem(runs, noise, engine, prior=True)
    there = problem.evaluate(rig, parameters, engine.origin)
    found, predictions, undecided = _shorter_steps(engine, problem, there, runs, noise)
    assert not undecided
    assert predictions is not None
    assert found[0].steps is not None and found[1] is runs[1]
    for prediction, h in zip(predictions, (0.005, 0.01), strict=True):
        np.testing.assert_allclose(prediction.values["gauge"], vibration(0.0, h))


def test_what_is_left_out_does_not_decide_on_the_steps(fitted: Any) -> None:
    """A recording with the steps of the rig, and a slow vibration with it that no model has, which looks like shorter
    steps here and like longer ones there."""
    engine, _, there = fitted(0.01)
    rig = there.centre
    parameters = [replace(p, known_sd=1e-4) for p in fit_parameters(rig, NAMES)]
    noise = {"gauge": ChannelNoise(np.array([NOISE]), np.zeros(1), "given")}
    change = (vibration(0.0, 0.005) - vibration(0.0, 0.01))[:, 0]
    beat = np.sign(np.sin(2.0 * np.pi * T))
    beat -= np.sum(change**2 * beat) / np.sum(change**2)
    for size, kept in ((0.0, False), (4.0, True)):
        wanted = change * (0.8 + size * beat)
        values = vibration(0.0, 0.01) + wanted[:, None] + NOISE * np.random.default_rng(3).standard_normal((len(T), 1))
        runs = [Run("run", "", (), {}, (Measured("gauge", "markers", T, values, ("x",)),), float(T[-1]))]
        problem = Problem(runs, noise, engine, prior=True)
        there = problem.evaluate(rig, parameters, engine.origin)
        found, predictions, undecided = _shorter_steps(engine, problem, there, runs, noise)
        assert (predictions is None, found[0] is runs[0], undecided) == (kept, kept, ("run",) if kept else ())
        base = SimpleNamespace(recorded=runs, problem=problem, engine=engine, noise=noise, undecided=undecided)
        followed = with_steps_that_it_follows(cast(Any, base), there)
        assert [run.steps is not None for run in followed] == ([True] if kept else [])


def test_what_misses_a_sixth_of_the_readings_is_another_branch(fitted: Any) -> None:
    _, problem, found = fitted(0.0)
    assert not _is_far(found)
    snap = problem.compare(found.predictions, found.centre, found.parameters, found.scaled)
    snap.residual = np.where(np.arange(len(snap.residual)) < 0.1 * len(T), 50.0, snap.residual)
    assert snap.misfit > 100.0 and not _is_far(snap), "a snap"
    snap.residual = np.where(np.arange(len(snap.residual)) < 0.2 * len(T), 50.0, snap.residual)
    assert _is_far(snap)
