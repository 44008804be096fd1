"""An answer is fitted on beside what the reference model adds with its effects, not with those of the baseline."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
from sysid.diagnosis import confirmation
from sysid.diagnosis.confirmation import confirmed
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.model.space_mapping import SpaceMappedPredictor, additions
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


@dataclass
class Base:
    """What of a baseline is used."""

    reference: Any
    engine: Any
    problem: Problem
    check: Problem


@dataclass
class Scored:
    """What of a trial is looked at."""

    fitted: Fitted
    confirmed: bool = False
    hypotheses: tuple[Any, ...] = (SimpleNamespace(effect=SimpleNamespace(name="effect")),)


T = np.linspace(0.0, 1.0, 60)
TRUE = 0.5
NAMES = ["card.E"]


def readings(theta: float, fine: bool) -> np.ndarray:
    """What the cells change grows with the square of the parameter."""
    return np.asarray((theta * T + (0.0 if fine else 0.15 * theta**2 * T))[:, None])


class Engine:
    """Predicts with fine cells where the rig is called so; fails there if asked to."""

    def __init__(self, rig: Any, fails: bool = False) -> None:
        self.origin, self.fails = start_of(rig, fit_parameters(rig, NAMES)), fails

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        found: Future[Prediction] = Future()
        if self.fails and rig.name == "fine":
            found.set_exception(ConvergenceError("A step does not converge.", "Shorten it."))
        else:
            at = float((start_of(rig, fit_parameters(rig, NAMES)) - self.origin)[0])
            found.set_result(Prediction({"gauge": readings(at, rig.name == "fine")}, {}, cast(Any, None)))
        return found

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        at = float((scaled - self.origin)[0])
        slope = (readings(at + 1e-6, False) - readings(at - 1e-6, False)) / 2e-6
        return [Prediction({"gauge": readings(at, False)}, {"gauge": slope[..., None]}, cast(Any, None)) for _ in runs]


def case(rig: Any, fails: bool = False) -> tuple[Any, Any]:
    """Baseline and trial, whose reference was measured where the effect has no size."""
    engine = cast(Any, Engine(rig, fails))
    parameters = fit_parameters(rig, NAMES)
    noise = {"gauge": ChannelNoise(np.array([1e-3]), np.zeros(1), "given")}
    run = Run("run", "", (), {}, (Measured("gauge", "markers", T, readings(TRUE, True), ("u",)),), 1.0)
    none = [Prediction({"gauge": readings(0.0, fine)}, {}, cast(Any, None)) for fine in (False, True)]
    mapped = SpaceMappedPredictor(engine, additions([run], [none[0]], [none[1]]))
    problem = Problem([run], noise, mapped)
    begun = problem.fit(rig, parameters, engine.origin.copy(), max_evaluations=20)
    reference = SimpleNamespace(fine=lambda r: r.model_copy(update={"name": "fine"}), mesh=None)
    base = Base(reference, mapped, problem, Problem([], noise, mapped))
    return base, Scored(begun)


def test_it_ends_at_the_truth_where_the_coarse_cells_had_led_it_astray(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = small_rig()
    base, trial = case(rig)
    origin = base.engine.coarse.origin
    assert abs(float((trial.fitted.scaled - origin)[0]) - TRUE) > 0.02
    monkeypatch.setattr(confirmation, "scored", lambda base, hypotheses, fitted, there: Scored(fitted))
    found = cast(Any, confirmed(base, trial, {}))
    assert found.confirmed
    assert float((found.fitted.scaled - origin)[0]) == pytest.approx(TRUE, abs=5e-3)


def test_an_answer_that_cannot_be_simulated_with_finer_cells_is_none(small_rig: Any) -> None:
    base, trial = case(small_rig(), fails=True)
    failed: dict[str, str] = {}
    assert confirmed(base, trial, failed) is None
    assert "finer cells" in failed["effect"] and "does not converge" in failed["effect"]


@pytest.mark.parametrize("evaluations", [1, 20])
def test_without_a_reference_an_answer_is_fitted_to_the_end(
    small_rig: Any, monkeypatch: pytest.MonkeyPatch, evaluations: int
) -> None:
    """One that has converged is an answer as it is."""
    rig = small_rig()
    base, trial = case(rig)
    base.reference, base.engine = None, base.problem.engine
    problem, origin = base.problem, base.engine.coarse.origin
    trial.fitted = problem.fit(rig, fit_parameters(rig, NAMES), origin + 0.3, max_evaluations=evaluations)
    monkeypatch.setattr(confirmation, "scored", lambda base, hypotheses, fitted, there: Scored(fitted))
    found = cast(Any, confirmed(base, trial, {}))
    best = problem.fit(rig, fit_parameters(rig, NAMES), origin.copy(), max_evaluations=30)
    assert found.confirmed
    assert found.fitted.chi2 == pytest.approx(best.chi2, abs=1e-3)
    assert (found.fitted is trial.fitted) == (evaluations == 20)
