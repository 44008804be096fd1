"""Which effects are tried beside an answer that leaves something."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sysid.diagnosis import diagnose as diagnosing
from sysid.diagnosis.screening import Score
from sysid.diagnosis.starts import Start

LEFT = 1000.0


class Screening:
    """Effects with the evidence and the fall of chi-square that a screening says."""

    def __init__(self, **said: tuple[float, float]) -> None:
        self.hypotheses = [
            SimpleNamespace(effect=SimpleNamespace(name=n), key=n, shape={}, amplitudes=()) for n in said
        ]
        self._said = list(said.values())

    def singles(self) -> list[Score]:
        one = (np.ones(1),)
        found = [Score((k,), gain, fall, one, np.zeros(1)) for k, (gain, fall) in enumerate(self._said)]
        return sorted(found, key=lambda s: -s.gain)

    def by_recording(self) -> list[Score]:
        return []

    def score(self, numbers: list[int]) -> Score:
        return Score(tuple(numbers), 0.0, 0.0, (), np.zeros(1))

    def threshold(self) -> float:
        return 0.0

    def temper(self, kappa: float) -> None:
        del kappa


def trial(names: str, gain: float) -> Any:
    hypotheses = tuple(SimpleNamespace(effect=SimpleNamespace(name=n)) for n in names)
    left = SimpleNamespace(missing=True, whole=SimpleNamespace(excess=LEFT))
    return SimpleNamespace(names=frozenset(names), hypotheses=hypotheses, gain=gain, idle="", left=left, title=names,
                           fitted=SimpleNamespace(rig=None, misfit=1.0))  # fmt: skip


@pytest.mark.parametrize(
    ("beside", "tried"),
    [
        ({"b": (50.0, 0.3 * LEFT), "c": (60.0, 0.2 * LEFT)}, [["a"], ["ab"]]),
        ({"b": (50.0, 0.2 * LEFT), "c": (60.0, 0.2 * LEFT)}, [["a"]]),
    ],
)
def test_what_could_take_away_enough_is_tried_once(
    monkeypatch: pytest.MonkeyPatch, beside: dict[str, tuple[float, float]], tried: list[list[str]]
) -> None:
    """A further effect has to take away half of what an answer leaves; a pair that is better by its evidence and no
    answer all the same is no reason to look beside the answer again."""
    done: list[list[str]] = []

    def trials_of(base: Any, begun: Any, starts: list[Start], scales: Any, failed: Any) -> list[Any]:
        sets = ["".join(sorted(s.names)) for s in starts]
        done.append(sets)
        return [trial(names, 100.0 * len(names)) for names in sets]

    monkeypatch.setattr(diagnosing, "trials_of", trials_of)
    monkeypatch.setattr(diagnosing, "tempered", lambda _, trials: sorted(trials, key=lambda t: -t.gain))
    monkeypatch.setattr(diagnosing, "answers", lambda trials, case: [t for t in trials if len(t.names) == 1])
    monkeypatch.setattr(diagnosing, "hypotheses", lambda rig, scales: [])
    monkeypatch.setattr(diagnosing, "look", lambda *given: (Screening(**beside), {}))
    screen = Screening(a=(80.0, 900.0))
    case = cast(Any, SimpleNamespace(missing=True, needed=8.0, contradictions=()))
    base = cast(Any, SimpleNamespace(fitted=None, engine=None, problem=None))
    told: list[str] = []
    found = diagnosing._trials(base, cast(Any, screen), screen.singles(), case, cast(Any, None), {},
                               lambda share, text: told.append(text))  # fmt: skip
    assert done == tried
    assert told == ["what 'a' leaves"]
    assert {"".join(sorted(t.names)) for t in found} == {names for sets in tried for names in sets}


@pytest.mark.parametrize(
    ("good", "missing", "tried"),
    [("", True, [["a", "ab", "b"], ["b"]]), ("a", True, [["a", "ab", "b"]]), ("", False, [["a", "ab", "b"]])],
)
def test_a_companion_that_predicts_worse_does_not_take_an_effect_along(
    monkeypatch: pytest.MonkeyPatch, good: str, missing: bool, tried: list[list[str]]
) -> None:
    """Of three sets a, b and both, b alone falls to others that explain more where it is simulated. If neither a nor
    both together are an answer, it is refitted alone all the same; not where a is, nor where nothing is missing."""
    done: list[list[str]] = []

    def trials_of(base: Any, begun: Any, starts: list[Start], scales: Any, failed: Any) -> list[Any]:
        sets = sorted("".join(sorted(s.names)) for s in starts)
        done.append(sets)
        return [trial(names, 100.0 * len(names)) for names in sets if len(sets) == 1 or names != "b"]

    monkeypatch.setattr(Screening, "score", lambda self, numbers: Score(tuple(numbers), 900.0, 0.0, (), np.zeros(1)))
    monkeypatch.setattr(diagnosing, "trials_of", trials_of)
    monkeypatch.setattr(diagnosing, "tempered", lambda _, trials: sorted(trials, key=lambda t: -t.gain))
    monkeypatch.setattr(diagnosing, "answers", lambda trials, case: [t for t in trials if t.names == set(good)])
    monkeypatch.setattr(diagnosing, "hypotheses", lambda rig, scales: [])
    monkeypatch.setattr(diagnosing, "look", lambda *given: (Screening(), {}))
    screen = Screening(a=(80.0, 900.0), b=(70.0, 900.0))
    case = cast(Any, SimpleNamespace(missing=missing, needed=8.0, contradictions=()))
    base = cast(Any, SimpleNamespace(fitted=None, engine=None, problem=None))
    diagnosing._trials(base, cast(Any, screen), screen.singles(), case, cast(Any, None), {}, lambda share, text: None)
    assert done == tried
