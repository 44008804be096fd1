"""Where the baseline contradicts what the rig says, effects are looked at from the rig's own numbers as well."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.errors import ConvergenceError
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
    """Of two effects, with the evidence that is said of each."""

    def __init__(self, said: tuple[float, float]) -> None:
        self._said = said
        self.hypotheses = [
            SimpleNamespace(effect=SimpleNamespace(name=n), key=n, shape={}, amplitudes=()) for n in "ab"
        ]
        self.kappa = 0.0

    def singles(self) -> list[Score]:
        return [Score((k,), gain, 500.0, (np.ones(1),), np.zeros(1)) for k, gain in enumerate(self._said)]

    def by_recording(self) -> list[Score]:
        return []

    def score(self, numbers: list[int]) -> Score:
        return Score(tuple(numbers), 0.0, 0.0, (), np.zeros(1))

    def temper(self, kappa: float) -> None:
        self.kappa = kappa


def trial(names: str, gain: float, where: str) -> Any:
    left = SimpleNamespace(missing=False)
    return SimpleNamespace(names=frozenset(names), hypotheses=(), gain=gain, idle="", left=left, where=where)


@pytest.mark.parametrize(
    ("deviations", "gain", "said", "where"),
    [
        (5.2, 90.0, (60.0, 2.0), "rig"),
        (5.2, 10.0, (60.0, 2.0), "baseline"),
        (3.5, 90.0, (60.0, 2.0), "baseline"),
        (5.2, 90.0, (60.0, 30.0), "rig"),
    ],
)
def test_the_better_of_both_refits_is_kept(
    monkeypatch: pytest.MonkeyPatch, deviations: float, gain: float, said: tuple[float, float], where: str
) -> None:
    """That from the rig's numbers is fitted to the end before it is compared, since it stands beside other errors of
    the mesh; of two only the better one. Where the baseline agrees with the rig none is made."""
    home, elsewhere = cast(Any, SimpleNamespace(rig=None)), cast(Any, SimpleNamespace(engine=None))
    base = cast(Any, SimpleNamespace(fitted=SimpleNamespace(misfit=3.0), engine=None, problem=None,
                                     at_the_rigs_numbers=lambda: (elsewhere, home)))  # fmt: skip
    ended: list[str] = []

    def refits_of(base: Any, problem: Any, begun: Any, starts: list[Start], scales: Any, failed: Any) -> list[Any]:
        assert problem is elsewhere and begun is home
        better = {"a": 900.0, "b": 400.0}
        return [(s, SimpleNamespace(misfit=1.0, evidence=better[min(s.names)]), None) for s in starts]

    def to_the_end(base: Any, effects: Any, begun: Any, failed: Any) -> Any:
        (name,) = (h.effect.name for h in effects)
        ended.append(name)
        return trial(name, gain, "rig")

    monkeypatch.setattr(diagnosing, "trials_of", lambda *given: [trial("a", 50.0, "baseline")])
    monkeypatch.setattr(diagnosing, "refits_of", refits_of)
    monkeypatch.setattr(diagnosing, "fitted_to_the_end", to_the_end)
    monkeypatch.setattr(diagnosing, "log_evidence", lambda fitted, temper: fitted.evidence)
    monkeypatch.setattr(diagnosing, "tempered", lambda _, trials: sorted(trials, key=lambda t: -t.gain))
    monkeypatch.setattr(diagnosing, "answers", lambda trials, case: trials)
    monkeypatch.setattr(diagnosing, "hypotheses", lambda rig, scales: [])
    monkeypatch.setattr(diagnosing, "look", lambda *given: (Screening(said), {}))
    found = diagnosing._trials(base, *told(said, deviations), cast(Any, None), {}, lambda share, text: None)
    assert ended == (["a"] if deviations > 4.0 else [])
    assert [t.where for t in found] == [where]


def told(said: tuple[float, float], deviations: float) -> tuple[Any, list[Score], Any]:
    """The look beside the baseline, and a case in which a number is so far from what the rig says."""
    screen = cast(Any, Screening(said))
    far = Contradiction("cam.cx_px", "px", 346.0, 320.0, deviations)
    return screen, screen.singles(), cast(Any, SimpleNamespace(missing=True, needed=8.0, contradictions=(far,)))


@pytest.mark.parametrize("deviations", [3.5, 5.2])
def test_it_is_looked_at_where_nothing_is_promised_and_may_fail(
    monkeypatch: pytest.MonkeyPatch, deviations: float
) -> None:
    """A number that takes up all of an effect leaves no promise of it. Rollouts from there may not end."""

    def at_the_rigs_numbers() -> Any:
        raise ConvergenceError("A step does not converge.", "Shorten it.")

    base = cast(Any, SimpleNamespace(fitted=SimpleNamespace(misfit=3.0), at_the_rigs_numbers=at_the_rigs_numbers))
    failed: dict[str, str] = {}
    monkeypatch.setattr(diagnosing, "tempered", lambda _, trials: list(trials))
    found = diagnosing._trials(base, *told((2.0, 2.0), deviations), cast(Any, None), failed, lambda share, text: None)
    assert found == []
    assert [why for why in failed.values() if "does not converge" in why] == list(failed.values())
    assert bool(failed) == (deviations > 4.0)
