"""From bags to a fit result: the function behind ``thinshell fit``."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig, rig_to_yaml
from sysid.fit.fitted import Fitted
from sysid.fit.noise import ChannelNoise, channel_noise, column_groups
from sysid.fit.nuisance import checked_kinds, has_bias, nuisance_parameters
from sysid.fit.own_error import fit_beside_own_error, loud
from sysid.fit.parameters import FitParameter, fit_parameters, start_of, within_bounds
from sysid.fit.pool import PooledEngine
from sysid.fit.problem import Problem
from sysid.fit.result import FitResult, estimates_of, out_of_sight, plot_series, rms_errors
from sysid.fit.runs import Run, load_runs
from sysid.fit.untold import blamed, nuisances_of, remarks
from sysid.folder import whole_folder
from sysid.provenance import provenance

Progress = Callable[[float, str], None]

Bounds = Mapping[str, tuple[float, float]]
"""Lowest and highest value of parameters by name, in their own units, within those that the fit has."""

MOST_RESTARTS = 4
RESTART_WIDTH = 0.05
"""Restarts start this far (standard deviations, in units of the fitted scale) from the best so far."""

GOOD_MISFIT = 1.5
"""Misfit over noise below which a fit is not tried again."""

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
        self._done = 0

    @property
    def left(self) -> int:
        """Evaluations that the next search may make; always one, without which there is nothing to report."""
        left = EVALUATIONS_OF_A_SEARCH if self._most is None else self._most - self._done
        return min(max(left, 1), EVALUATIONS_OF_A_SEARCH)

    def __call__(self, best: Fitted) -> None:
        """One more has been made, after which ``best`` is the best of its search."""
        self._done += 1
        if self._on_progress is not None:
            share = 1.0 - np.exp(-self._done / TYPICAL_EVALUATIONS)
            self._on_progress(0.9 * share, f"evaluation {self._done}, misfit {best.chi2:.4g}")
        if self._on_step is not None:
            asked = {p.name for p in best.parameters if not p.nuisance}
            self._on_step(Step(self._done, best.misfit, {n: v for n, v in best.values.items() if n in asked}))


def fit_runs(
    rig: Rig,
    runs: Sequence[Run],
    names: Sequence[str],
    *,
    held_out: Sequence[Run] = (),
    seed: int = 0,
    start: np.ndarray | None = None,
    nuisance: Collection[str] = ("all",),
    bounds: Bounds | None = None,
    max_evaluations: int | None = None,
    on_progress: Progress | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> tuple[FitResult, Rig]:
    """Fit ``names`` to ``runs``; the result and the rig with the fitted values, of nuisances too.

    ``start``: scaled values of ``names`` to start from; ``nuisance``: kinds of nuisances that are estimated beside
    them (:func:`sysid.fit.nuisance.checked_kinds`); ``max_evaluations``: of all searches together, after which the
    result says that it did not converge; ``on_step``: told after each of them.
    """
    kinds = checked_kinds(nuisance)
    asked = within_bounds(fit_parameters(rig, names), rig, bounds or {})
    evaluations = _Evaluations(max_evaluations, on_progress, on_step)
    with PooledEngine(os.cpu_count()) as engine:
        return _fit_runs(engine, rig, runs, asked, held_out, seed, start, evaluations, on_progress, kinds)


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
        if not parameters or fitted.interrupted or fitted.misfit < GOOD_MISFIT:
            break
        near = fitted.scaled + RESTART_WIDTH * width * rng.standard_normal(len(width))
        try:
            again = problem.fit(rig, parameters, near, evaluations.left, on_evaluation=evaluations)
        except ThinshellError:
            continue
        better = again.chi2 < 0.98 * fitted.chi2
        if again.chi2 < fitted.chi2:
            again.evaluations += fitted.evaluations
            again.seconds += fitted.seconds
            fitted = again
        if again.interrupted or not better:
            break
    return fitted


def _fit_runs(
    engine: PooledEngine,
    rig: Rig,
    runs: Sequence[Run],
    asked: list[FitParameter],
    held_out: Sequence[Run],
    seed: int,
    start: np.ndarray | None,
    evaluations: _Evaluations,
    on_progress: Progress | None,
    kinds: frozenset[str],
) -> tuple[FitResult, Rig]:
    noise = channel_noise(rig, [*runs, *held_out])
    beside = nuisance_parameters(rig, runs, asked, kinds) if asked else []
    bias = bool(asked) and has_bias(runs, asked, kinds)
    parameters = [*asked, *beside]
    first = np.concatenate([start_of(rig, asked) if start is None else start, start_of(rig, beside)])

    def search(problem: Problem, at: np.ndarray) -> Fitted:
        return _best_of_restarts(problem, rig, parameters, at, seed, evaluations)

    problem, fitted = fit_beside_own_error(engine, runs, noise, rig, parameters, start=first, bias=bias, search=search)
    before = problem.evaluate(rig, [], np.zeros(0))
    estimates, correlation, sentences, reduced = estimates_of(fitted, first)
    sentences += blamed(problem, fitted, sorted(kinds))
    nuisances = nuisances_of(problem, fitted)
    errors = rms_errors(problem, before, fitted, held_out=False)
    series = plot_series(problem, before, fitted, held_out=False)
    notes = [f"{run.name}: {note}" for run in [*runs, *held_out] for note in run.notes]
    notes += loud(problem) + out_of_sight(problem, before, fitted)
    if held_out and on_progress is not None:
        on_progress(0.92, "held-out recordings")
    for run in held_out:
        check = Problem([run], noise, engine, bias=bias)
        try:
            there = check.evaluate(rig, [], np.zeros(0))
            scored = check.evaluate(fitted.rig, [], np.zeros(0))
        except ThinshellError as error:
            notes.append(f"{run.name}: could not be simulated: {error}")
            continue
        errors += rms_errors(check, there, scored, held_out=True)
        notes += out_of_sight(check, there, scored)
        series += plot_series(check, there, scored, held_out=True)
    result = FitResult(
        rig=rig.name,
        estimates=estimates,
        correlation=correlation,
        identifiability=sentences,
        errors=errors,
        reduced_chi2=reduced,
        converged=fitted.converged,
        message=fitted.message,
        evaluations=fitted.evaluations,
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
    )
    return result, fitted.rig


def fit_bags(
    rig: Rig,
    bags: Sequence[Path],
    names: Sequence[str],
    *,
    held_out: Sequence[Path] = (),
    out: Path,
    seed: int = 0,
    nuisance: Collection[str] = ("all",),
    bounds: Bounds | None = None,
    max_evaluations: int | None = None,
    on_progress: Progress | None = None,
    on_step: Callable[[Step], None] | None = None,
) -> str:
    """Fit bags (:func:`fit_runs`) and write ``fit.json``, ``fitted_rig.yaml`` and ``report.html`` into ``out``."""
    from sysid.report import write_fit_report

    runs, kept = load_runs(rig, bags, held_out)
    result, fitted = fit_runs(
        rig, runs, names, held_out=kept, seed=seed, nuisance=nuisance, bounds=bounds, max_evaluations=max_evaluations,
        on_progress=on_progress, on_step=on_step,
    )  # fmt: skip
    with whole_folder(out) as folder:
        result.write(folder / "fit.json")
        (folder / "fitted_rig.yaml").write_text(rig_to_yaml(fitted))
        report = write_fit_report(result, folder / "report.html")
    return f"{result.table()}\n\nReport: {out / report.name}"
