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

    def without(base: Any, whole: Trial, left_out: Any, known: Any, failed: Any) -> Trial | None:
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
    assert "gel_stiffness_gradient" in asked
    assert [t.names for t in verdict.named] == [{"camera_pose"}] and verdict.kind == "named"


def test_a_part_that_is_fitted_to_the_end_takes_the_place_of_what_was_known_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Though that had more evidence, beside other errors of the mesh. The part that promises most is asked first, and
    the other one not at all once the companion is gone."""
    cut = trial("camera_pose", 2750.0, explained=0.7, left=structure(2.5, 2000.0, 100.0))
    verdict, asked = verdict_of(monkeypatch, {"gel_stiffness_gradient": part("camera_pose", 2700.0, QUIET)}, (cut,))
    assert asked == ["gel_stiffness_gradient"]
    assert [t.names for t in verdict.named] == [{"camera_pose"}]


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


def test_a_set_that_was_fitted_twice_counts_once(monkeypatch: pytest.MonkeyPatch) -> None:
    verdict, _ = verdict_of(monkeypatch, {}, (replace(BOTH, gain=BOTH.gain - 2.0),))
    assert verdict.kind == "named" and [t.gain for t in verdict.named] == [BOTH.gain]


def test_parts_that_are_known_well_enough_are_not_fitted_again() -> None:
    little = trial("gel_stiffness_gradient", 300.0, explained=0.1, left=LOUD)
    assert parts_to_fit(BOTH, [BOTH, little]) == [BOTH.hypotheses[1]]
    assert parts_to_fit(BOTH, [BOTH, little, part("camera_pose", 2700.0, QUIET)]) == []
    assert parts_to_fit(BOTH, [BOTH, little, trial("camera_pose", 2700.0)]) == [BOTH.hypotheses[1]]
    cut_off = replace(little, fitted=cast(Fitted, SimpleNamespace(converged=False)))
    assert parts_to_fit(BOTH, [BOTH, cut_off, part("camera_pose", 2700.0, QUIET)]) == [BOTH.hypotheses[0]]
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


def fit(chi2: float, converged: bool = True) -> Fitted:
    return cast(Fitted, SimpleNamespace(chi2=chi2, converged=converged))


@pytest.mark.parametrize(
    ("found", "known", "begun"),
    [
        (900.0, None, 900.0),
        (900.0, 1000.0, 900.0),
        (900.0, 800.0, 800.0),
        (None, 800.0, 800.0),
        (None, None, None),
    ],
)
def test_a_part_comes_to_where_it_is_going_before_the_reference_model_is_asked(
    monkeypatch: pytest.MonkeyPatch, found: float | None, known: float | None, begun: float | None
) -> None:
    """What the reference model adds at the materials of the answer is no matter of a part whose materials differ. The
    better of two fits is gone on from."""

    def at(chi2: float | None) -> Trial | None:
        return None if chi2 is None else replace(trial("camera_pose", 2500.0), fitted=fit(chi2))

    def refitted(base: Any, given: Trial, left_out: Any, failed: Any) -> Trial | None:
        assert given is BOTH and left_out is BOTH.hypotheses[1]
        return at(found)

    def to_the_end(base: Any, hypotheses: Any, fitted: Any, failed: Any) -> Trial:
        return replace(part("camera_pose", 2700.0, QUIET), fitted=fitted)

    monkeypatch.setattr(confirmation, "without", refitted)
    monkeypatch.setattr(confirmation, "fitted_to_the_end", to_the_end)
    base = cast(Any, SimpleNamespace(reference="finer cells"))
    ended = confirmed_without(base, BOTH, BOTH.hypotheses[1], at(known), {})
    assert (None if ended is None else ended.fitted.chi2) == begun
    assert ended is None or ended.confirmed


@pytest.mark.parametrize("converged", [True, False])
def test_a_part_that_explains_too_little_is_not_fitted_to_the_end(
    monkeypatch: pytest.MonkeyPatch, converged: bool
) -> None:
    """Unless its fit was cut off."""
    little = replace(trial("camera_pose", 300.0, explained=0.1), fitted=fit(900.0, converged))
    monkeypatch.setattr(confirmation, "without", lambda *given: little)
    monkeypatch.setattr(confirmation, "fitted_to_the_end", lambda *given: part("camera_pose", 2700.0, QUIET))
    base = cast(Any, SimpleNamespace(reference="finer cells"))
    ended = confirmed_without(base, BOTH, BOTH.hypotheses[1], None, {})
    assert ended is not None and ended.confirmed != converged
