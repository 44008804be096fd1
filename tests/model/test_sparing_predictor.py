"""Derivatives that are carried over lead to the same minimum with few rollouts that have them."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any, cast

import numpy as np
import pytest

from sim_core.simulate import Trace
from sysid.model.parameters import FitParameter, fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.model.sparing_predictor import SparingPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 80)


def values_at(a: float, b: float) -> np.ndarray:
    """Readings that are far from linear in both."""
    return np.asarray(np.exp(0.4 * a) * np.sin(4.0 * T)[:, None] + np.cos(3.0 * b) * T[:, None] ** 2)


class Counting:
    """Counts rollouts with derivatives and without."""

    def __init__(self, origin: np.ndarray) -> None:
        self.origin, self.plain, self.full = origin, 0, 0

    def at(self, scaled: np.ndarray) -> np.ndarray:
        return values_at(*(scaled - self.origin))

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        self.plain += 1
        found: Future[Prediction] = Future()
        here = start_of(rig, fit_parameters(rig, ["card.E", "gel.E"]))
        found.set_result(Prediction({"gauge": self.at(here)}, {}, cast(Trace, None)))
        return found

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        self.full += 1
        steps = 1e-6 * np.eye(len(scaled))
        slopes = np.stack([(self.at(scaled + s) - self.at(scaled - s)) / 2e-6 for s in steps], axis=-1)
        return [Prediction({"gauge": self.at(scaled)}, {"gauge": slopes}, cast(Trace, None)) for _ in runs]


def fitted(small_rig: Any, sparing: bool) -> tuple[np.ndarray, Counting]:
    rig = small_rig()
    parameters: list[FitParameter] = fit_parameters(rig, ["card.E", "gel.E"])
    origin = start_of(rig, parameters)
    source = Counting(origin)
    data = values_at(0.5, 0.3) + 1e-3 * np.random.default_rng(0).standard_normal((len(T), 1))
    run = Run("run", "", (), {}, (Measured("gauge", "markers", T, data, ("u",)),), 1.0)
    engine = cast(Any, SparingPredictor(cast(Any, source)) if sparing else source)
    problem = Problem([run], {"gauge": ChannelNoise(np.array([1e-3]), 0.0, "test")}, engine)
    found = problem.fit(rig, parameters, origin + np.array([0.1, 0.1]), max_evaluations=30)
    return found.scaled - origin, source


def test_the_same_minimum_with_few_derivatives(small_rig: Any) -> None:
    exact, all_derived = fitted(small_rig, False)
    found, source = fitted(small_rig, True)
    np.testing.assert_allclose(found, exact, atol=2e-3)
    np.testing.assert_allclose(exact, [0.5, 0.3], atol=2e-2)
    assert source.full < all_derived.full and source.full + source.plain < 31


def test_a_correction_meets_the_change_that_was_seen(small_rig: Any) -> None:
    """The secant condition: along the step the carried derivatives give the change of the readings."""
    rig = small_rig()
    parameters = fit_parameters(rig, ["card.E", "gel.E"])
    origin = start_of(rig, parameters)
    run = Run("run", "", (), {}, (), 1.0)
    predictor = SparingPredictor(cast(Any, Counting(origin)))
    (first,) = predictor.predict_all(rig, [run], parameters, origin + 0.1)
    step = np.array([0.2, -0.05])
    (second,) = predictor.predict_all(rig, [run], parameters, origin + 0.1 + step)
    change = second.values["gauge"] - first.values["gauge"]
    assert second.derivatives["gauge"] @ step == pytest.approx(change, abs=1e-9)
    assert first.derivatives["gauge"] @ step != pytest.approx(change, abs=1e-4)
