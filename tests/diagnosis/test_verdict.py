"""Verdicts and their sentences from posteriors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_core.rigs import load_rig
from sysid.comparison.explanations import UNKNOWN
from sysid.comparison.ledger import Column, Ledger, blocks_of
from sysid.comparison.posterior import Model, Posterior, posterior
from sysid.diagnosis.contradictions import contradictions
from sysid.diagnosis.report_notes import outcome_by_effect
from sysid.diagnosis.result import Located, LocatedChannel
from sysid.diagnosis.verdict import Verdict, hidden_by_mesh, verdict_of
from sysid.diagnosis.wording import next_experiment, sentence
from sysid.model.parameters import fit_parameters, rig_at, start_of
from sysid.solve.optimum import Fitted

PLACES = {
    "gel_relaxation": "gel",
    "air_drag": "environment",
    "stream_delay": "clock",
    "end_effector_compliance": "robot",
    f"{UNKNOWN}gel": "gel",
    f"{UNKNOWN}wrench": "wrench",
}
GEL, WRENCH = f"{UNKNOWN}gel", f"{UNKNOWN}wrench"
LOCATED = Located((LocatedChannel("wrist", "force", 0.8),), {"press": ((0.1, 0.4),)}, "holding in contact")
T = np.linspace(0.0, 1.0, 200)


def said(*sets: tuple[tuple[str, ...], float]) -> Posterior:
    """A posterior of sets with their probabilities; nothing missing has the rest."""
    rest = 1.0 - sum(p for _, p in sets)
    models = [Model(names, names, (), 0.0, p) for names, p in [*sets, ((), rest)]]
    return Posterior(tuple(sorted(models, key=lambda m: -m.probability)), PLACES)


@pytest.mark.parametrize(
    ("found", "kind", "answer"),
    [
        (said((("air_drag",), 0.3)), "nothing_missing", ()),
        (said((("air_drag",), 0.95)), "named", ("air_drag",)),
        (said((("air_drag", "stream_delay"), 0.97)), "named", ("air_drag", "stream_delay")),
        (said((("air_drag",), 0.6), (("stream_delay",), 0.38)), "one_of", ("air_drag", "stream_delay")),
        # What else may be missing in addition to the answer is no other answer.
        (said((("air_drag",), 0.6), (("air_drag", "stream_delay"), 0.38)), "named", ("air_drag",)),
        (said(((GEL,), 0.8), (("gel_relaxation",), 0.15)), "unknown", ()),
        (said((("gel_relaxation",), 0.7), ((GEL,), 0.25)), "named", ("gel_relaxation",)),
        (said((("air_drag", WRENCH), 0.8), (("air_drag",), 0.15)), "partly", ("air_drag",)),
    ],
)
def test_the_most_probable_set_is_the_answer(found: Posterior, kind: str, answer: tuple[str, ...]) -> None:
    verdict = verdict_of(found)
    assert (verdict.kind, verdict.answer) == (kind, answer)
    text = sentence(verdict, LOCATED, 0.7, 12)
    for name, clause in (("air_drag", "slows"), ("gel_relaxation", "the gel relaxes")):
        assert (clause in text) == (name in answer) or name == "air_drag"
    assert ("no known effect describes" in text) == (kind in ("unknown", "partly"))


def test_a_sentence_has_probability_size_and_place() -> None:
    text = sentence(verdict_of(said((("gel_relaxation",), 0.93))), LOCATED, 0.82, 12)
    assert "the gel relaxes (probability 93 %)" in text
    assert "82 % of the misfit beyond noise is gone" in text
    assert "most in the force of wrist (80 % of it), mostly while holding in contact" in text
    unknown = sentence(verdict_of(said(((GEL,), 0.9))), LOCATED, 0.0, 12)
    assert "no known effect describes (probability 90 %)" in unknown and "missing in the gel (90 %)" in unknown
    nothing = sentence(verdict_of(said((("air_drag",), 0.2))), LOCATED, 0.0, 12)
    assert "Nothing is missing (probability 80 %): 12 effects" in nothing


def test_recordings_held_out_that_are_missed_by_far_are_said() -> None:
    verdict = replace(verdict_of(said((("air_drag",), 0.01))), kind="unknown")
    text = sentence(verdict, LOCATED, 0.0, 12, "This is no success.")
    assert "in recordings held out it shows. This is no success." in text


def test_every_verdict_proposes_something() -> None:
    kinds = ("nothing_missing", "named", "one_of", "partly", "unknown", "refine_discretisation", "recording_fault")
    named = verdict_of(said((("gel_relaxation",), 0.95)))
    found = {kind: next_experiment(replace(named, kind=kind)) for kind in kinds}
    assert all(found.values()) and "finer cells" in found["refine_discretisation"]
    assert "twins" in found["named"]


def ledger(mesh: float, law: float) -> Ledger:
    """Of readings with a mesh error of ``mesh`` times its expected size, and a law of the size ``law``, which looks
    much like it."""
    shape, course = 6.0 * np.sin(3.0 * T), np.sin(3.0 * T + 0.02) * 6.0
    y = mesh * shape + law * course + np.random.default_rng(1).standard_normal(len(T))
    free = ("", "", {}, "size", "1", 0.0, 1.0, False)
    columns = (
        Column("effect", "gel_relaxation", "gel", "as it is", {}, "share", "-", 0.0, 1.0, False, 0.0, 1.0, False,
               -np.inf, np.inf),
        Column("approximation", "mesh", *free, 1.0, 0.3, False, -np.inf, np.inf),
    )  # fmt: skip
    rows = np.column_stack([-course, -shape, y])
    return Ledger(columns, tuple(blocks_of("press", 1.0, T, np.ones(len(T), dtype=bool), rows, 4)), {})


def test_what_a_mesh_error_twice_as_uncertain_explains_asks_for_finer_cells() -> None:
    """Readings that are off like the mesh, by ten times what is expected of it, are most probably a law that looks like
    it, and nothing missing with a mesh error twice as uncertain; not so where no mesh makes up for a law."""
    assert posterior(ledger(4.0, 0.0), bags=0).nothing < 0.05
    assert hidden_by_mesh(ledger(4.0, 0.0))
    assert posterior(ledger(1.0, 4.0), bags=0).nothing < 0.05
    assert not hidden_by_mesh(ledger(1.0, 4.0))


def test_what_became_of_each_effect_is_its_probability() -> None:
    rig = load_rig("card_press")
    verdict = verdict_of(said((("gel_relaxation",), 0.93), (("end_effector_compliance",), 0.04)))
    found = outcome_by_effect(rig, verdict, {"contact_adhesion": "could not be simulated"})
    assert found["gel_relaxation"] == "the answer" and found["end_effector_compliance"] == "probability 4 %"
    assert found["contact_adhesion"] == "could not be simulated"
    assert found["stream_delay"] == "probability less than 1 %"


@pytest.mark.parametrize(("shift", "found"), [(0.1, 0), (5.0, 1)])
def test_a_number_far_from_what_the_rig_says_is_a_contradiction(shift: float, found: int) -> None:
    rig = load_rig("card_press")
    (p,) = fit_parameters(rig, ["card.E"])
    at = start_of(rig, [p]) + shift * p.prior_sd
    fitted = Fitted([p], at, rig_at(rig, [p], at), np.zeros(1), np.zeros((1, 1)), [], [], rig, 1, True, "")
    assert len(contradictions(fitted)) == found


def test_probabilities_of_a_verdict_are_of_effects_and_of_places() -> None:
    verdict = verdict_of(said((("gel_relaxation",), 0.5), ((GEL,), 0.3), (("air_drag",), 0.1)))
    assert isinstance(verdict, Verdict)
    assert verdict.effects == pytest.approx({"gel_relaxation": 0.5, "air_drag": 0.1})
    assert verdict.places == pytest.approx({"gel": 0.8, "environment": 0.1})
    assert verdict.unknown == pytest.approx(0.3) and verdict.nothing == pytest.approx(0.1)
