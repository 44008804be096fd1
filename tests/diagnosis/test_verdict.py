"""Verdicts from the outcome of fits, and the whitening and noise they rest on."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.effects import effect_by_name
from sim_core.rigs import load_rig
from sim_core.rigs.trajectory import PoseTrajectory
from sysid.diagnosis import diagnose as diagnosing
from sysid.diagnosis.candidates import Amplitude, Hypothesis
from sysid.diagnosis.contradictions import contradictions
from sysid.diagnosis.evidence import (
    deviations,
    distance_from_none,
    held_out_gain,
    inflation_of,
    log_evidence,
    log_likelihood_ratio,
    significance,
)
from sysid.diagnosis.refits import Trial, in_pose_noise
from sysid.diagnosis.report_notes import other_branch, parts_alone
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
from sysid.model.parameters import FitParameter, fit_parameters, rig_at, start_of
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.whitening import whiten
from sysid.observations.observations import Run
from sysid.solve.covariance import uncertainty
from sysid.solve.optimum import Fitted


def structure(per_score: float, excess: float, own: float) -> Structure:
    return Structure((Part(excess, round(excess / (per_score - 1.0)), own),))


def hypothesis(name: str) -> Hypothesis:
    effect = effect_by_name(name)
    sizes = [p for p in effect.parameters if p.vanishing is not None]
    return Hypothesis(name, effect, {}, tuple(Amplitude(p, p.vanishing or 0.0, p.typical[0]) for p in sizes))


def trial(
    name: str,
    gain: float,
    explained: float = 0.95,
    held_out: float | None = 0.3,
    left: Structure | None = None,
    there: float | None = None,
) -> Trial:
    return Trial(
        (hypothesis(name),),
        cast(Fitted, SimpleNamespace()),
        gain,
        explained,
        there,
        left or structure(1.1, 100, 1e3),
        held_out,
        9.0,
        None,
    )


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


def test_the_distance_from_none_is_that_of_the_size_which_is_farthest() -> None:
    h = hypothesis("wrench_offset")
    names = [f"effects.wrench_offset.{a.parameter.name}" for a in h.amplitudes[:2]]
    parameters = [FitParameter(n, "", False, -10.0, 10.0, 1.0, "") for n in names]
    at, sd = np.array([0.3, -0.8]), np.array([0.1, 0.2])
    j = np.diag(1.0 / sd)
    n = 400
    table = np.repeat(j, n, axis=0) / np.sqrt(n)
    noise = np.random.default_rng(0).choice([-1.0, 1.0], size=2 * n)
    fitted = Fitted(
        parameters, at, cast(Any, None), noise, table, [(0, "wrist", np.tile(np.arange(n, dtype=float), 2))], [],
        cast(Any, None), 1, True, "", {},
    )  # fmt: skip
    expected = np.abs(at / uncertainty(fitted).sd).max()
    assert distance_from_none(h, fitted, uncertainty(fitted)) == pytest.approx(expected)
    assert expected == pytest.approx(4.0, rel=0.2)


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


def fitted_with(columns, residual, parameters):
    nothing, labels = cast(Any, None), [(0, "gauge", np.linspace(0.0, 1.0, len(residual)))]
    scaled = np.zeros(len(parameters))
    return Fitted(parameters, scaled, nothing, residual, columns, labels, [], nothing, 1, True, "")


def test_an_improvement_is_worth_less_where_misfit_is_smooth_in_time():
    """White misfit leaves the likelihood ratio as it is; misfit that drifts over the run deflates it."""
    rng = np.random.default_rng(0)
    drag = [FitParameter("effects.air_drag.drag_coefficient", "-", False, 0.0, 9.0, 1.0, "")]
    column = np.ones((600, 1))
    white = rng.standard_normal(600)
    smooth = white + 2.0 * np.sin(np.linspace(0.0, 2.0 * np.pi, 600))
    effect = hypothesis("air_drag")
    inflated = [
        inflation_of(effect, f, uncertainty(f)) for f in (fitted_with(column, r, drag) for r in (white, smooth))
    ]
    assert significance(inflated[0], 50.0) == pytest.approx(10.0, rel=0.35)
    assert significance(inflated[1], 50.0) < 2.5


def test_an_amplitude_known_only_as_a_ratio_is_no_reason_for_doubt():
    """Drag and density both scale with an unknown factor; that neither is known alone says nothing of drag."""
    rng = np.random.default_rng(0)
    names = ("effects.air_drag.drag_coefficient", "strip.density_kg_m3")
    both = [FitParameter(n, "-", False, 0.0, 9.0, 1.0, "") for n in names]
    shape = rng.standard_normal(600)
    columns = np.column_stack([shape, -shape])
    fitted = fitted_with(columns, rng.standard_normal(600), both)
    assert significance(inflation_of(hypothesis("air_drag"), fitted, uncertainty(fitted)), 800.0) > 20.0


def test_the_best_comes_first_and_probabilities_follow_the_evidence():
    trials = [trial("air_drag", 20.0), trial("stream_delay", 23.0), trial("gel_relaxation", 2.0)]
    case = Case(LOUD, None, 5.0)
    verdict = decide(trials, case)
    assert [t.names for t in verdict.named] == [{"stream_delay"}, {"air_drag"}]
    chances = probabilities(trials, case)
    assert chances[frozenset({"stream_delay"})] / chances[frozenset({"air_drag"})] == pytest.approx(np.exp(3.0))
    assert sum(chances.values()) < 1.0 + 1e-12


def test_held_out_gain_is_not_decided_by_a_few_samples():
    rng = np.random.default_rng(0)
    plain = rng.standard_normal(2000) * 1.5
    better = plain / 1.5
    assert held_out_gain(plain, better) > 0.3
    spiked = better.copy()
    spiked[:2] = 30.0
    assert held_out_gain(plain, spiked) > 0.2
    assert held_out_gain(better, plain) < 0.0


def test_likelihood_on_held_out_recordings_speaks_for_what_is_there_and_against_what_followed_noise():
    """A column of norm d that is missing is worth d^2 / 2 nats on average, less by mean curvature of the robust loss
    under noise; one that is fitted to the noise of other recordings of the same length costs half a nat on average."""
    rng = np.random.default_rng(0)
    shape = rng.standard_normal(4000)
    shape *= 6.0 / np.linalg.norm(shape)
    there, chance = [], []
    for _ in range(60):
        noise = rng.standard_normal(4000)
        there.append(log_likelihood_ratio(noise + shape, noise).sum())
        chance.append(log_likelihood_ratio(noise, noise - rng.standard_normal() * shape / 6.0).sum())
    nodes, weights = np.polynomial.hermite_e.hermegauss(60)
    curvature = weights @ (1.0 + nodes**2 / 9.0) ** -1.5 / weights.sum()
    assert np.mean(there) == pytest.approx(18.0 * curvature, rel=0.1)
    assert np.mean(chance) == pytest.approx(-0.5, abs=0.3)
    assert max(chance) < 5.0
    loud = 3.0 * rng.standard_normal(4000)
    assert log_likelihood_ratio(loud + shape, loud).sum() < 0.5 * np.mean(there), "tempered by what is left"


def test_a_likelihood_ratio_counts_by_how_steady_it_is_where_models_differ():
    """What is right wherever it acts, all the time or in a sixth of it, against what is right in each other block and
    wrong by less between. And chance is within two deviations mostly, whichever model is nearer."""
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((48, 50))

    def found(plain: np.ndarray, amended: np.ndarray) -> float:
        ratios = log_likelihood_ratio(plain.ravel(), amended.ravel()).reshape(48, 50).sum(1)
        return deviations(ratios, ((plain - amended) ** 2).sum(1))

    block = np.arange(48)[:, None]
    missing = np.full((48, 50), 0.6)
    assert found(noise + missing, noise) > 8.0
    assert found(noise + missing * (block < 8), noise) > 5.0
    assert found(noise, noise + missing) < -8.0
    taken = np.where(block % 2 == 0, missing, 0.0)
    given = np.where(block % 2 == 0, 0.0, 0.8 * missing)
    assert 0.0 < found(noise + taken, noise + given) < 2.5
    chance = []
    for _ in range(40):
        change = 0.1 * rng.standard_normal(noise.shape)
        chance.append(found(noise + 0.5 * change, noise - 0.5 * change))
    assert np.mean(np.abs(chance) > 2.5) <= 0.05
    assert found(noise, noise) == 0.0
    assert found(noise + missing * (block == 3), noise) == 0.0, "one block alone says nothing of others"


def test_whitening_makes_coloured_noise_white():
    rng = np.random.default_rng(1)
    rho, sigma = 0.7, 0.02
    noise = np.zeros((20000, 1))
    for k in range(1, len(noise)):
        noise[k] = rho * noise[k - 1] + sigma * np.sqrt(1 - rho**2) * rng.standard_normal(1)
    white = whiten(noise, ChannelNoise(np.array([sigma]), rho, "test"), np.arange(len(noise)) / 100.0)
    assert np.std(white) == pytest.approx(1.0, abs=0.02)
    assert np.mean(white[1:] * white[:-1]) == pytest.approx(0.0, abs=0.03)


@pytest.mark.parametrize("temper", [1.0, 10.0])
def test_evidence_does_not_depend_on_where_a_search_of_a_linear_model_ended(temper):
    rng = np.random.default_rng(0)
    parameter = FitParameter("a", "-", False, -9.0, 9.0, 0.5, "")
    slope, miss = rng.standard_normal(50), rng.standard_normal(50)

    def at(value):
        jacobian = np.append(slope, 1.0 / parameter.prior_sd)[:, None]
        residual = np.append(miss + slope * value, value / parameter.prior_sd)
        return cast(Fitted, SimpleNamespace(
            parameters=[parameter], pulls=1, jacobian=jacobian, residual=residual,
            chi2=float(residual @ residual)))  # fmt: skip

    best = -(slope @ miss) / temper / (slope @ slope / temper + parameter.prior_sd**-2)
    values = [log_evidence(at(value), temper) for value in (best, best + 0.3, 0.0)]
    assert values == pytest.approx([values[0]] * 3, abs=1e-9)
    data, pull = miss + slope * best, best / parameter.prior_sd
    exact = -0.5 * (data @ data / temper + pull**2)
    width = -0.5 * np.log((slope @ slope / temper + parameter.prior_sd**-2) * parameter.prior_sd**2)
    assert values[0] == pytest.approx(exact + width, abs=1e-9)


@pytest.mark.parametrize("temper", [1.0, 10.0, 1000.0])
def test_a_parameter_that_the_data_do_not_touch_is_no_evidence(temper):
    rng = np.random.default_rng(0)
    known = FitParameter("a", "-", False, -9.0, 9.0, 0.5, "")
    idle = FitParameter("b", "-", False, -9.0, 9.0, 3.0, "")
    slope, miss = rng.standard_normal((50, 1)), rng.standard_normal(50)

    def fitted(parameters, columns):
        jacobian = np.vstack([columns, np.diag([1.0 / p.prior_sd for p in parameters])])
        residual = np.concatenate([miss, np.zeros(len(parameters))])
        return cast(Fitted, SimpleNamespace(
            parameters=parameters, pulls=len(parameters), jacobian=jacobian, residual=residual,
            chi2=float(residual @ residual)))  # fmt: skip

    alone = log_evidence(fitted([known], slope), temper)
    beside = log_evidence(fitted([known, idle], np.hstack([slope, np.zeros((50, 1))])), temper)
    assert beside == pytest.approx(alone, abs=1e-9)


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
    assert "held-out recordings worse, by 2 %" in told[1]
    assert parts_alone([first, second], Verdict("named", (first,)), case) == []
