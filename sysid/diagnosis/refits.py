"""Real fits of the few sets of effects that the screening promises something of."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from sim_core.effects import RecordingScales
from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.candidates import Hypothesis
from sysid.diagnosis.evidence import deviations, distance_from_none, inflation_of, log_evidence, significance
from sysid.diagnosis.fits import fit_within
from sysid.diagnosis.predictability import predicted_held_out
from sysid.diagnosis.residual_analysis import Structure, largest_change, structure
from sysid.diagnosis.starts import Start, begun_at, best_starts
from sysid.diagnosis.validation import gain_of, ratios_of, seen_by_both
from sysid.discretisation.refinement import error_sizes
from sysid.fit.result import rms_errors
from sysid.model.parameters import FitParameter
from sysid.model.sparing_predictor import SparingPredictor
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.settings.solve import SOLVE
from sysid.solve.covariance import Uncertainty, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

OUT_OF_SIGHT = "it moves readings out of sight"
"""Why an effect is no answer that explains readings by hiding them."""


@dataclass(frozen=True)
class Trial:
    """A set of effects refitted. ``gain`` [nats]: log evidence over the baseline; ``explained``: share of the
    baseline's structured misfit that is gone, ``explained_there`` on recordings held out (None without); ``left``:
    what is left of it; ``held_out``: share of the robust misfit on held-out recordings that it removes (negative: it
    predicts worse), and ``predicts`` [nats] the log likelihood ratio for it there, ``surely_predicts`` that over its
    standard deviation by blocks of time (None without); ``worse``: what it predicts there worse than the baseline,
    in words (:func:`worse_there`); ``significance``: of the weakest of its effects
    (:func:`sysid.diagnosis.evidence.significance`); ``idle``: that of its several effects whose size the recordings
    do not tell from none beside the others, in words; ``inflations``: of the standard deviation of each effect's
    amplitude (:func:`sysid.diagnosis.evidence.inflation_of`); ``change``: of the predictions, over what readings may
    be off (:func:`sysid.diagnosis.residual_analysis.largest_change`); ``in_pose_noise``: that of its effects which
    moves hands by less than the noise of their poses, in words; ``failure``: why it is no answer whatever its figures;
    ``predicted``: the model on the recordings held out, and ``left_there`` what it leaves there; ``confirmed``: it was
    fitted to the end, beside simulations of the reference model with its effects."""

    hypotheses: tuple[Hypothesis, ...]
    fitted: Fitted
    gain: float
    explained: float
    explained_there: float | None
    left: Structure
    held_out: float | None
    significance: float
    predicted: Fitted | None
    failure: str = ""
    worse: str = ""
    confirmed: bool = False
    idle: str = ""
    change: float = np.inf
    in_pose_noise: str = ""
    predicts: float | None = None
    surely_predicts: float | None = None
    inflations: tuple[float, ...] = (1.0,)
    left_there: Structure | None = None

    @property
    def names(self) -> frozenset[str]:
        return frozenset(h.effect.name for h in self.hypotheses)

    @property
    def title(self) -> str:
        """The effects in words, as clauses."""
        return " and that ".join(h.effect.title for h in self.hypotheses)


def refit(problem: Problem, begun: Fitted, start: Start, scales: RecordingScales) -> Fitted:
    """Fit baseline and effects together. ``begun``: the model that the shift is counted from."""
    centre, parameters, at = begun_at(begun, start, scales)
    problem = copy(problem)
    problem.engine = SparingPredictor(problem.engine)
    return problem.fit(
        centre, parameters, at, max_evaluations=DIAGNOSIS.refit_evaluations, tolerance=DIAGNOSIS.refit_tolerance
    )


def refits_of(
    base: Baseline,
    problem: Problem,
    begun: Fitted,
    starts: Sequence[Start],
    scales: RecordingScales,
    failed: dict[str, str],
) -> list[tuple[Start, Fitted, Fitted | None]]:
    """Refit the most promising side by side; of several starts of one set the best, with the model on the recordings
    held out. ``problem``: that of ``begun``, from which the starts are. What fails is told in ``failed``."""
    starts = best_starts(problem, begun, starts, scales, failed)

    def attempt(start: Start) -> tuple[Start, Fitted, Fitted | None] | None:
        label = " and ".join(sorted(start.names))
        try:
            fitted = refit(problem, begun, start, scales)
            there = predicted_held_out(base.check, base.there, fitted)
        except ThinshellError as error:
            failed[label] = f"could not be simulated: {error}"
            return None
        if _hides(base.fitted, fitted) or _hides(base.there, there):
            failed[label] = OUT_OF_SIGHT
            return None
        return start, fitted, there

    with ThreadPoolExecutor(max(1, len(starts))) as threads:
        done = [found for found in threads.map(attempt, starts) if found is not None]
    best: dict[frozenset[str], tuple[Start, Fitted, Fitted | None]] = {}
    for start, fitted, there in done:
        if fitted.interrupted:
            raise KeyboardInterrupt
        if start.names not in best or fitted.chi2 < best[start.names][1].chi2:
            best[start.names] = (start, fitted, there)
    return list(best.values())


def trials_of(
    base: Baseline, begun: Fitted, starts: Sequence[Start], scales: RecordingScales, failed: dict[str, str]
) -> list[Trial]:
    """Refits beside the baseline's errors of mesh and time step, scored."""
    found = refits_of(base, base.problem, begun, starts, scales, failed)
    return [scored(base, start.whole, fitted, there) for start, fitted, there in found]


def scored(base: Baseline, hypotheses: tuple[Hypothesis, ...], fitted: Fitted, there: Fitted | None) -> Trial:
    """A fitted set of effects as a trial; ``there``: the model on the recordings held out."""
    before = structure(base.problem, base.fitted)
    left = structure(base.problem, fitted)
    both = seen_by_both(base.check, base.there, there)
    ratios = ratios_of(base.check, both)
    on_others = left_there = None
    if base.there is not None and there is not None:
        left_there = structure(base.check, there)
        on_others = explained(structure(base.check, base.there), left_there)
    gain = log_evidence(fitted, 1.0) - log_evidence(base.fitted, 1.0)
    known = uncertainty(fitted)
    inflations = tuple(inflation_of(h, fitted, known) for h in hypotheses)
    worth = min(significance(f, gain) for f in inflations)
    return Trial(hypotheses, fitted, gain, explained(before, left), on_others, left, gain_of(both), worth, there,
                 worse=worse_there(base, there), idle=idle_effect(hypotheses, fitted, known), inflations=inflations,
                 change=largest_change(base.problem, base.fitted, fitted),
                 in_pose_noise=in_pose_noise(hypotheses, fitted.rig, base.problem.runs),
                 left_there=left_there, predicts=None if ratios is None else float(ratios[0].sum()),
                 surely_predicts=None if ratios is None else deviations(*ratios))  # fmt: skip


def in_pose_noise(hypotheses: Sequence[Hypothesis], rig: Rig, runs: Sequence[Run]) -> str:
    """The effect that moves hands by a distance or an angle below the noise of their recorded poses, in words. To take
    that noise away poses are smoothed, which rounds reversals by about as much."""
    noise = np.max([poses.noise for run in runs for poses in run.poses.values()] or [(0.0, 0.0)], axis=0)
    least = {"m": float(noise[0]), "deg": float(np.rad2deg(noise[1]))}
    for h in hypotheses:
        sizes = [(abs(rig.effects[h.key][a.parameter.name] - a.none), a.parameter.unit) for a in h.amplitudes]
        if h.effect.slot == "robot" and all(unit in least and size < least[unit] for size, unit in sizes):
            return h.effect.title
    return ""


def idle_effect(hypotheses: Sequence[Hypothesis], fitted: Fitted, known: Uncertainty) -> str:
    """The effect of a set of several that is nearest to none, in words, if it is nearer than
    ``DIAGNOSIS.told_apart_sd`` standard deviations."""
    if len(hypotheses) < 2:
        return ""
    h = _idlest(hypotheses, fitted, known)
    least = distance_from_none(h, fitted, known)
    return f"that {h.effect.title}, by {least:.1f} standard deviations" if least < DIAGNOSIS.told_apart_sd else ""


def _idlest(hypotheses: Sequence[Hypothesis], fitted: Fitted, known: Uncertainty) -> Hypothesis:
    return min(hypotheses, key=lambda h: distance_from_none(h, fitted, known))


def without_idle(base: Baseline, trial: Trial, failed: dict[str, str]) -> Trial | None:
    """A set of several effects without the one that is not told from none beside the others (:func:`without`)."""
    return without(base, trial, _idlest(trial.hypotheses, trial.fitted, uncertainty(trial.fitted)), failed)


def without(base: Baseline, trial: Trial, left_out: Hypothesis, failed: dict[str, str]) -> Trial | None:
    """A set of several effects without one of them, fitted on from where the set stands (backward elimination); None,
    and why in ``failed``, where that cannot be simulated."""
    kept = tuple(h for h in trial.hypotheses if h is not left_out)
    centre, parameters, scaled = begun_without(trial.fitted, left_out)
    problem = copy(base.problem)
    problem.engine = SparingPredictor(base.problem.engine)
    try:
        fitted = fit_within(problem, DIAGNOSIS.refit_evaluations, centre, parameters, scaled, DIAGNOSIS.refit_tolerance)
        there = predicted_held_out(base.check, base.there, fitted)
    except ThinshellError as error:
        failed[" and ".join(sorted(h.effect.name for h in kept))] = f"could not be simulated: {error}"
        return None
    return None if _hides(base.fitted, fitted) or _hides(base.there, there) else scored(base, kept, fitted, there)


def begun_without(fitted: Fitted, left_out: Hypothesis) -> tuple[Rig, list[FitParameter], np.ndarray]:
    """Centre, parameters and their values in the fitted scale ``(p,)`` where a model stands, without one effect."""
    mine = [not p.target.startswith(f"effects.{left_out.key}.") for p in fitted.parameters]
    effects = {k: v for k, v in fitted.centre.effects.items() if k != left_out.key}
    parameters = [p for p, stays in zip(fitted.parameters, mine, strict=True) if stays]
    return fitted.centre.model_copy(update={"effects": effects}), parameters, fitted.scaled[mine]


def worse_there(base: Baseline, there: Fitted | None) -> str:
    """The quantity of recordings held out whose error a model raises most, in words; '' where it raises none by
    ``DIAGNOSIS.worse_held_out_share`` of it, the noise, and half the error of mesh and time step. Hundreds of markers
    that err a little less do not make up for a force that errs more."""
    if base.there is None or there is None:
        return ""
    found, most = "", 1.0
    for error in rms_errors(base.check, base.there, there, held_out=True, own=error_sizes(base.problem)):
        rise = float(np.sqrt(max(error.after**2 - error.before**2, 0.0)))
        ratio = error.after / max(error.before, 1e-300)
        if ratio > max(1.0 + DIAGNOSIS.worse_held_out_share, most) and rise > max(error.noise, 0.5 * error.own):
            quantity = f"{error.quantity} of {error.channel}" if error.quantity else error.channel
            found, most = f"the {quantity} in {error.run}, {error.before:.3g} -> {error.after:.3g} {error.unit}", ratio
    return found


def tempered(base: Baseline, trials: Sequence[Trial]) -> list[Trial]:
    """The trials with gains for data that count as much as the best model leaves of their misfit, best first."""
    if not trials:
        return []
    temper = max(1.0, min(t.fitted.misfit for t in trials))
    reference = log_evidence(base.fitted, temper)
    found = []
    for t in trials:
        gain = log_evidence(t.fitted, temper) - reference
        worth = min(significance(f, gain) for f in t.inflations)
        found.append(replace(t, gain=gain, significance=worth))
    return sorted(found, key=lambda t: -t.gain)


def explained(before: Structure, left: Structure) -> float:
    """Share of the structured misfit that is gone, 1 where there was none that stands out."""
    if not before.whole.stands_out:
        return 1.0
    return min(1.0, 1.0 - left.whole.excess / before.whole.excess)


def _hides(plain: Fitted | None, changed: Fitted | None) -> bool:
    """An amendment has less of the readings in sight."""
    return plain is not None and changed is not None and changed.samples < SOLVE.in_sight_share * plain.samples
