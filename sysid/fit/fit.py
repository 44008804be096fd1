"""From bags to a fit result: the function behind ``thinshell fit``."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from sim_core.errors import ConfigError, ThinshellError
from sim_core.rigs import Rig, rig_to_yaml
from sysid.fit.engine import Prediction
from sysid.fit.fitted import Fitted
from sysid.fit.noise import ChannelNoise, channel_noise, column_groups
from sysid.fit.nuisance import USUAL, checked_kinds, has_bias, nuisance_parameters
from sysid.fit.outliers import DIMENSIONS, Outliers, not_looked_for, without_outliers, worth_another_fit
from sysid.fit.own_error import fit_beside_own_error, loud
from sysid.fit.parameters import FitParameter, fit_parameters, rig_at, start_of, with_bags, within_bounds
from sysid.fit.pool import PooledEngine
from sysid.fit.problem import Problem
from sysid.fit.profile import Profile
from sysid.fit.profiler import Profiler
from sysid.fit.result import FitResult, estimates_of, out_of_sight, plot_series, rms_errors
from sysid.fit.runs import Run, load_runs
from sysid.fit.untold import blamed, nuisances_of, remarks
from sysid.folder import whole_folder
from sysid.provenance import provenance

Progress = Callable[[float, str], None]

Bounds = Mapping[str, tuple[float, float]]
"""Lowest and highest value of parameters by name, in their own units, within those that the fit has."""
Intervals = Literal["quadratic", "checked", "profiled"]
"""Intervals from the covariance alone; with a simulation at each end that tells whether they hold; or those of the
profile likelihood beside them (:mod:`sysid.fit.profiler`)."""

MOST_RESTARTS = 4
RESTART_WIDTH = 0.05
"""Restarts start this far (standard deviations, in units of the fitted scale) from the best so far."""

GOOD_MISFIT = 1.5
"""Misfit over noise below which a fit is not tried again."""

LOOKS = 3
"""Times that mistaken readings are looked for and the fit repeated without them."""

TYPICAL_EVALUATIONS = 10
"""Evaluations that a fit usually takes; the progress bar is scaled with it."""

EVALUATIONS_OF_A_SEARCH = 30
"""Evaluations after which one search ends, converged or not."""


@dataclass(frozen=True)
class Step:
    """What a fit knows while it runs. ``evaluations``: all until now; ``misfit``: mean squared whitened residual of
    the best ``values`` (of the parameters that are asked for) of the search that is on."""

    evaluations: int
    misfit: float
    values: dict[str, float]


class _Evaluations:
    """Counts the evaluations of a fit, at most ``most`` if that is given, and tells of each."""

    def __init__(self, most: int | None, on_progress: Progress | None, on_step: Callable[[Step], None] | None) -> None:
        self._most = most
        self._on_progress = on_progress
        self._on_step = on_step
        self.done = 0

    @property
    def left(self) -> int:
        """Evaluations that the next search may make."""
        return EVALUATIONS_OF_A_SEARCH if self._most is None else min(self._most - self.done, EVALUATIONS_OF_A_SEARCH)

    def limit(self, fitted: Fitted) -> Fitted:
        """The outcome of a search, which says so if none are left."""
        if self.left == 0 and fitted.parameters and not fitted.interrupted:
            fitted.limited, fitted.converged = True, False
            fitted.message = f"the evaluations allowed, {self._most}, are used up; the best values so far are kept"
        return fitted

    def __call__(self, best: Fitted) -> None:
        """One more has been made, after which ``best`` is the best of its search."""
        self.done += 1
        if self._on_progress is not None:
            share = 1.0 - np.exp(-self.done / TYPICAL_EVALUATIONS)
            self._on_progress(0.9 * share, f"evaluation {self.done}, misfit {best.chi2:.4g}")
        if self._on_step is not None:
            asked = {p.name for p in best.parameters if not p.nuisance}
            self._on_step(Step(self.done, best.misfit, {n: v for n, v in best.values.items() if n in asked}))


def fit_runs(
    rig: Rig,
    runs: Sequence[Run],
    names: Sequence[str],
    *,
    held_out: Sequence[Run] = (),
    seed: int = 0,
    start: np.ndarray | None = None,
    nuisance: Collection[str] = USUAL,
    bounds: Bounds | None = None,
    max_evaluations: int | None = None,
    per_bag: Collection[str] = (),
    intervals: Intervals = "checked",
    robust: bool = True,
    engine: PooledEngine | None = None,
    on_progress: Progress | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> tuple[FitResult, Rig]:
    """Fit ``names`` to ``runs``; the result and the rig with the fitted values, of nuisances too.

    ``start``: scaled values of ``names`` to start from; ``nuisance``: kinds of nuisances that are estimated beside
    them (:func:`sysid.fit.nuisance.checked_kinds`); ``max_evaluations``: of all searches together, after which
    nothing is searched or looked into any more and the result says that it did not converge; ``on_step``: told after
    each of them; ``per_bag``: those of ``names`` that each run has a value of its own of, named ``friction[run]`` (the
    rig that is returned has their mean); ``intervals``: how far those of ``names`` are looked into
    (:data:`Intervals`); ``robust``: leave out marker readings that are mistakes (:mod:`sysid.fit.outliers`; those of
    ``held_out`` count in its scores); ``engine``: worker processes at hand, for several fits in a row.
    """
    if max_evaluations is not None and max_evaluations < 1:
        raise ConfigError(f"A fit cannot be made in {max_evaluations} evaluations.", "Allow at least one.")
    kinds = checked_kinds(nuisance)
    single = within_bounds(fit_parameters(rig, names), rig, bounds or {})
    asked = with_bags(single, per_bag, [run.name for run in runs], rig)
    at_first = dict(zip([p.name for p in single], start_of(rig, single) if start is None else start, strict=True))
    first = np.array([at_first[p.target] for p in asked])
    evaluations = _Evaluations(max_evaluations, on_progress, on_step)
    with nullcontext(engine) if engine is not None else PooledEngine(os.cpu_count()) as engine:
        return _fit_runs(
            engine, rig, runs, asked, held_out, seed, first, evaluations, on_progress, kinds, intervals, robust
        )


def _shown_sigma(runs: Sequence[Run], channel: str, noise: ChannelNoise) -> float:
    """Standard deviation of the measured columns of a channel (a wrench: of its forces, if it has any)."""
    measured = next(m for run in runs for m in run.measured if m.channel == channel)
    for group in column_groups(measured):
        seen = group[np.isfinite(measured.values[:, group]).any(axis=0)]
        if len(seen):
            return float(np.median(noise.sigma[seen]))
    return float(np.median(noise.sigma))


def _best_of_restarts(
    problem: Problem,
    rig: Rig,
    parameters: list[FitParameter],
    first: np.ndarray,
    seed: int,
    evaluations: _Evaluations,
) -> Fitted:
    """Fit, and while the misfit stays above noise try again from near the best.

    Sticking and sliding make the misfit rough, so a search can end on a kink; restarts stop as soon as
    one brings nothing. One that starts where the rig cannot be simulated is left out.
    """
    fitted = problem.fit(rig, parameters, first, evaluations.left, on_evaluation=evaluations)
    rng = np.random.default_rng(seed)
    width = np.array([min(p.prior_sd, 1.0) for p in parameters])
    for _ in range(MOST_RESTARTS):
        if not parameters or not evaluations.left or fitted.interrupted or fitted.misfit < GOOD_MISFIT:
            break
        near = fitted.scaled + RESTART_WIDTH * width * rng.standard_normal(len(width))
        try:
            again = problem.fit(rig, parameters, near, evaluations.left, on_evaluation=evaluations)
        except ThinshellError:
            evaluations(fitted)
            continue
        better = again.chi2 < 0.98 * fitted.chi2
        if again.chi2 < fitted.chi2:
            again.seconds += fitted.seconds
            fitted = again
        if again.interrupted or not better:
            break
    return evaluations.limit(fitted)


def _fit_runs(
    engine: PooledEngine,
    rig: Rig,
    runs: Sequence[Run],
    asked: list[FitParameter],
    held_out: Sequence[Run],
    seed: int,
    start: np.ndarray,
    evaluations: _Evaluations,
    on_progress: Progress | None,
    kinds: frozenset[str],
    intervals: Intervals,
    robust: bool,
) -> tuple[FitResult, Rig]:
    beside = nuisance_parameters(rig, runs, asked, kinds) if asked else []
    bias = bool(asked) and has_bias(runs, asked, kinds)
    parameters = [*asked, *beside]
    first = np.concatenate([start, start_of(rig, beside)])

    def search(problem: Problem, at: np.ndarray) -> Fitted:
        return _best_of_restarts(problem, rig, parameters, at, seed, evaluations)

    look = _Look(list(runs), list(held_out), [], None)
    if robust:
        look = _first_look(engine, rig_at(rig, parameters, first), runs, held_out)
    at, spent = first, 0.0
    for left in reversed(range(LOOKS)):
        noise = channel_noise(rig, [*look.runs, *look.held_out])
        problem, fitted = fit_beside_own_error(
            engine, look.runs, noise, rig, parameters, start=at, plain=look.plain, bias=bias, search=search
        )
        fitted.seconds += spent
        if not robust or not left or fitted.cut_short:
            break
        again, told = without_outliers(runs, fitted.predictions, noise)
        if not worth_another_fit(look.runs, again):
            break
        look = replace(look, runs=again, outliers=told, plain=fitted.predictions)
        at, spent = fitted.scaled, fitted.seconds
    before = problem.evaluate(rig, [], np.zeros(0))
    estimates, correlation, sentences, reduced = estimates_of(fitted, first)
    sentences += blamed(problem, fitted, sorted(kinds))
    profiles, sentences = _profiled(problem, fitted, sentences, intervals, on_progress)
    nuisances = nuisances_of(problem, fitted)
    errors = rms_errors(problem, before, fitted, held_out=False)
    series = plot_series(problem, before, fitted, held_out=False, raw=runs)
    notes = [f"{run.name}: {note}" for run in [*runs, *held_out] for note in run.notes]
    notes += loud(problem) + out_of_sight(problem, before, fitted)
    if held_out and any(p.bag for p in asked):
        notes.append("Held-out recordings are predicted with the mean of the values that each bag has for itself.")
    if held_out and on_progress is not None:
        on_progress(0.98, "held-out recordings")
    mistaken = [o.sentence for o in look.outliers]
    seen, followed = list(runs), list(fitted.predictions)
    for run in held_out:
        check = Problem([run], noise, engine, bias=bias)
        try:
            there = check.evaluate(rig, [], np.zeros(0))
            scored = check.evaluate(fitted.rig, [], np.zeros(0))
        except ThinshellError as error:
            notes.append(f"{run.name}: could not be simulated: {error}")
            continue
        if robust:
            mistaken += [o.sentence_of_score for o in without_outliers([run], scored.predictions, noise)[1]]
            seen, followed = [*seen, run], [*followed, *scored.predictions]
        errors += rms_errors(check, there, scored, held_out=True)
        notes += out_of_sight(check, there, scored)
        series += plot_series(check, there, scored, held_out=True, raw=[run])
    notes += mistaken + (not_looked_for(seen, followed, noise) if robust else [])
    result = FitResult(
        rig=rig.name,
        estimates=estimates,
        correlation=correlation,
        identifiability=sentences,
        errors=errors,
        reduced_chi2=reduced,
        converged=fitted.converged,
        message=fitted.message,
        evaluations=evaluations.done,
        seconds=fitted.seconds,
        noise={
            c: {"sigma": _shown_sigma([*runs, *held_out], c, n), "correlation": n.rho, "from": n.source}
            for c, n in noise.items()
        },
        notes=notes,
        provenance=provenance(rig, list(runs), list(held_out), seed),
        series=series,
        nuisances=nuisances,
        remarks=remarks(rig, nuisances),
        profiles=profiles,
        outliers=look.outliers,
    )
    return result, fitted.rig


@dataclass(frozen=True)
class _Look:
    """Runs without mistaken readings, and those readings. ``plain``: predictions where the next fit starts."""

    runs: list[Run]
    held_out: list[Run]
    outliers: list[Outliers]
    plain: list[Prediction] | None


def _first_look(engine: PooledEngine, rig: Rig, runs: Sequence[Run], held_out: Sequence[Run]) -> _Look:
    """The runs without what are mistakes beside the rig that a fit starts from; as they are where it cannot follow."""
    if not any(m.kind in DIMENSIONS for run in runs for m in run.measured):
        return _Look(list(runs), list(held_out), [], None)
    pending = [(run, engine.submit(rig, run)) for run in [*runs, *held_out]]
    noise = channel_noise(rig, [*runs, *held_out])
    clean: list[Run] = []
    outliers: list[Outliers] = []
    plain: list[Prediction] = []
    for k, (run, future) in enumerate(pending):
        try:
            prediction = future.result()
        except ThinshellError:
            clean.append(run)
            continue
        found, told = without_outliers([run], [prediction], noise)
        clean += found
        if k < len(runs):
            outliers += told
            plain.append(prediction)
    return _Look(clean[: len(runs)], clean[len(runs) :], outliers, plain if len(plain) == len(runs) else None)


def _profiled(
    problem: Problem, fitted: Fitted, sentences: list[str], intervals: Intervals, on_progress: Progress | None
) -> tuple[list[Profile], list[str]]:
    """Profiles, where they are wanted, and what is then known of the parameters in words.

    Where a profile says how far the data limit a parameter on both sides, that takes the place of the sentence that
    they do not determine it. Around values that are not the best fit intervals mean nothing, and little is said.
    """
    if intervals == "quadratic" or fitted.cut_short or not fitted.parameters:
        return [], sentences
    if not fitted.converged:
        left_out = ["No interval was sought by profile likelihood, since the fit did not converge."]
        return [], sentences + (left_out if intervals == "profiled" else [])

    def tell(share: float, text: str) -> None:
        if on_progress is not None:
            on_progress(0.9 + 0.08 * share, text)

    profiler = Profiler(problem, fitted, tell)
    if intervals == "checked":
        return [], sentences + profiler.check()
    profiles = profiler.profiles()
    better = profiler.lower()
    if better:
        return profiles, [*sentences, better]
    said = [p for p in profiles if p.sentence]
    replaced = tuple(f"The data do not determine {p.name}:" for p in said if p.limited)
    return profiles, [s for s in sentences if not s.startswith(replaced)] + [p.sentence for p in said]


def fit_bags(
    rig: Rig,
    bags: Sequence[Path],
    names: Sequence[str],
    *,
    held_out: Sequence[Path] = (),
    out: Path,
    seed: int = 0,
    nuisance: Collection[str] = USUAL,
    bounds: Bounds | None = None,
    max_evaluations: int | None = None,
    per_bag: Collection[str] = (),
    intervals: Intervals = "checked",
    robust: bool = True,
    on_progress: Progress | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> str:
    """Fit bags (:func:`fit_runs`) and write ``fit.json``, ``fitted_rig.yaml`` and ``report.html`` into ``out``."""
    from sysid.report import write_fit_report

    with whole_folder(out) as folder:
        runs, kept = load_runs(rig, bags, held_out)
        result, fitted = fit_runs(
            rig, runs, names, held_out=kept, seed=seed, nuisance=nuisance, bounds=bounds,
            max_evaluations=max_evaluations, per_bag=per_bag, intervals=intervals, robust=robust,
            on_progress=on_progress, on_step=on_step,
        )  # fmt: skip
        result.write(folder / "fit.json")
        (folder / "fitted_rig.yaml").write_text(rig_to_yaml(fitted))
        report = write_fit_report(result, folder / "report.html")
    return f"{result.table()}\n\nReport: {out / report.name}"
