"""Verdicts from the outcome of fits."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from effect_hypotheses import hypothesis, structure, trial

from sim_core.rigs import load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.diagnosis import diagnose as diagnosing
from sysid.diagnosis.contradictions import contradictions
from sysid.diagnosis.refits import Trial, in_pose_noise
from sysid.diagnosis.report_notes import Screened, fates, other_branch, parts_alone
from sysid.diagnosis.residual_analysis import Part, Structure
from sysid.diagnosis.result import Located
from sysid.diagnosis.verdict import (
    Case,
    Verdict,
    cut_off,
    decide,
    missed_beside_mesh,
    needless,
    probabilities,
    rejected,
)
from sysid.diagnosis.wording import next_experiment, sentence
from sysid.fit.result import ChannelError
from sysid.model.parameters import fit_parameters, rig_at, start_of
from sysid.observations.observations import Run
from sysid.solve.optimum import Fitted

QUIET = structure(1.1, 100.0, 1000.0)
LOUD = structure(5.0, 5000.0, 1000.0)


@pytest.mark.parametrize(
    ("trials", "before", "kind"),
    [
        ([], QUIET, "nothing_missing"),
        ([], LOUD, "unknown"),
        ([trial("air_drag", 3.0)], QUIET, "nothing_missing"),
        ([trial("air_drag", 3.0)], LOUD, "unknown"),
        ([trial("air_drag", 40.0)], LOUD, "named"),
        ([trial("air_drag", 40.0, held_out=-0.1)], LOUD, "unknown"),
        # Size beside significance.
        ([trial("air_drag", 400.0, explained=0.05, left=LOUD)], LOUD, "unknown"),
        ([trial("air_drag", 400.0, explained=0.3, left=LOUD)], LOUD, "partly"),
        ([trial("air_drag", 400.0, explained=0.9, left=LOUD)], LOUD, "named"),
        ([trial("air_drag", 400.0, explained=0.9, there=0.3, left=LOUD)], LOUD, "partly"),
        ([trial("air_drag", 40.0), trial("stream_delay", 38.0)], LOUD, "one_of"),
        ([trial("air_drag", 40.0), trial("stream_delay", 38.0, explained=0.8)], LOUD, "named"),
        ([trial("air_drag", 40.0), trial("stream_delay", 20.0)], LOUD, "named"),
        # Structure that the discretisation error could leave is neither blamed on physics nor called nothing.
        ([], structure(5.0, 5000.0, 20000.0), "refine_discretisation"),
        ([trial("air_drag", 400.0, explained=0.4, left=structure(2.0, 3000.0, 7000.0))], LOUD, "named"),
    ],
)
def test_verdicts(trials, before, kind):
    assert decide(trials, Case(before, None, 5.0)).kind == kind


@pytest.mark.parametrize(
    ("found", "there", "kind"),
    [
        (replace(trial("air_drag", 20.0), predicts=30.0), QUIET, "nothing_missing"),
        (replace(trial("air_drag", 40.0, held_out=0.002), predicts=30.0), QUIET, "named"),
        (replace(trial("air_drag", 40.0), predicts=3.0), QUIET, "nothing_missing"),
        (trial("air_drag", 700.0), None, "nothing_missing"),
        # What is not fitted to the end yet may still come to win from block to block.
        (replace(trial("air_drag", 700.0), predicts=49.0, surely_predicts=1.8), QUIET, "named"),
        (
            replace(trial("air_drag", 700.0), predicts=49.0, surely_predicts=1.8, confirmed=True),
            QUIET,
            "nothing_missing",
        ),
        (replace(trial("air_drag", 700.0), predicts=49.0, surely_predicts=2.9, confirmed=True), QUIET, "named"),
    ],
)
def test_without_misfit_that_stands_out_held_out_recordings_have_to_speak_for_an_effect(
    found: Trial, there: Structure | None, kind: str
) -> None:
    """Fits of hundreds of markers gain hundreds of nats by following the few percent that careful models differ in."""
    assert decide([found], Case(QUIET, there, 5.0)).kind == kind


def test_what_does_not_stand_out_by_itself_is_not_said_to_be_gone() -> None:
    found = replace(trial("air_drag", 61.0), predicts=30.0)
    nowhere = Located((), {}, "")
    for before, there, said in ((QUIET, QUIET, "speak for it by 30 nats"), (LOUD, None, "95 % of the misfit beyond")):
        case = Case(before, there, 5.0)
        told = sentence(decide([found], case), nowhere, {}, case)
        assert said in told and ("gone" in told) == (before is LOUD)


BOTH = {"air_drag", "stream_delay"}


@pytest.mark.parametrize(
    ("more", "alone_leaves", "both_leave", "names"),
    [
        (4.0, (LOUD, None), (QUIET, None), {"air_drag"}),
        (20.0, (LOUD, None), (QUIET, None), BOTH),
        # Of thousands of markers a drift gains thousands of nats that takes away a few percent of what is left.
        (2000.0, (LOUD, None), (structure(4.6, 4500.0, 1000.0), None), {"air_drag"}),
        (2000.0, (LOUD, None), (structure(2.8, 2300.0, 1000.0), None), BOTH),
        # Where the first effect leaves nothing that stands out, no other is asked for.
        (2000.0, (QUIET, None), (structure(1.01, 10.0, 1000.0), None), {"air_drag"}),
        # What acts in recordings held out alone is told there.
        (2000.0, (QUIET, LOUD), (QUIET, QUIET), BOTH),
        (2000.0, (QUIET, LOUD), (QUIET, LOUD), {"air_drag"}),
    ],
)
def test_a_second_effect_has_to_be_needed(more: float, alone_leaves: Any, both_leave: Any, names: set[str]) -> None:
    alone = replace(trial("air_drag", 400.0), left=alone_leaves[0], left_there=alone_leaves[1])
    both = replace(
        trial("stream_delay", 400.0 + more),
        hypotheses=(*alone.hypotheses, hypothesis("stream_delay")),
        left=both_leave[0],
        left_there=both_leave[1],
    )
    case = Case(LOUD, None, 5.0)
    verdict = decide([both, alone], case)
    assert verdict.kind == "named" and set(verdict.named[0].names) == names
    assert bool(needless(both, [alone], case)) == (names != BOTH)
    assert not needless(both, [], case), "no part of it may be an answer"


def test_a_second_effect_that_is_not_told_from_none_is_no_part_of_an_answer() -> None:
    both = replace(
        trial("stream_delay", 900.0),
        hypotheses=(hypothesis("air_drag"), hypothesis("stream_delay")),
        idle="that a stream is late, by 0.9 standard deviations",
    )
    assert "not told from none that a stream is late" in rejected(both, Case(LOUD, None, 5.0))
    assert decide([both, trial("air_drag", 400.0)], Case(LOUD, None, 5.0)).named[0].names == {"air_drag"}


def test_an_effect_that_changes_no_reading_by_its_noise_is_no_answer() -> None:
    """However significant: with thousands of samples, what careful models differ in is."""
    small = replace(trial("air_drag", 4000.0), change=0.3)
    assert "no reading by more than 0.3" in rejected(small, Case(LOUD, None, 5.0))
    assert decide([small], Case(QUIET, None, 5.0)).kind == "nothing_missing"
    assert not rejected(replace(small, change=1.3), Case(LOUD, None, 5.0))


@pytest.mark.parametrize(("play_m", "within"), [(1.5e-5, True), (3.0e-5, False)])
def test_a_play_within_the_noise_of_the_poses_is_none(small_rig: Any, play_m: float, within: bool) -> None:
    """20 um and 0.1 mrad of noise: poses are smoothed, and reversals rounded by about as much."""
    rig = small_rig(effects={"hand_backlash": {"play_m": play_m, "play_deg": 1e-3}})
    t = np.linspace(0.0, 1.0, 5)
    poses = PoseTrajectory(t, np.zeros((5, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (5, 1)), noise=(2e-5, 1e-4))
    run = Run("run", "", (), {"finger": poses}, (), 1.0)
    told = in_pose_noise([hypothesis("hand_backlash")], rig, [run])
    assert bool(told) == within
    assert not in_pose_noise([hypothesis("hand_backlash")], rig, [replace(run, poses={})]), "exact poses have no noise"
    if within:
        found = replace(trial("hand_backlash", 400.0), in_pose_noise=told)
        assert "the hand has play, but within the noise" in rejected(found, Case(LOUD, None, 5.0))


@pytest.mark.parametrize(
    ("gain", "converged", "confirmed", "before", "goes_on"),
    [
        (400.0, False, False, LOUD, True),
        (400.0, True, False, LOUD, False),
        (400.0, False, True, LOUD, False),
        (3.0, False, False, LOUD, False),
        (400.0, False, False, QUIET, False),
    ],
)
def test_what_was_cut_off_is_fitted_on_before_the_unknown_is_told(gain, converged, confirmed, before, goes_on) -> None:
    """A refit that predicts worse where it was cut off, with evidence enough."""
    case = Case(before, None, 4.0)
    fitted = cast(Fitted, SimpleNamespace(converged=converged))
    best = replace(trial("air_drag", gain, held_out=-0.1), fitted=fitted, confirmed=confirmed)
    other = replace(trial("stream_delay", 1.0, held_out=-0.1), fitted=fitted)
    trials = [other, best]
    assert cut_off(trials, decide(trials, case), case) == ([best] if goes_on else [])


@pytest.mark.parametrize("held_out", [0.3, -0.1])
def test_what_was_cut_off_is_the_answer_if_it_predicts_once_it_is_fitted(monkeypatch, held_out) -> None:
    best = replace(trial("air_drag", 400.0, held_out=-0.1), fitted=cast(Fitted, SimpleNamespace(converged=False)))
    to_the_end = replace(best, held_out=held_out, confirmed=True)
    monkeypatch.setattr(diagnosing, "confirmed", lambda base, trial, failed: to_the_end)
    monkeypatch.setattr(diagnosing, "tempered", lambda base, trials: list(trials))
    base = cast(Any, SimpleNamespace(reference=None))
    verdict, trials = diagnosing._confirmed(base, [best], Case(LOUD, None, 4.0), {}, lambda share, text: None)
    assert trials == [to_the_end]
    assert verdict.kind == ("named" if held_out > 0.0 else "unknown")


def test_numbers_that_predict_another_branch_than_the_answer_are_told(small_rig) -> None:
    rig = small_rig()
    fitted = cast(Fitted, SimpleNamespace(rig=rig_at(rig, [], np.zeros(0)), parameters=[]))
    other = rig.model_copy(update={"gravity_m_s2": (0.0, 0.0, -9.8)})
    same, elsewhere = (
        replace(trial("air_drag", 40.0), fitted=fitted, predicted=cast(Fitted, SimpleNamespace(rig=r)))
        for r in (rig, other)
    )
    assert other_branch(same) == "" == other_branch(trial("air_drag", 40.0))
    assert "may snap the other way" in other_branch(elsewhere)


def test_what_only_held_out_recordings_show_is_missing_too():
    assert decide([], Case(QUIET, QUIET, 5.0)).kind == "nothing_missing"
    assert decide([], Case(QUIET, LOUD, 5.0)).kind == "unknown"


def test_a_mesh_that_is_too_coarse_and_recordings_at_fault_are_verdicts_of_their_own():
    assert decide([], Case(QUIET, None, 5.0, coarse=("It is coarse.",))).kind == "refine_discretisation"
    assert decide([], Case(LOUD, None, 5.0, faults=("It jumps.",))).kind == "recording_fault"
    assert decide([trial("air_drag", 40.0)], Case(LOUD, None, 5.0, faults=("It jumps.",))).kind == "named"


def test_the_null_of_the_case_sets_what_is_needed():
    assert decide([trial("air_drag", 40.0)], Case(LOUD, None, 60.0)).kind == "unknown"
    assert "40.0 of 60.0 nats" in rejected(trial("air_drag", 40.0), Case(LOUD, None, 60.0))


def test_a_loud_quantity_is_not_drowned_by_quiet_ones():
    quiet = tuple(Part(0.0, 1500, 10.0) for _ in range(4))
    torque = Part(16.0 * 72, 72, 10.0)
    assert Structure((*quiet, torque)).whole.per_score < 1.3
    assert Structure((*quiet, torque)).missing
    assert not Structure((*quiet, Part(0.7 * 10, 10, 0.1))).missing, "ten scores say little"
    assert Structure((*quiet, replace(torque, own=1e5))).hidden


def test_an_amplitude_that_may_be_none_is_no_answer():
    case = Case(LOUD, None, 5.0)
    shaky = replace(trial("sheet_orthotropy", 95.0), significance=1.8)
    assert decide([shaky], case).kind == "unknown"
    assert "1.8 of 2.5 deviations" in rejected(shaky, case)
    assert decide([replace(shaky, significance=4.0)], case).kind == "named"


def test_the_best_comes_first_and_probabilities_follow_the_evidence():
    trials = [trial("air_drag", 20.0), trial("stream_delay", 23.0), trial("gel_relaxation", 2.0)]
    case = Case(LOUD, None, 5.0)
    verdict = decide(trials, case)
    assert [t.names for t in verdict.named] == [{"stream_delay"}, {"air_drag"}]
    chances = probabilities(trials, case)
    assert chances[frozenset({"stream_delay"})] / chances[frozenset({"air_drag"})] == pytest.approx(np.exp(3.0))
    assert sum(chances.values()) < 1.0 + 1e-12


def test_an_answer_that_predicts_one_quantity_worse_is_none() -> None:
    """However much it gains in all others."""
    best = replace(trial("air_drag", 700.0), worse="the force of wrench in rec_04, 0.0147 -> 0.0186 N")
    case = Case(LOUD, LOUD, 5.0)
    assert decide([trial("air_drag", 700.0)], case).kind == "named"
    assert decide([best], case).kind == "unknown"
    assert rejected(best, case) == "it predicts worse: the force of wrench in rec_04, 0.0147 -> 0.0186 N"


def _camera_at(shift: float) -> Fitted:
    """A fit of a modulus, at the rig's value, and of a principal point known within 5 px."""
    rig = load_rig("gel_sensor")
    modulus, centre = fit_parameters(rig, ["gel.E_pa", "inside.cx_px"])
    parameters = [modulus, replace(centre, prior_sd=5.0, nuisance=True)]
    scaled = start_of(rig, parameters) + [0.0, shift]
    nothing = np.zeros(0)
    return Fitted(parameters, scaled, rig, nothing, np.zeros((0, 2)), [], [], rig, 1, True, "")


@pytest.mark.parametrize(("shift", "found", "said"), [(12.0, 0, False), (-17.5, 1, False), (26.0, 1, True)])
def test_nothing_is_missing_only_if_what_the_rig_says_is_wrong(shift: float, found: int, said: bool) -> None:
    """A camera that was knocked is taken up by the principal point, however far that is from what is known."""
    told = contradictions(_camera_at(shift))
    assert [c.name for c in told] == ["inside.cx_px"] * found
    if found:
        assert told[0].deviations == pytest.approx(abs(shift) / 5.0)
    case = Case(QUIET, None, 5.0, contradictions=told)
    verdict = decide([], case)
    text = sentence(verdict, Located((), {}, ""), {}, case)
    assert verdict.kind == "nothing_missing"
    assert text.startswith("Nothing is missing if inside.cx_px is " if said else "Nothing is missing: ")
    assert ("5.2 times as far off" in text) == said
    assert ("inside.cx_px" in next_experiment(verdict, case)) == said


@pytest.mark.parametrize(
    ("missed", "mesh", "kind"),
    [
        (17.6, 8.5, "refine_discretisation"),
        (2.7, 8.5, "nothing_missing"),
        (17.6, 1.5, "nothing_missing"),
        (50.0, 8.5, "nothing_missing"),
        (9.0, 8.5, "nothing_missing"),
    ],
)
def test_what_the_error_of_the_mesh_may_hide_is_no_proof_that_nothing_is_missing(missed, mesh, kind) -> None:
    """Force errors over a noise of 2 mN; another recording of the quantity is explained."""
    errors = [ChannelError(run, "wrench", "force", "N", 2e-3 * m, 2e-3 * m, 2e-3, False, own=2e-3 * mesh)
              for run, m in (("press", 1.1), ("deeper", missed))]  # fmt: skip
    case = Case(QUIET, None, 5.0, missed=missed_beside_mesh(errors))
    verdict = decide([], case)
    assert verdict.kind == kind
    assert decide([trial("air_drag", 40.0)], replace(case, before=LOUD)).kind == "named"
    if case.missed:
        text = sentence(verdict, Located((), {}, ""), {}, case)
        assert (
            "the force of wrench in deeper by 18 times its noise" in text and "more than the 8 times by which" in text
        )


def test_of_an_answer_of_two_effects_each_part_is_told() -> None:
    """That part which would be an answer, and that which predicts worse."""
    first, second = trial("air_drag", 400.0, explained=0.5), trial("gel_relaxation", 300.0, held_out=-0.02)
    both = replace(trial("air_drag", 900.0), hypotheses=(*first.hypotheses, *second.hypotheses))
    case = Case(LOUD, None, 5.0)
    told = parts_alone([both, first, second], Verdict("named", (both,)), case)
    assert len(told) == 2
    assert told[0].startswith("That ") and "alone explains 50 %" in told[0] and "takes away most" in told[0]
    assert "held-out recordings worse, by 2 %" in told[1] and "converge" not in " ".join(told)
    cut = replace(first, fitted=cast(Fitted, SimpleNamespace(converged=False)))
    (said, _) = parts_alone([both, cut, second], Verdict("named", (both,)), case)
    assert said.endswith("(its fit did not converge).")
    assert parts_alone([first, second], Verdict("named", (first,)), case) == []


def test_what_became_of_a_pair_is_not_told_of_its_effects_alone() -> None:
    """A pair that predicts worse says nothing of an effect that was tried alone, and of another one only beside it."""
    case = Case(structure(5.0, 5000.0, 1000.0), None, 8.0)
    pair = trial("gel_relaxation gel_mullins", 500.0, held_out=-0.1)
    trials = [pair, trial("gel_relaxation", 300.0)]
    screened = Screened(cast(Any, None), [], {})
    became = fates(load_rig("gel_sensor"), Verdict("unknown", ()), trials, case, screened)
    relaxes = pair.hypotheses[0].effect.title
    assert became["gel_mullins"].startswith(f"tried beside the knowledge that {relaxes} only: it predicts held-out")
    assert "beside" not in became["gel_relaxation"]
