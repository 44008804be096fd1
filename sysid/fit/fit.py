"""From bags to a fit result: the function behind ``thinshell fit``."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.discretisation.refinement import (
    Unmeasured,
    error_sizes,
    fit_with_discretisation_error,
    large_discretisation_errors,
    unresolved_quantities,
)
from sysid.fit.given_values import given, said_of_rise, said_of_stay
from sysid.fit.marker_field import marker_fields
from sysid.fit.minimum_norm import minimum_norm_solution
from sysid.fit.multistart import Evaluations, Searches, Step
from sysid.fit.options import FitOptions, Intervals
from sysid.fit.pressed_gels import pressed_gels
from sysid.fit.result import (
    Estimate,
    FitResult,
    estimates_of,
    out_of_sight,
    plot_series,
    rms_errors,
)
from sysid.fit.validation import all_scored
from sysid.model.nuisance_parameters import has_bias, nuisance_parameters
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import FitParameter, asked_for, bounds_cut, rig_at, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.model.provenance import provenance
from sysid.model.windows import not_from_rest
from sysid.noise.autocorrelation import unknown_autocorrelation
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.data_quality import data_quality_warnings
from sysid.noise.estimate import channel_noise, column_groups, overruled
from sysid.observations.observations import Run, check_apart, of_recording
from sysid.progress.callback import Progress
from sysid.progress.work import Work, work_of
from sysid.settings.fit import FIT
from sysid.settings.progress import PROGRESS
from sysid.solve.covariance import Finding, names_undetermined
from sysid.solve.interruption import ENDS_EARLY, end_unconverged, interrupts_ignored, reason_of
from sysid.solve.nonsmooth_trust_region import AT_KINK
from sysid.solve.optimum import Fitted
from sysid.solve.outliers import DIMENSIONS, WRENCH, Outliers, without_outliers, worth_another_fit
from sysid.solve.residuals import Problem
from sysid.uncertainty.goodness_of_fit import noise_multiples, unexplained
from sysid.uncertainty.nuisance_estimates import confounded_with_nuisances, nuisances_of, remarks, with_mean_nuisances
from sysid.uncertainty.prior_data_conflict import prior_data_conflicts
from sysid.uncertainty.profile_likelihood import Profile
from sysid.uncertainty.profiler import Profiler

USUAL_OPTIONS = FitOptions()

NEAREST = "Of all values that fit as well, those are given that are nearest to the rig's."
"""Said where some parameter is not determined."""


def fit_runs(
    rig: Rig,
    runs: Sequence[Run],
    names: Sequence[str],
    options: FitOptions = USUAL_OPTIONS,
    *,
    held_out: Sequence[Run] = (),
    engine: AnyEngine | None = None,
    on_progress: Progress | Work | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> tuple[FitResult, Rig]:
    """Fit ``names`` to ``runs``; the result and the rig with the fitted values, of nuisances too.

    Of what each bag has for itself that rig has the mean. ``held_out``: scored with all readings, also those that are
    left out of fits; ``engine``: threads at hand, for several fits in a row; ``on_step``: called after each
    evaluation. Raises ``RecordingError`` where two runs have readings in common.
    """
    check_apart(runs, held_out)
    asked, rig = asked_for(
        rig, names, priors=options.priors, bounds=options.bounds, per_bag=options.per_bag,
        bags=[run.name for run in runs],
    )  # fmt: skip
    work = work_of(on_progress, PROGRESS.fit_rollouts, PROGRESS.fit_between_s, len(runs))
    work.enter("search", "first simulations")
    evaluations = Evaluations(options, work.say, on_step)
    own = ParallelPredictor(os.cpu_count(), costs=work.costs) if engine is None else nullcontext(engine)
    with own as engine:
        found = _fit_runs(engine, rig, runs, asked, held_out, options, evaluations, work)
    if work is not on_progress:
        work.done()
    return found


def _shown(runs: Sequence[Run], channel: str, noise: ChannelNoise) -> dict[str, float | str]:
    """Noise of the measured columns of a channel (a wrench: of its forces, if it has any)."""
    measured = next(m for run in runs for m in run.measured if m.channel == channel)
    seen = (group[np.isfinite(measured.values[:, group]).any(axis=0)] for group in column_groups(measured))
    columns = next((group for group in seen if len(group)), np.arange(len(noise.sigma)))
    sigma, rho = (float(np.median(values[columns])) for values in (noise.sigma, noise.correlation))
    return {"sigma": sigma, "correlation": rho, "from": noise.source}


def _fit_runs(
    engine: AnyEngine,
    rig: Rig,
    runs: Sequence[Run],
    asked: list[FitParameter],
    held_out: Sequence[Run],
    options: FitOptions,
    evaluations: Evaluations,
    work: Work,
) -> tuple[FitResult, Rig]:
    allowed_for = nuisance_parameters(rig, runs, asked, options.kinds) if asked else []
    bias = bool(asked) and has_bias(rig, runs, asked, options.kinds)
    parameters = [*asked, *allowed_for]
    started = time.monotonic()
    as_given = [engine.submit(rig, run) for run in runs]
    first = start_of(rig, parameters)
    search = Searches(rig, parameters, options, evaluations)
    found = _searched(engine, rig, runs, parameters, first, held_out, options, search, evaluations, bias, work)
    look, problem, fitted = found.look, found.problem, found.fitted
    if fitted.interrupted:
        work.say("interrupted; what was found is put together")
    with interrupts_ignored():
        before = problem.compare([future.result() for future in as_given], rig, [], np.zeros(0))
        own = error_sizes(problem)
        errors = rms_errors(problem, before, fitted, held_out=False, own=own)
        stays = given(problem, fitted, first, errors)
        if stays is not None:
            why = [said_of_stay(errors)]
            found = _at_given(found, stays, first)
            fitted = stays
            errors = rms_errors(problem, before, fitted, held_out=False, own=own)
        else:
            why = said_of_rise(errors)
        nuisances = nuisances_of(problem, fitted)
        series = plot_series(problem, before, fitted, held_out=False, raw=runs)
        fields = marker_fields(problem, before, fitted, held_out=False)
        sentences, left = [f.sentence for f in found.findings], unexplained(problem, fitted)
        open_ended = names_undetermined(found.findings)
        mentioned = {run.unlike for run in runs if left}
        notes = [
            of_recording(run.name, note) for run in [*runs, *held_out] for note in run.notes if note not in mentioned
        ]
        notes += bounds_cut(rig, list(dict.fromkeys(p.target for p in asked)), options.bounds)
        notes += [
            f"What was known of {p.name} before: {p.physical(at):g} +- "
            f"{p.known_sd * (p.physical(at) if p.log else 1.0):g} {p.unit}".rstrip()
            for p, at in zip(parameters, first, strict=True)
            if p.known_sd is not None
        ]
        if fitted.converged and fitted.message == AT_KINK:
            notes.append(
                f"The search ended since {AT_KINK}; standard deviations are those of the side on which it stands."
            )
        notes += (
            search.ends
            + unknown_autocorrelation(problem.noise)
            + overruled(runs, problem.noise)
            + out_of_sight(problem, before, fitted)
        )
    moved = []
    try:
        moved = [f"{run.name} does not begin at rest: {n}" for run in runs for n in not_from_rest(fitted.rig, run)]
    except KeyboardInterrupt as error:
        notes.append(f"Whether windows begin at rest was not looked at: {reason_of(error)}")
    if moved:
        sentences = ["What was fitted to a window that does not begin at rest means nothing.", *moved, *sentences]
    if held_out and any(p.bag for p in asked):
        notes.append("Held-out recordings are predicted with the mean of the values that each bag has for itself.")
    if held_out:
        work.say("held-out recordings")
    final = with_mean_nuisances(fitted.rig, nuisances)
    scores, said = all_scored(engine, fitted.rig, rig, final, held_out, problem.noise, bias, own)
    notes += said
    with interrupts_ignored():
        if options.robust:
            followed = [(score.run, score.prediction) for score in scores if score.prediction is not None]
            mistakes = [o for r, p in followed for o in without_outliers([r], [p], problem.noise)[1]]
            notes += [o.sentence for o in look.outliers] + [o.sentence_of_score for o in mistakes]
        result = FitResult(
            rig=rig.name,
            estimates=found.estimates,
            correlation=found.correlation,
            identifiability=sentences,
            errors=errors + [error for score in scores for error in score.errors],
            misfit=fitted.misfit,
            reduced_chi2=found.reduced_chi2,
            converged=fitted.converged,
            message=fitted.message,
            evaluations=evaluations.done,
            seconds=time.monotonic() - started,
            noise={c: _shown([*runs, *held_out], c, n) for c, n in problem.noise.items()},
            notes=notes,
            provenance=provenance(rig, list(runs), list(held_out), options.seed, options.to_json()),
            series=series + [one for score in scores for one in score.series],
            marker_fields=fields + [one for score in scores for one in score.marker_fields],
            nuisances=nuisances,
            remarks=remarks(rig, nuisances, trusted=not left and not open_ended),
            profiles=found.profiles,
            outliers=look.outliers,
            unexplained=left,
            noise_multiples=noise_multiples(problem, fitted),
            contradicted=found.contradicted,
            cautions=why
            + data_quality_warnings(rig, runs)
            + pressed_gels(runs, fitted.predictions)
            + large_discretisation_errors(problem)
            + unresolved_quantities(problem),
            undetermined=open_ended | {p.name for p in found.profiles if p.undetermined},
        )
    return result, final


@dataclass(frozen=True)
class _Found:
    """The best fit, what is known of the parameters there, in numbers and words, and its profiles."""

    look: _Look
    problem: Problem
    fitted: Fitted
    estimates: list[Estimate]
    correlation: list[list[float]]
    findings: list[Finding]
    reduced_chi2: float
    profiles: list[Profile]
    contradicted: list[str]


def _at_given(found: _Found, stays: Fitted, first: np.ndarray) -> _Found:
    """What is known of the parameters where the given values stay. How far the data limit a parameter along the
    likelihood does not depend on which of the values within is reported."""
    estimates, correlation, findings, reduced = estimates_of(stays, first)
    values = {e.name: e.value for e in estimates}
    profiles = [replace(p, value=values[p.name]) for p in found.profiles if p.limited]
    profiles = [p for p in profiles if p.ci95[0] <= p.value <= p.ci95[1]]
    return replace(
        found, fitted=stays, estimates=estimates, correlation=correlation,
        findings=_with_profiles(stays, findings, profiles),
        reduced_chi2=reduced, profiles=profiles, contradicted=[],
    )  # fmt: skip


def _searched(
    engine: AnyEngine,
    rig: Rig,
    runs: Sequence[Run],
    parameters: Sequence[FitParameter],
    first: np.ndarray,
    held_out: Sequence[Run],
    options: FitOptions,
    search: Searches,
    evaluations: Evaluations,
    bias: bool,
    work: Work,
) -> _Found:
    """The best fit from scaled values ``first`` ``(p,)``, also from where the looks along its intervals lead."""
    look = _Look(list(runs), list(held_out), [], None)
    if options.robust:
        look = _first_look(engine, rig_at(rig, parameters, first), runs, held_out)
    at = first
    for left in reversed(range(FIT.interval_looks)):
        try:
            look, problem, fitted = _fit_without_outliers(
                engine, rig, parameters, look, at, runs=runs, robust=options.robust, bias=bias, search=search
            )
        except ENDS_EARLY as error:
            if at is first:
                raise
            end_unconverged(fitted, error, "a better fit that is known was not searched from")
            break
        ended = fitted
        try:
            fitted = minimum_norm_solution(problem, ended, first, evaluations.left, evaluations)
        except ENDS_EARLY as error:
            end_unconverged(fitted, error, "values that fit as well and are nearer to the rig's were not looked for")
        with interrupts_ignored():
            estimates, correlation, findings, reduced = estimates_of(fitted, first)
            against = prior_data_conflicts(fitted) if fitted.converged else {}
            findings = [found for found in findings if found.undetermined not in {(name,) for name in against}]
            findings += [Finding(NEAREST)] if fitted is not ended else []
            findings += [
                Finding(sentence) for sentence in confounded_with_nuisances(problem, fitted, sorted(options.kinds))
            ]
        profiles: list[Profile] = []
        better = None
        try:
            given_up = max(0.0, fitted.chi2 - ended.chi2)
            profiles, findings, better = _profiled(problem, fitted, findings, options.intervals, work, given_up)
        except ENDS_EARLY as error:
            findings.append(Finding(f"Intervals were not looked at along the likelihood: {reason_of(error)}"))
        if better is None:
            break
        if not left:
            fitted.message, fitted.converged = (
                f"after {FIT.interval_looks} searches a better fit is known than it ended at",
                False,
            )
            break
        at, look = better, replace(look, plain=None)
    conflicts = list(against.values())
    return _Found(look, problem, fitted, estimates, correlation, findings, reduced, profiles, conflicts)


@dataclass(frozen=True)
class _Look:
    """Runs without mistaken readings, and those readings. ``plain``: predictions where the next fit starts."""

    runs: list[Run]
    held_out: list[Run]
    outliers: list[Outliers]
    plain: list[Prediction] | None


def _fit_without_outliers(
    engine: AnyEngine,
    rig: Rig,
    parameters: Sequence[FitParameter],
    look: _Look,
    at: np.ndarray,
    *,
    runs: Sequence[Run],
    robust: bool,
    bias: bool,
    search: Searches,
) -> tuple[_Look, Problem, Fitted]:
    """A fit from scaled values ``(p,)``, repeated while other readings of ``runs`` turn out to be mistakes; the last
    that has ended where another one cannot be made."""
    ended: tuple[_Look, Problem, Fitted] | None = None
    for left in reversed(range(FIT.outlier_looks)):
        noise = channel_noise(rig, look.runs, look.held_out)
        try:
            problem, fitted = fit_with_discretisation_error(
                engine, look.runs, noise, rig, parameters, start=at, plain=look.plain, bias=bias, search=search
            )
        except Unmeasured as error:
            problem, fitted, left = error.last_problem, error.fitted, 0
        except ENDS_EARLY as error:
            if ended is None:
                raise
            look, problem, fitted = ended
            end_unconverged(fitted, error, "it was not repeated without its outliers")
            break
        ended = look, problem, fitted
        if not robust or not left or fitted.cut_short:
            break
        again, excluded = without_outliers(runs, fitted.predictions, noise)
        if not worth_another_fit(look.runs, again):
            break
        look = replace(look, runs=again, outliers=excluded, plain=fitted.predictions)
        at = fitted.scaled
    return look, problem, fitted


def _first_look(engine: AnyEngine, rig: Rig, runs: Sequence[Run], held_out: Sequence[Run]) -> _Look:
    """The runs without the outliers under the rig that a fit starts from; as they are where it cannot follow."""
    if not any(m.kind in (*DIMENSIONS, WRENCH) for run in runs for m in run.measured):
        return _Look(list(runs), list(held_out), [], None)
    pending = [(run, engine.submit(rig, run)) for run in [*runs, *held_out]]
    noise = channel_noise(rig, runs, held_out)
    clean: list[Run] = []
    outliers: list[Outliers] = []
    plain: list[Prediction] = []
    for k, (run, future) in enumerate(pending):
        try:
            prediction = future.result()
        except ThinshellError:
            clean.append(run)
            continue
        found, excluded = without_outliers([run], [prediction], noise)
        clean += found
        if k < len(runs):
            outliers += excluded
            plain.append(prediction)
    return _Look(clean[: len(runs)], clean[len(runs) :], outliers, plain if len(plain) == len(runs) else None)


def _with_profiles(fitted: Fitted, findings: Sequence[Finding], profiles: Sequence[Profile]) -> list[Finding]:
    """The findings, and what profiles say, which takes the place of some."""
    said = [p for p in profiles if p.sentence]
    known = {q.name for q in fitted.parameters if q.known_sd is not None}
    replaced = {(p.name,) for p in said if p.limited and p.name not in known}
    return [*(f for f in findings if f.undetermined not in replaced), *(Finding(p.sentence) for p in said)]


def _profiled(
    problem: Problem,
    fitted: Fitted,
    findings: list[Finding],
    intervals: Intervals,
    work: Work,
    given_up: float = 0.0,
) -> tuple[list[Profile], list[Finding], np.ndarray | None]:
    """Profiles, where they are wanted, what is then known of the parameters in words, and scaled values ``(p,)`` at
    which the fit was met to be better than by the chi-square that was ``given_up`` knowingly.

    Where a profile says how far the data limit a parameter on both sides, that takes the place of the finding that they
    do not determine it, unless what was known before may limit it. Around values that are not the best fit intervals
    mean nothing, and little is said.
    """
    if intervals == "quadratic" or fitted.cut_short or not fitted.parameters:
        return [], findings, None
    if not fitted.converged:
        what = (
            "interval was sought by profile likelihood" if intervals == "profiled" else "end of an interval was tried"
        )
        return [], [*findings, Finding(f"No {what}, since the fit did not converge.")], None

    work.enter("intervals", "ends of intervals")
    profiler = Profiler(problem, fitted, work.say, given_up)
    profiles: list[Profile] = []
    if intervals == "checked":
        findings = [*findings, *(Finding(sentence) for sentence in profiler.check())]
    else:
        profiles = profiler.profiles()
        better = profiler.lower()
        findings = [*findings, Finding(better)] if better else _with_profiles(fitted, findings, profiles)
    if profiler.interrupted:
        return (
            profiles,
            [*findings, Finding("Not all intervals were looked at along the likelihood: interrupted.")],
            None,
        )
    return profiles, findings, profiler.better
