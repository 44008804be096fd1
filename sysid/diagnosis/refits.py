"""Real fits of the few sets of effects that the screening promises something of."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
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
from sysid.diagnosis.predictability import members_of
from sysid.diagnosis.residual_analysis import Structure, largest_change, structure
from sysid.diagnosis.validation import gain_of, ratios_of, seen_by_both
from sysid.discretisation.refinement import error_sizes
from sysid.fit.result import rms_errors
from sysid.model.parameters import FitParameter, fit_parameters, rig_at, rig_in, start_of
from sysid.model.sparing_predictor import SparingPredictor
from sysid.observations.observations import Run
from sysid.solve.covariance import Uncertainty, uncertainty
from sysid.solve.gauss_newton import IN_SIGHT
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

EVALUATIONS = 5
"""Evaluations allowed to a refit."""

IN_FULL = 3
"""Sets that are refitted: those that simulations at their starts explain best."""

SECOND = 1
"""Further starts of the best of these sets that are refitted."""

TOLERANCE = 5.0
"""Improvement of chi-square, in units of the misfit, below which a refit ends."""

SNAPPED = 2.0
"""Ratio of misfits from which two predictions count as those of different branches."""

WORSE = 0.1
"""Rise of a held-out error, over that of the baseline, from which a model predicts a quantity worse."""

TOLD_APART = 2.0
"""Standard deviations from which an effect beside others is told from none."""

OUT_OF_SIGHT = "it moves readings out of sight"
"""Why an effect is no answer that explains readings by hiding them."""


@dataclass(frozen=True)
class Start:
    """A set of hypotheses and where a refit begins: factors of their amplitudes, shift ``(p,)`` of the parameters of
    the model that they are added to, which has the effects of ``earlier`` already."""

    hypotheses: tuple[Hypothesis, ...]
    factors: tuple[np.ndarray, ...]
    shift: np.ndarray
    earlier: tuple[Hypothesis, ...] = ()

    @property
    def whole(self) -> tuple[Hypothesis, ...]:
        """All effects of the model."""
        return (*self.earlier, *self.hypotheses)

    @property
    def names(self) -> frozenset[str]:
        return frozenset(h.effect.name for h in self.whole)

    @property
    def origin(self) -> Hashable:
        """Points of the grids of :mod:`sysid.diagnosis.candidates` that it begins at."""
        return tuple((h.key, tuple(h.shape.items()), tuple(a.typical for a in h.amplitudes)) for h in self.hypotheses)


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


def amended(rig: Rig, start: Start) -> Rig:
    """The rig with the effects where a refit begins."""
    found = {h.key: h.values(list(f)) for h, f in zip(start.hypotheses, start.factors, strict=True)}
    return rig.model_copy(update={"effects": {**rig.effects, **found}})


def own_parameters(rig: Rig, hypotheses: Sequence[Hypothesis], scales: RecordingScales) -> list[FitParameter]:
    """The parameters of the effects, with priors that fit the recordings."""
    found = []
    for h in hypotheses:
        by_name = {p.name: p.fitted_to(scales) for p in h.effect.parameters}
        names = [n for n in rig.effects[h.key] if by_name[n].lower < by_name[n].upper]
        for p in fit_parameters(rig, [f"effects.{h.key}.{n}" for n in names]):
            found.append(replace(p, prior_sd=by_name[p.target.rsplit(".", 1)[1]].prior_sd))
    return found


def _begun_at(begun: Fitted, start: Start, scales: RecordingScales) -> tuple[Rig, list[FitParameter], np.ndarray]:
    """Rig that the priors pull to, parameters of baseline and effects, and their scaled values where a refit begins."""
    rig = amended(begun.rig, start)
    own = own_parameters(rig, start.hypotheses, scales)
    parameters = [*begun.parameters, *own]
    scaled = np.concatenate([begun.scaled + start.shift, start_of(rig, own)])
    limits = np.array([p.scaled_bounds for p in parameters]).T
    centre = begun.centre.model_copy(update={"effects": {**begun.centre.effects, **_at_rest(rig, start)}})
    return centre, parameters, np.clip(scaled, *limits)


def _ahead(
    base: Baseline, begun: Fitted, starts: Sequence[Start], scales: RecordingScales, failed: dict[str, str]
) -> list[Start]:
    """The starts of the sets that simulations there explain best, at most :data:`IN_FULL` sets, and :data:`SECOND` more
    of the first of them, with another shape: near a snap the best start may end in a branch that no refit leaves.

    Where the baseline has taken up part of an effect, the way back to its own values is long and not straight. So what
    one more linear step of its parameters takes away of the misfit does not count, and each of these sets is simulated
    with the rig's own values of them as well.
    """
    few = len({s.names for s in starts}) <= IN_FULL and len(starts) <= IN_FULL
    lost: dict[frozenset[str], str] = {}
    found = [] if few else _simulated(base, begun, starts, scales, lost)
    chosen = list(starts)
    if not few:
        chosen = _least_of_each(found, lambda s: s.names)[:IN_FULL]
        known = {s.origin for s in chosen}
        others = [s for s in _least_of_each(found, lambda s: s.origin) if s.origin not in known]
        chosen += [s for s in others if s.names == chosen[0].names][:SECOND]
    if not any(s.earlier for s in chosen):
        home = start_of(begun.centre, begun.parameters) - begun.scaled
        further = [*(chosen if few else ()), *(replace(s, shift=home) for s in chosen)]
        found += _simulated(base, begun, further, scales, lost)
        origins = {s.origin for s in chosen}
        chosen = _least_of_each([pair for pair in found if pair[1].origin in origins], lambda s: s.origin)
    done = {s.names for s in chosen} | {s.names for _, s in found}
    failed.update({" and ".join(sorted(n)): why for n, why in lost.items() if n not in done})
    return chosen


def _least_of_each(found: Sequence[tuple[float, Start]], kind: Callable[[Start], Hashable]) -> list[Start]:
    """The start of each kind that leaves the least, best first."""
    best: dict[Hashable, Start] = {}
    for _, start in sorted(found, key=lambda pair: pair[0]):
        best.setdefault(kind(start), start)
    return list(best.values())


def _simulated(
    base: Baseline, begun: Fitted, starts: Sequence[Start], scales: RecordingScales, lost: dict[frozenset[str], str]
) -> list[tuple[float, Start]]:
    """The starts that can be simulated, with what each leaves (:func:`_least`); ``lost`` is told why others cannot."""
    jobs = []
    for start in starts:
        centre, parameters, at = _begun_at(begun, start, scales)
        rigs = [rig_in(centre, parameters, at, run.name) for run in base.problem.runs]
        runs = zip(rigs, base.problem.runs, strict=True)
        jobs.append((start, at, [base.problem.engine.submit(rig, run) for rig, run in runs]))
    found: list[tuple[float, Start]] = []
    for start, at, row in jobs:
        try:
            residual = base.problem.assemble([job.result() for job in row], [], at).residual
        except ThinshellError as error:
            lost[start.names] = f"could not be simulated: {error}"
            continue
        found.append((_least(begun, residual), start))
    return found


def _least(begun: Fitted, residual: np.ndarray) -> float:
    """Least chi-square of a whitened residual along the derivatives of a model, within what is known of its parameters;
    its chi-square where other readings are in sight than in that model."""
    data = len(begun.residual) - begun.pulls
    if len(residual) != data or not begun.parameters:
        return float(residual @ residual)
    j = begun.jacobian[:data]
    known = np.array([p.known_sd or p.prior_sd for p in begun.parameters])
    slope = j.T @ residual
    return float(residual @ residual - slope @ np.linalg.solve(j.T @ j + np.diag(1.0 / known**2), slope))


def refit(base: Baseline, begun: Fitted, start: Start, scales: RecordingScales) -> Fitted:
    """Fit baseline and effects together. ``begun``: the model that the shift is counted from."""
    centre, parameters, at = _begun_at(begun, start, scales)
    problem = copy(base.problem)
    problem.engine = SparingPredictor(base.problem.engine)
    return problem.fit(centre, parameters, at, max_evaluations=EVALUATIONS, tolerance=TOLERANCE)


def _at_rest(rig: Rig, start: Start) -> dict[str, dict[str, float]]:
    """Values that the priors pull to: amplitudes at nothing, if a fit can stand there."""
    found = {}
    for h in start.hypotheses:
        values = dict(rig.effects[h.key])
        for a in h.amplitudes:
            if np.isfinite(a.none) and not a.parameter.log:
                values[a.parameter.name] = a.none
        found[h.key] = values
    return found


def trials_of(
    base: Baseline,
    begun: Fitted,
    starts: Sequence[Start],
    scales: RecordingScales,
    failed: dict[str, str],
) -> list[Trial]:
    """Refit the most promising side by side and score; of several starts of one set the best. What fails is told in
    ``failed``."""
    starts = _ahead(base, begun, starts, scales, failed)

    def attempt(start: Start) -> tuple[Start, Fitted, Fitted | None] | None:
        label = " and ".join(sorted(start.names))
        try:
            fitted = refit(base, begun, start, scales)
            there = predicted(base, base.check, fitted)
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
    return [scored(base, start.whole, fitted, there) for start, fitted, there in best.values()]


def predicted(base: Baseline, check: Problem, fitted: Fitted) -> Fitted | None:
    """A model on the recordings held out; None without any.

    Which way a strip snaps may hang on less than the recordings given can tell, and the wrong branch is missed by a
    hundred times the noise, by the right model too. So where it predicts :data:`SNAPPED` times as badly as the
    baseline, the ensemble of models that these recordings cannot tell from it is asked
    (:func:`sysid.diagnosis.predictability.members_of`), and one that predicts so much better stands for it: of the
    likelihood that is averaged over the ensemble, it has all but its share of a few nats.
    """
    if not check.runs:
        return None
    there = check.evaluate(fitted.rig, [], np.zeros(0))
    if base.there is None or there.chi2 < SNAPPED * base.there.chi2:
        return there
    shared = [k for k, p in enumerate(fitted.parameters) if not p.bag]
    parameters, best = [fitted.parameters[k] for k in shared], there
    for at in members_of(fitted):
        try:
            member = check.evaluate(rig_at(fitted.rig, parameters, at[shared]), [], np.zeros(0))
        except ThinshellError:
            continue
        if SNAPPED * member.chi2 < there.chi2 and member.chi2 < best.chi2:
            best = member
    return best


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
    """The effect of a set of several that is nearest to none, in words, if it is within :data:`TOLD_APART`."""
    if len(hypotheses) < 2:
        return ""
    h = _idlest(hypotheses, fitted, known)
    least = distance_from_none(h, fitted, known)
    return f"that {h.effect.title}, by {least:.1f} standard deviations" if least < TOLD_APART else ""


def _idlest(hypotheses: Sequence[Hypothesis], fitted: Fitted, known: Uncertainty) -> Hypothesis:
    return min(hypotheses, key=lambda h: distance_from_none(h, fitted, known))


def without_idle(base: Baseline, trial: Trial, failed: dict[str, str]) -> Trial | None:
    """A set of several effects without the one that is not told from none beside the others, fitted on from where the
    set stands (backward elimination); None, and why in ``failed``, where that cannot be simulated."""
    idle = _idlest(trial.hypotheses, trial.fitted, uncertainty(trial.fitted))
    kept = tuple(h for h in trial.hypotheses if h is not idle)
    begun = trial.fitted
    mine = [not p.target.startswith(f"effects.{idle.key}.") for p in begun.parameters]
    centre = begun.centre.model_copy(
        update={"effects": {k: v for k, v in begun.centre.effects.items() if k != idle.key}}
    )
    problem = copy(base.problem)
    problem.engine = SparingPredictor(base.problem.engine)
    parameters = [p for p, stays in zip(begun.parameters, mine, strict=True) if stays]
    try:
        fitted = problem.fit(centre, parameters, begun.scaled[mine], max_evaluations=EVALUATIONS, tolerance=TOLERANCE)
        if fitted.interrupted:
            raise KeyboardInterrupt
        there = predicted(base, base.check, fitted)
    except ThinshellError as error:
        failed[" and ".join(sorted(h.effect.name for h in kept))] = f"could not be simulated: {error}"
        return None
    return None if _hides(base.fitted, fitted) or _hides(base.there, there) else scored(base, kept, fitted, there)


def worse_there(base: Baseline, there: Fitted | None) -> str:
    """The quantity of recordings held out whose error a model raises most, in words; '' where it raises none by
    :data:`WORSE` of it, the noise, and half the error of mesh and time step. Hundreds of markers that err a little less
    do not make up for a force that errs more."""
    if base.there is None or there is None:
        return ""
    found, most = "", 1.0
    for error in rms_errors(base.check, base.there, there, held_out=True, own=error_sizes(base.problem)):
        rise = float(np.sqrt(max(error.after**2 - error.before**2, 0.0)))
        ratio = error.after / max(error.before, 1e-300)
        if ratio > max(1.0 + WORSE, most) and rise > max(error.noise, 0.5 * error.own):
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
    return plain is not None and changed is not None and changed.samples < IN_SIGHT * plain.samples
