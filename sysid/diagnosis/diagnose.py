"""The diagnosis of a rig against recordings: the function behind ``thinshell diagnose``."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.diagnosis import wording as words
from sysid.diagnosis.baseline import open_parameters
from sysid.diagnosis.hypotheses import OUT_OF_SIGHT, Start, log_evidence, refit, screen
from sysid.diagnosis.model_selection import (
    Trial,
    Verdict,
    candidate,
    decide,
    named_parameters,
    probabilities,
    significance,
)
from sysid.diagnosis.report_notes import fates, limits, notes
from sysid.diagnosis.residual_analysis import Structure, locate, structure
from sysid.diagnosis.result import Diagnosis, Misfit
from sysid.diagnosis.validation import gain_of, of_readings, seen_by_both
from sysid.fit.discretisation_refinement import (
    Unmeasured,
    discretisation,
    error_sizes,
    fit_beside_discretisation,
)
from sysid.fit.result import plot_series, rms_errors
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import fit_parameters
from sysid.model.provenance import provenance
from sysid.noise.estimate import ChannelNoise, channel_noise
from sysid.observations.observations import Run, check_apart
from sysid.solve.gauss_newton import IN_SIGHT
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

Progress = Callable[[float, str], None]

REFITTED = 4
"""Effects that are refitted in full after the screening."""

SECOND_STARTS = 3
"""Further starts of these effects that are refitted as well."""

WORTH_REFITTING_NATS = 4.0
"""Predicted improvement below which an effect is not refitted."""

EVALUATIONS = 6
"""Evaluations allowed to a refit."""

BASELINE = 5
"""Rounds allowed to the baseline fit."""

POLISHING = 5
"""Rounds allowed to the last fit of the answer."""


def diagnose_runs(
    rig: Rig,
    runs: Sequence[Run],
    held_out: Sequence[Run] = (),
    *,
    on_progress: Progress | None = None,
) -> tuple[Diagnosis, Rig]:
    """Diagnose; the second value is the rig with the answer in it (the fitted baseline when none). Raises
    ``RecordingError`` where two runs have readings in common."""
    check_apart(runs, held_out)
    started = time.monotonic()
    tell = on_progress or (lambda share, text: None)
    noise = channel_noise(rig, runs, held_out)
    with ParallelPredictor(min(os.cpu_count() or 1, 2 * len(runs))) as engine:
        tell(0.0, "baseline fit")
        parameters = fit_parameters(rig, open_parameters(rig))
        problem, base = _kept(
            lambda: fit_beside_discretisation(engine, runs, noise, rig, parameters, prior=True, rounds=BASELINE)
        )
        if base.interrupted:
            raise KeyboardInterrupt
        before = structure(problem, base)
        tell(0.45, "screening of effects")
        starts, failed = screen(engine, problem, base)
        tell(0.65, "refits")
        check, lost = _check(engine, base.rig, noise, held_out)
        plain = _held_out(check, base)
        on_held_out = structure(check, plain) if plain is not None else None
        trials = _refits(problem, check, plain, base, _chosen(starts, base), failed)
        verdict = decide(trials, before, on_held_out)
        while unfinished := [t for t in _in_question(verdict) if not t.finished]:
            tell(0.85, "the answer fitted to the end")
            final = _polished(engine, problem, check, base, unfinished[0])
            trials = [final if t is unfinished[0] else t for t in trials]
            verdict = decide(trials, before, on_held_out)
        answer = verdict.named[0] if verdict.kind in ("named", "one_of") else None
        diagnosis = _collect(rig, problem, check, base, plain, answer, verdict, trials, before, failed)
        diagnosis.notes += lost
    diagnosis.provenance = provenance(rig, list(runs), list(held_out))
    diagnosis.seconds = time.monotonic() - started
    tell(1.0, "done")
    return diagnosis, (answer.fitted if answer else base).rig


def _kept(fit: Callable[[], tuple[Problem, Fitted]]) -> tuple[Problem, Fitted]:
    """What a fit finds; where its discretisation error cannot be measured at the end, beside the one measured last, as
    not converged."""
    try:
        return fit()
    except Unmeasured as error:
        return error.beside, error.fitted


def _in_question(verdict: Verdict) -> tuple[Trial, ...]:
    """The trials that the verdict rests on: all that it names, the best of those that explain too little."""
    return verdict.named[:1] if verdict.kind == "unknown" else verdict.named


def _chosen(starts: list[Start], base: Fitted) -> list[Start]:
    """The best start of each promising effect, and the next best of these effects.

    A law with a threshold has a misfit with several minima, so one start of it is not enough.
    """
    promising = [s for s in starts if s.gain > 2.0 * WORTH_REFITTING_NATS]
    first: dict[str, Start] = {}
    for start in promising:
        first.setdefault(start.effect.name, start)
    leading = list(first.values())[:REFITTED]
    names = {f.effect.name for f in leading}
    others = [s for s in promising if s.effect.name in names and s is not first[s.effect.name]]
    return leading + others[:SECOND_STARTS]


def _refits(
    problem: Problem, check: Problem, plain: Fitted | None, base: Fitted, chosen: list[Start], failed: dict[str, str]
) -> list[Trial]:
    """Refit the chosen effects side by side and score them; ``plain``: the baseline on the held-out runs."""

    def attempt(start: Start) -> tuple[Start, Fitted, Fitted | None] | None:
        try:
            fitted = refit(problem, base, start, EVALUATIONS)
            there = _held_out(check, fitted)
        except ThinshellError as error:
            failed[start.effect.name] = f"could not be simulated: {error}"
            return None
        if _hides(base, fitted) or _hides(plain, there):
            failed[start.effect.name] = OUT_OF_SIGHT
            return None
        return start, fitted, there

    with ThreadPoolExecutor(max(1, len(chosen))) as threads:
        done = [found for found in threads.map(attempt, chosen) if found is not None]
    best: dict[str, tuple[Start, Fitted, Fitted | None]] = {}
    for start, fitted, there in done:
        failed.pop(start.effect.name, None)
        if start.effect.name not in best or fitted.chi2 < best[start.effect.name][1].chi2:
            best[start.effect.name] = (start, fitted, there)
    if not best:
        return []
    temper = max(1.0, min(fitted.misfit for _, fitted, _ in best.values()))
    reference = log_evidence(base, temper)
    before = structure(problem, base)
    trials = []
    for start, fitted, there in best.values():
        left = structure(problem, fitted)
        gain = log_evidence(fitted, temper) - reference
        trials.append(
            Trial(
                start.effect, fitted, gain, _explained(before, left), left, gain_of(seen_by_both(check, plain, there))
            )
        )
    return sorted(trials, key=lambda t: -t.gain)


def _hides(plain: Fitted | None, amended: Fitted | None) -> bool:
    """An amendment has less of the readings in sight."""
    return plain is not None and amended is not None and amended.samples < IN_SIGHT * plain.samples


def _explained(before: Structure, left: Structure) -> float:
    """Share of the structured misfit that is gone, 1 where there was none that stands out."""
    if not before.whole.stands_out:
        return 1.0
    return min(1.0, 1.0 - left.whole.excess / before.whole.excess)


def _check(
    engine: ParallelPredictor, rig: Rig, noise: dict[str, ChannelNoise], held_out: Sequence[Run]
) -> tuple[Problem, tuple[str, ...]]:
    """The held-out runs that the fitted rig can follow, and a note for each that it cannot."""
    try:
        return Problem(held_out, noise, engine, discretisation(engine, rig, held_out)), ()
    except ThinshellError:
        kept, lost = [], []
        for run in held_out:
            try:
                discretisation(engine, rig, [run])
                kept.append(run)
            except ThinshellError as error:
                lost.append(f"{run.name} is left out, it could not be simulated: {error}")
        return Problem(kept, noise, engine, discretisation(engine, rig, kept)), tuple(lost)


def _held_out(check: Problem, fitted: Fitted) -> Fitted | None:
    """A model on the held-out runs."""
    return check.evaluate(fitted.rig, [], np.zeros(0)) if check.runs else None


def _polished(engine: ParallelPredictor, problem: Problem, check: Problem, base: Fitted, trial: Trial) -> Trial:
    """Fit an answer to the end, with the discretisation error measured where it now stands.

    The baseline is judged beside the same error, so that nothing else differs. Where that error cannot be measured, the
    one measured last is kept, and the fit has not converged; a trial that cannot be simulated there is rejected.
    """
    answer, there = trial.fitted, problem
    try:
        there, fitted = _kept(
            lambda: fit_beside_discretisation(
                engine,
                problem.runs,
                problem.noise,
                answer.centre,
                answer.parameters,
                start=answer.scaled,
                prior=True,
                rounds=POLISHING,
            )
        )
        check = Problem(check.runs, problem.noise, engine, discretisation(engine, fitted.rig, check.runs))
    except ThinshellError as error:
        fitted = answer if there is problem else fitted
        fitted = replace(
            fitted, converged=False, message=f"it stands where its discretisation error is not known. {error}"
        )
    if fitted.interrupted:
        raise KeyboardInterrupt
    try:
        predicted, plain = _held_out(check, fitted), _held_out(check, base)
        unamended = there.evaluate(base.rig, [], np.zeros(0))
    except ThinshellError as error:
        return replace(trial, finished=True, failure=f"it could not be simulated where it fits best: {error}")
    left, both = structure(there, fitted), seen_by_both(check, plain, predicted)
    return replace(
        trial,
        fitted=fitted,
        predicted=predicted,
        misfits=(
            (of_readings(unamended), None if both is None else both[0].misfit),
            (of_readings(fitted), None if both is None else both[1].misfit),
        ),
        explained=_explained(structure(there, unamended), left),
        left=left,
        held_out=gain_of(both),
        significance=significance(trial.effect, fitted, trial.gain),
        finished=True,
        failure=OUT_OF_SIGHT if _hides(base, fitted) or _hides(plain, predicted) else "",
    )


def _misfit(
    problem: Problem,
    check: Problem,
    base: Fitted,
    plain: Fitted | None,
    fitted: Fitted,
    predicted: Fitted | None,
    misfits: tuple[float, float | None] | None = None,
) -> Misfit:
    """Misfit of a model, with the errors of the baseline beside its own; ``plain``, ``predicted``: the two on
    the held-out runs; ``misfits``: on the runs given and held out, where they are told."""
    own = error_sizes(problem)
    errors = rms_errors(problem, base, fitted, held_out=False, own=own)
    if plain is not None and predicted is not None:
        errors += rms_errors(check, plain, predicted, held_out=True, own=own)
    training, there = misfits or (of_readings(fitted), None if predicted is None else predicted.misfit)
    return Misfit(training, there, tuple(errors))


def _collect(
    rig: Rig,
    problem: Problem,
    check: Problem,
    base: Fitted,
    plain: Fitted | None,
    answer: Trial | None,
    verdict: Verdict,
    trials: list[Trial],
    before: Structure,
    failed: dict[str, str],
) -> Diagnosis:
    located = locate(problem, base, answer.fitted if answer else None)
    chances = probabilities(trials)
    reported = [candidate(t, chances[t.effect.name]) for t in trials]
    names = {t.effect.name for t in verdict.named} if verdict.kind in ("named", "one_of") else set()
    became = fates(trials, failed, names, rig)
    shown, predicted = (answer.fitted, answer.predicted) if answer else (base, plain)
    misfits = answer.misfits if answer and answer.misfits else (None, None)
    series = plot_series(problem, base, shown, held_out=False)
    if plain is not None and predicted is not None:
        series += plot_series(check, plain, predicted, held_out=True)
    return Diagnosis(
        verdict=verdict.kind,
        sentence=words.sentence(verdict, located, became, before.hidden),
        rig=rig.name,
        effects=tuple(c for c in reported if c.name in names),
        alternatives=tuple(c for c in reported if c.name not in names),
        located=located,
        baseline=_misfit(problem, check, base, plain, base, plain, misfits[0]),
        amended=_misfit(problem, check, base, plain, shown, predicted, misfits[1]) if answer else None,
        noise_floor={c: float(np.median(n.sigma)) for c, n in problem.noise.items()},
        discretisation={
            "structured_energy": before.whole.own,
            "structured_misfit": before.whole.excess,
            "structured_misfit_per_score": before.whole.per_score,
        },
        upper_limits=limits(trials, names),
        baseline_parameters=named_parameters(base),
        amended_parameters=named_parameters(shown) if answer else (),
        not_explained=words.not_explained(verdict, before.whole.excess),
        next_experiment=words.next_experiment(verdict, before.hidden),
        provenance={},
        seconds=0.0,
        tried=became,
        notes=notes(base, problem, before, verdict),
        series=series,
    )
