"""A refit begins with the derivatives of the model that an effect is added to, and with its own by the effect."""

from __future__ import annotations

from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sysid.diagnosis import refits
from sysid.diagnosis.refits import _first_predictions, refit
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.observations.observations import Run

RUN = Run("run", "", (), {}, (), 1.0)
VALUES = np.array([[1.0, np.nan], [3.0, 4.0]])
OWN = np.array([[[5.0], [np.nan]], [[6.0], [7.0]]])
BEFORE = np.array([[[1.0], [2.0]], [[np.nan], [4.0]]])


class Rollouts:
    """One rollout with derivatives by what is asked for; never one by all parameters."""

    def __init__(self) -> None:
        self.asked: list[list[str]] = []

    def submit_with_derivatives(self, rig: Any, run: Run, parameters: Any, scaled: np.ndarray) -> Future[Prediction]:
        self.asked.append([p.name for p in parameters])
        found: Future[Prediction] = Future()
        found.set_result(Prediction({"gauge": VALUES}, {"gauge": OWN}, cast(Any, None)))
        return found

    def predict_all(self, *given: Any) -> list[Prediction]:
        raise AssertionError("derivatives by all parameters were made anew")


@pytest.fixture
def begun(small_rig: Any) -> tuple[Any, Any, Any, Any, Any, np.ndarray]:
    """Engine, baseline, model, rig, its parameter and that of the effect, and where a refit begins."""
    rig = small_rig()
    parameters = fit_parameters(rig, ["card.E", "gel.E"])
    engine = Rollouts()
    base = SimpleNamespace(problem=SimpleNamespace(runs=[RUN], engine=engine))
    model = SimpleNamespace(parameters=parameters[:1], predictions=[Prediction({}, {"gauge": BEFORE}, cast(Any, None))])
    return engine, base, model, rig, parameters, start_of(rig, parameters)


def test_derivatives_of_both_stand_in_the_order_of_the_parameters(begun: Any) -> None:
    """What the model had out of sight does not move at first; what is out of sight now has no derivative."""
    engine, base, model, rig, parameters, at = begun
    (found,) = _first_predictions(base, model, rig, parameters, at)
    assert engine.asked == [[parameters[1].name]]
    np.testing.assert_array_equal(found.values["gauge"], VALUES)
    expected = [[[1.0, 5.0], [np.nan, np.nan]], [[0.0, 6.0], [4.0, 7.0]]]
    np.testing.assert_array_equal(found.derivatives["gauge"], expected)


def test_the_first_evaluation_of_a_refit_needs_no_others(begun: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    _, base, model, rig, parameters, at = begun

    class Asking(SimpleNamespace):
        def fit(self, centre: Any, parameters: Any, scaled: np.ndarray, **options: Any) -> Any:
            return self.engine.predict_all(centre, self.runs, parameters, scaled)

    base.problem = Asking(runs=base.problem.runs, engine=base.problem.engine)
    monkeypatch.setattr(refits, "_begun_at", lambda *given: (rig, parameters, at))
    (found,) = cast(Any, refit(base, model, cast(Any, None), cast(Any, None)))
    np.testing.assert_array_equal(found.values["gauge"], VALUES)
