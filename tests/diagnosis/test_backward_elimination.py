"""An answer of several effects is compared with its parts, fitted to the end, before it is given."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from effect_hypotheses import hypothesis, structure, trial

from sim_core.rigs import load_rig
from sysid.diagnosis import confirmation
from sysid.diagnosis import diagnose as diagnosing
from sysid.diagnosis.confirmation import confirmed_without, parts_to_fit
from sysid.diagnosis.refits import Trial, begun_without
from sysid.diagnosis.verdict import Case, Verdict
from sysid.model.parameters import fit_parameters, start_of
from sysid.solve.optimum import Fitted

LOUD = structure(5.0, 5000.0, 1000.0)
QUIET = structure(1.1, 100.0, 1000.0)
BOTH = replace(trial("camera_pose gel_stiffness_gradient", 3000.0), confirmed=True)


def verdict_of(
    monkeypatch: pytest.MonkeyPatch, parts: dict[str, Trial | None], known: tuple[Trial, ...] = ()
) -> tuple[Verdict, list[str]]:
    """The verdict where both effects together are the answer and leave nothing, and the effects that were left out of
    it. ``parts``: what the others come to then, by the effect left out."""
    asked: list[str] = []

    def without(base: Any, whole: Trial, left_out: Any, failed: Any) -> Trial | None:
        asked.append(left_out.effect.name)
        return parts.get(left_out.effect.name)

    monkeypatch.setattr(diagnosing, "confirmed_without", without)
    monkeypatch.setattr(diagnosing, "confirmed", lambda base, one, failed: replace(one, confirmed=True))
    monkeypatch.setattr(diagnosing, "tempered", lambda base, trials: sorted(trials, key=lambda t: -t.gain))
    base = cast(Any, SimpleNamespace(reference=None))
    told = lambda share, text: None  # noqa: E731
    verdict, _ = diagnosing._confirmed(base, [BOTH, *known], Case(LOUD, None, 8.0), {}, told)
    return verdict, asked


def part(name: str, gain: float, left: Any, explained: float = 0.99, held_out: float = 0.1) -> Trial:
    return replace(trial(name, gain, explained, held_out, left), confirmed=True)


def test_a_companion_that_takes_away_nothing_visible_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """It wins hundreds of nats over thousands of samples, and yet the other effect leaves no misfit that stands out."""
    verdict, asked = verdict_of(
        monkeypatch,
        {
            "gel_stiffness_gradient": part("camera_pose", 2700.0, QUIET),
            "camera_pose": part("gel_stiffness_gradient", 300.0, LOUD, explained=0.1),
        },
    )
    assert sorted(asked) == ["camera_pose", "gel_stiffness_gradient"]
    assert [t.names for t in verdict.named] == [{"camera_pose"}] and verdict.kind == "named"


@pytest.mark.parametrize(
    "other",
    [
        part("camera_pose", 2700.0, structure(2.5, 2000.0, 100.0), explained=0.7),
        part("camera_pose", 2700.0, QUIET, held_out=-0.1),
        None,
    ],
    ids=["leaves a misfit", "predicts worse", "cannot be simulated"],
)
def test_an_effect_that_is_needed_stays(monkeypatch: pytest.MonkeyPatch, other: Trial | None) -> None:
    """And each is left out once, whatever came of it."""
    verdict, asked = verdict_of(monkeypatch, {"gel_stiffness_gradient": other})
    assert sorted(asked) == ["camera_pose", "gel_stiffness_gradient"]
    assert [t.names for t in verdict.named] == [BOTH.names]


def test_parts_that_are_known_well_enough_are_not_fitted_again() -> None:
    little = trial("gel_stiffness_gradient", 300.0, explained=0.1, left=LOUD)
    assert parts_to_fit(BOTH, [BOTH, little]) == [BOTH.hypotheses[1]]
    assert parts_to_fit(BOTH, [BOTH, little, part("camera_pose", 2700.0, QUIET)]) == []
    assert parts_to_fit(BOTH, [BOTH, little, trial("camera_pose", 2700.0)]) == [BOTH.hypotheses[1]]
    assert parts_to_fit(trial("camera_pose", 50.0), []) == []


def test_what_is_left_begins_where_the_answer_stands() -> None:
    rig = load_rig("gel_sensor")
    rig = rig.model_copy(update={"effects": {n: hypothesis(n).effect.example for n in BOTH.names}})
    names = ["gel.E_pa", "effects.camera_pose.x_m", "effects.gel_stiffness_gradient.x_per_m"]
    parameters = fit_parameters(rig, names)
    scaled = start_of(rig, parameters) + np.array([0.1, 0.2, 0.3])
    nothing = np.zeros((1, 1))
    fitted = Fitted(parameters, scaled, rig, nothing.ravel(), nothing, [], [], rig, 1, True, "")
    centre, left, at = begun_without(fitted, hypothesis("gel_stiffness_gradient"))
    assert [p.name for p in left] == [p.name for p in parameters[:2]]
    np.testing.assert_array_equal(at, scaled[:2])
    assert set(centre.effects) == {"camera_pose"}


@pytest.mark.parametrize("simulated", [True, False])
def test_a_part_comes_to_where_it_is_going_before_the_reference_model_is_asked(
    monkeypatch: pytest.MonkeyPatch, simulated: bool
) -> None:
    """What the reference model adds at the materials of the answer is no matter of a part whose materials differ."""
    whole, order = BOTH, []

    def refitted(base: Any, given: Trial, left_out: Any, failed: Any) -> Trial | None:
        order.append("beside what was known")
        assert given is whole and left_out is whole.hypotheses[1]
        return trial("camera_pose", 2500.0) if simulated else None

    def to_the_end(base: Any, hypotheses: Any, begun: Any, failed: Any) -> Trial:
        order.append("beside the reference model")
        return part("camera_pose", 2700.0, QUIET)

    monkeypatch.setattr(confirmation, "without", refitted)
    monkeypatch.setattr(confirmation, "fitted_to_the_end", to_the_end)
    base = cast(Any, SimpleNamespace(reference="finer cells"))
    found = confirmed_without(base, whole, whole.hypotheses[1], {})
    assert order == ["beside what was known", "beside the reference model"][: 2 if simulated else 1]
    assert (found is None) != simulated
