"""Where the baseline contradicts what the rig says, effects are looked at from the rig's own numbers as well."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.rigs import load_rig
from sysid.diagnosis import diagnose as diagnosing
from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.contradictions import Contradiction
from sysid.diagnosis.reference_model import Standing
from sysid.diagnosis.screening import Score
from sysid.diagnosis.starts import Start
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

T = np.linspace(0.0, 1.0, 50)


class Coarse:
    """A gauge that shows a modulus, in units of the rig's."""

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        values = np.full((len(T), 1), float(scaled[0]))
        return [Prediction({"gauge": values}, {"gauge": np.ones((len(T), 1, 1))}, cast(Any, None)) for _ in runs]


@pytest.mark.parametrize("inertia", [False, True])
def test_there_the_reference_model_is_that_of_the_rigs_numbers(inertia: bool) -> None:
    """What it adds was measured at the start and where the baseline ended; with inertia the latter alone counts."""
    rig = load_rig("gel_sensor")
    parameters = fit_parameters(rig, ["gel.E_pa"])
    home = start_of(rig, parameters)
    run = Run("press", "", (), {}, (Measured("gauge", "wrench", T, np.zeros((len(T), 1)), ("f",)),), 1.0)
    noise = {"gauge": ChannelNoise(np.ones(1), 0.0, "test")}

    def engine(added: float) -> SpaceMappedPredictor:
        return SpaceMappedPredictor(cast(Any, Coarse()), {"press": {"gauge": np.full((len(T), 1), added)}})

    problem = Problem([run], noise, engine(0.3))
    nothing = np.zeros((len(T), 1))
    fitted = Fitted(parameters, home + 2.0, rig, nothing.ravel(), nothing, [(0, "gauge", T)], [], rig, 1, True, "")
    first = None if inertia else Standing(engine(0.1), [], [])
    base = Baseline(problem, fitted, cast(Any, None), None, noise, [], (), None, first=first)
    there, begun = base.at_the_rigs_numbers()
    assert there.runs == problem.runs
    np.testing.assert_array_equal(begun.scaled, home)
    added = 0.3 if inertia else 0.1
    np.testing.assert_allclose(begun.predictions[0].values["gauge"], home[0] + added)


class Screening:
    """Of two effects, the second one is not significant."""

    def __init__(self) -> None:
        self.hypotheses = [
            SimpleNamespace(effect=SimpleNamespace(name=n), key=n, shape={}, amplitudes=()) for n in "ab"
        ]
        self.kappa = 0.0

    def singles(self) -> list[Score]:
        return [Score((k,), gain, 500.0, (np.ones(1),), np.zeros(1)) for k, gain in enumerate((60.0, 2.0))]

    def by_recording(self) -> list[Score]:
        return []

    def temper(self, kappa: float) -> None:
        self.kappa = kappa


def trial(names: str, gain: float, where: str) -> Any:
    left = SimpleNamespace(missing=False)
    return SimpleNamespace(names=frozenset(names), hypotheses=(), gain=gain, idle="", left=left, where=where)


@pytest.mark.parametrize(
    ("deviations", "gain", "where"), [(5.2, 90.0, "rig"), (5.2, 10.0, "baseline"), (3.5, 90.0, "baseline")]
)
def test_the_better_of_both_refits_is_kept(
    monkeypatch: pytest.MonkeyPatch, deviations: float, gain: float, where: str
) -> None:
    """That from the rig's numbers is fitted to the end before it is compared, since it stands beside another reference
    model; where the baseline agrees with the rig none is made."""
    home = cast(Any, SimpleNamespace(rig=None))
    elsewhere = cast(Any, SimpleNamespace(engine=None))
    base = cast(Any, SimpleNamespace(fitted=SimpleNamespace(misfit=3.0), engine=None, problem=None,
                                     at_the_rigs_numbers=lambda: (elsewhere, home)))  # fmt: skip
    asked: list[str] = []

    def trials_of(
        base: Any, begun: Any, starts: list[Start], scales: Any, failed: Any, problem: Any = None
    ) -> list[Any]:
        at_home = begun is home
        assert (problem is elsewhere) == at_home
        asked.append("rig" if at_home else "baseline")
        return [trial("a", 1e3 if at_home else 50.0, asked[-1])]

    def confirmed(base: Any, ended: Any, failed: Any) -> Any:
        return trial("a", gain, ended.where)

    monkeypatch.setattr(diagnosing, "trials_of", trials_of)
    monkeypatch.setattr(diagnosing, "confirmed", confirmed)
    monkeypatch.setattr(diagnosing, "tempered", lambda _, trials: sorted(trials, key=lambda t: -t.gain))
    monkeypatch.setattr(diagnosing, "answers", lambda trials, case: trials)
    monkeypatch.setattr(diagnosing, "hypotheses", lambda rig, scales: [])
    monkeypatch.setattr(diagnosing, "look", lambda *given: (Screening(), {}))
    screen = cast(Any, Screening())
    far = Contradiction("cam.cx_px", "px", 346.0, 320.0, deviations)
    case = cast(Any, SimpleNamespace(missing=True, needed=8.0, contradictions=(far,)))
    found = diagnosing._trials(base, screen, screen.singles(), case, cast(Any, None), {}, lambda share, text: None)
    assert asked == (["baseline", "rig"] if deviations > 4.0 else ["baseline"])
    assert [t.where for t in found] == [where]
