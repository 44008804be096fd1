"""The baseline: the rig without any further effect, fitted to the recordings as well as what is known of it allows.

It goes through the same pipeline as a fit: readings that are mistakes are left out, clocks, cameras and tool poses are
nuisance parameters within their priors, and the error of mesh and time step is measured by refinement where the fit
stands. Two things differ. Every parameter is pulled to the rig's value by what is known of it, so that a modulus does
not eat an effect; and offsets of wrench sensors are no nuisance but a hypothesis, to be named where there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.stats import norm

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.diagnosis.error_turns import fitted_on, settled
from sysid.diagnosis.fits import fit_within
from sysid.diagnosis.held_out import as_predicted, held_out_problem
from sysid.diagnosis.known_priors import open_parameters, with_known_priors
from sysid.diagnosis.reference_model import Added, Reference, Standing, reference_for, standing
from sysid.discretisation.approximations import refinement_errors
from sysid.discretisation.coarser_cells import coarsened
from sysid.discretisation.followed_model import Share, follows
from sysid.discretisation.time_steps import predicted_with_steps, shorter_throughout
from sysid.model.nuisance_parameters import KINDS, nuisance_parameters
from sysid.model.parameters import fit_parameters, rig_in, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.model.sparing_predictor import SparingPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import channel_noise
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.named_errors import NamedErrors
from sysid.solve.optimum import Fitted
from sysid.solve.outliers import Outliers, without_outliers, worth_another_fit
from sysid.solve.residuals import Problem


@dataclass
class Baseline:
    """``recorded``: the recordings given, with mistakes; ``problem``, ``fitted``: those without; ``check``, ``there``:
    those held out; ``noise`` by channel; ``outliers``: readings that were left out; ``notes``: on recordings that could
    not be followed; ``reference``: the model with finer cells or wider pads whose readings are added, None where there
    is none; ``undecided``: recordings that keep the time steps of the rig, since too much of them is not explained to
    tell; ``measured_at``: scaled values ``(p,)`` at which the errors of mesh and time step were measured."""

    recorded: list[Run]
    problem: Problem
    fitted: Fitted
    check: Problem
    there: Fitted | None
    noise: dict[str, ChannelNoise]
    outliers: list[Outliers]
    notes: tuple[str, ...]
    reference: Reference | None
    undecided: tuple[str, ...] = ()
    measured_at: np.ndarray | None = None

    @property
    def identity(self) -> object:
        """What it is known by in one diagnosis: the readings that are compared, where it stands, and with which
        errors."""
        clean = [(run.name, run.steps, [m.values for m in run.measured]) for run in self.problem.runs]
        return clean, self.problem.named, self.fitted.scaled

    @property
    def engine(self) -> SpaceMappedPredictor:
        """Predictions of the rig's model, with what the reference model adds."""
        return cast(SpaceMappedPredictor, self.problem.engine)


def fit_baseline(
    engine: AnyEngine, rig: Rig, runs: Sequence[Run], held_out: Sequence[Run], say: Callable[[str], None]
) -> Baseline:
    """Fit the baseline. Recordings that have time steps keep these. ``say``: takes what is being done, in words. Raises
    ``ThinshellError`` where a recording that is given cannot be simulated; ones held out are left out then, with a
    note."""
    coarser = coarsened(rig)
    rig = rig if coarser is None else coarser.rig
    parameters = with_known_priors(rig, fit_parameters(rig, open_parameters(rig)))
    parameters += nuisance_parameters(rig, runs, parameters, KINDS)
    start = start_of(rig, parameters)
    noise = channel_noise(rig, runs, held_out)
    rigs = [rig_in(rig, parameters, start, run.name) for run in runs]
    if rig.solver.inertia:  # What shorter steps change near resonances says something where the fit stands only.
        jobs = [engine.submit(there, run) for there, run in zip(rigs, runs, strict=True)]
        own = [job.result() for job in jobs]
    else:
        runs, own = predicted_with_steps(engine, rigs, runs, noise)
    say("cells and extent of gels")
    sparing = SparingPredictor(engine)
    reference, added, warnings = reference_for(sparing, rig, parameters, runs, held_out, noise, coarser)
    say("error of mesh and time step")

    def stands(scaled: np.ndarray, own: Sequence[Prediction], known: Added | None = None) -> Standing:
        rigs = [rig_in(rig, parameters, scaled, run.name) for run in runs]
        return standing(sparing, reference, rigs, runs, own, known)

    model = stands(start, own, added)
    clean, _ = without_outliers(runs, model.plain, noise)
    noise = channel_noise(rig, clean, held_out)

    def problem_of(clean: Sequence[Run]) -> Problem:
        return Problem(clean, noise, model.engine, prior=True, named=refinement_errors(model.refined, clean))

    problem = problem_of(clean)
    say("baseline fit")
    fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations, rig, parameters, start)
    # While the model was far off, no mistake could be recognised, and chi-square was that of mistakes.
    again, _ = without_outliers(runs, fitted.predictions, noise)
    if worth_another_fit(clean, again):
        problem = problem_of(again)
        fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations, rig, parameters, fitted.scaled)
    shorter = None
    undecided: tuple[str, ...] = ()
    if rig.solver.inertia:
        runs, shorter, undecided = _shorter_steps(engine, problem, fitted, runs, noise)
    if shorter is not None:
        say("baseline fit with shorter time steps")
        model = stands(fitted.scaled, shorter)
        problem = problem_of(without_outliers(runs, model.plain, noise)[0])
        start = fitted.scaled
        fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations, rig, parameters, start)
    elsewhere = None
    if _is_far(fitted):
        say("other branches of contact")
        elsewhere = best_branch(model.engine, problem, fitted)
        if elsewhere is not None:
            fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations, rig, parameters, elsewhere)
    clean, outliers = without_outliers(runs, fitted.predictions, noise)
    noise = channel_noise(rig, clean, held_out)
    say("error of mesh and time step where the fit stands")
    problem = problem_of(clean)
    fitted = fitted_on(problem, fitted)
    problem, fitted, at = settled(problem, fitted, reference, start)
    problem.engine = SpaceMappedPredictor(engine, cast(SpaceMappedPredictor, problem.engine).added)
    say("held-out recordings")
    check, notes = held_out_problem(engine, fitted, noise, held_out, reference)
    there = check.evaluate(fitted.rig, [], np.zeros(0)) if check.runs else None
    extent = () if reference is None else reference.notes
    notes = (*extent, *warnings, *notes)
    return Baseline(list(runs), problem, fitted, check, there, noise, outliers, notes, reference, undecided, at)


def with_all_named_errors(base: Baseline, named: NamedErrors) -> Baseline:
    """The baseline fitted on with all named errors, of which it had those of mesh and time step alone."""
    return _fitted_on(base, base.problem.with_named(named))


def without_mistakes_of(base: Baseline, predictions: Sequence[Prediction]) -> Baseline | None:
    """The baseline fitted on without the readings that are mistakes by the residuals of other predictions; None where
    they are those that it is without already."""
    clean, outliers = without_outliers(base.recorded, predictions, base.noise)
    if not worth_another_fit(base.problem.runs, clean):
        return None
    problem = Problem(clean, base.noise, base.engine, prior=True, named=base.problem.named)
    return _fitted_on(replace(base, outliers=outliers), problem)


def _fitted_on(base: Baseline, problem: Problem) -> Baseline:
    """The baseline fitted to another problem from where it stands."""
    problem.engine = base.engine
    return with_fit(replace(base, problem=problem), fitted_on(problem, base.fitted))


def with_fit(base: Baseline, fitted: Fitted) -> Baseline:
    """The baseline with another fit to its problem, and with the errors of mesh and time step where that stands."""
    was = base.fitted
    problem, fitted, at = settled(base.problem, fitted, base.reference, base.measured_at)
    if not was.converged:
        fitted.converged, fitted.message = False, was.message
    fitted = with_own_derivatives(problem, fitted)
    check = as_predicted(base.check, fitted)
    there = check.evaluate(fitted.rig, [], np.zeros(0)) if check.runs else None
    return replace(base, problem=problem, fitted=fitted, check=check, there=there, measured_at=at)


def with_own_derivatives(problem: Problem, fitted: Fitted) -> Fitted:
    """The model with derivatives that are made where it stands: those of a search are carried over from where it was
    (:mod:`sysid.model.sparing_predictor`), and evidence hangs on them."""
    predictions = problem.engine.predict_all(fitted.centre, problem.runs, fitted.parameters, fitted.scaled)
    found = problem.compare(predictions, fitted.centre, fitted.parameters, fitted.scaled)
    found.converged, found.message = fitted.converged, fitted.message
    return found


def best_branch(engine: AnyEngine, problem: Problem, fitted: Fitted) -> np.ndarray | None:
    """Scaled values ``(p,)`` with another friction, or another place of a hand, at which recordings are followed better
    than where a search has ended; None where there are none.

    Whether a point sticks or slips, or to which side a sheet buckles, is no matter of derivatives, nor of short time
    steps: all are compared with those of the rig. Recordings in which nothing touches count as they are while there are
    others. What is far off counts by its logarithm (Cauchy's loss), so that a span on the right branch is worth more
    than a far one nearer.
    """
    frictions = [k for k, p in enumerate(fitted.parameters) if p.target.endswith(".friction")]
    offsets = [k for k, p in enumerate(fitted.parameters) if p.nuisance and ".offset_" in p.target]
    points = []
    for factor in DIAGNOSIS.friction_factors:
        at = fitted.scaled.copy()
        at[frictions] *= factor
        points += [at] if frictions else []
    rng = np.random.default_rng(0)
    for _ in range(DIAGNOSIS.offset_draws if offsets else 0):
        at = fitted.scaled.copy()
        at[offsets] += rng.standard_normal(len(offsets)) * [fitted.parameters[k].prior_sd for k in offsets]
        points.append(at)
    limits = np.array([p.scaled_bounds for p in fitted.parameters]).reshape(-1, 2).T
    points = [np.clip(at, *limits) for at in points]
    runs, here = problem.runs, list(fitted.predictions)
    if fitted.centre.solver.inertia and any(run.steps is not None for run in runs):
        runs = [replace(run, steps=None) for run in runs]
        rigs = [rig_in(fitted.centre, fitted.parameters, fitted.scaled, run.name) for run in runs]
        own = [engine.submit(rig, run) for rig, run in zip(rigs, runs, strict=True)]
        here = [job.result() for job in own]
    touch = [k for k, p in enumerate(here) if any(report.contacts for report in p.trace.reports)] or range(len(runs))
    jobs = [
        {k: engine.submit(rig_in(fitted.centre, fitted.parameters, at, runs[k].name), runs[k]) for k in touch}
        for at in points
    ]
    best, found = _cauchy(problem, here, fitted.scaled), None
    for at, row in zip(points, jobs, strict=True):
        try:
            loss = _cauchy(problem, [row[k].result() if k in row else p for k, p in enumerate(here)], at)
        except ThinshellError:
            continue
        if loss < DIAGNOSIS.better_loss_ratio * best:
            best, found = loss, at
    return found


def _cauchy(problem: Problem, predictions: Sequence[Prediction], scaled: np.ndarray) -> float:
    """Sum of log(1 + (r / c)^2) over the whitened readings, what is out of sight as far off as c."""
    residual = problem.assemble(predictions, [], scaled).residual
    return float(np.sum(np.log1p((residual / DIAGNOSIS.cauchy_width_sd) ** 2)))


def _is_far(fitted: Fitted) -> bool:
    """Whether a model misses more than about a sixth of the readings by far, or most of them by more than noise."""
    left = np.abs(fitted.residual[: len(fitted.residual) - fitted.pulls])
    return bool(len(left) and np.quantile(left, 0.75) > np.sqrt(DIAGNOSIS.branch_misfit_ratio) * norm.ppf(0.875))


def _shorter_steps(
    engine: AnyEngine,
    problem: Problem,
    fitted: Fitted,
    runs: Sequence[Run],
    noise: dict[str, ChannelNoise],
) -> tuple[list[Run], list[Prediction] | None, tuple[str, ...]]:
    """The runs with shorter steps, their predictions where a search stands, None where no step is shorter, and names of
    those that cannot tell which they follow. A recording that follows the steps of the rig keeps them, since it may be
    a simulation with these. So does one of which too much is not explained to tell."""
    found, undecided, shorter = list(runs), [], {}
    for k, run, prediction, share in _halved(engine, problem, fitted, [r for r in runs if r.steps is None], noise):
        if share.surely_refines:
            found[k], shorter[k] = run, prediction
        elif share.refines:
            undecided.append(run.name)
    if not shorter:
        return found, None, tuple(undecided)
    # Those of the fit hold what a reference model adds, which is added to these later.
    again = {
        k: engine.submit(rig_in(fitted.centre, fitted.parameters, fitted.scaled, run.name), run)
        for k, run in enumerate(found)
        if k not in shorter
    }
    predictions = [shorter[k] if k in shorter else again[k].result() for k in range(len(runs))]
    return found, predictions, tuple(undecided)


def with_steps_that_it_follows(base: Baseline, fitted: Fitted) -> list[Run]:
    """The recordings given, those undecided with the time steps that they follow more probably by a model with effects;
    empty where these are the rig's."""
    found = list(base.recorded)
    asked = [run for run in found if run.name in base.undecided]
    for k, run, _, share in _halved(base.engine, base.problem, fitted, asked, base.noise):
        if share.refines:
            found[k] = run
    return found if any(a is not b for a, b in zip(found, base.recorded, strict=True)) else []


def _halved(
    engine: AnyEngine,
    problem: Problem,
    fitted: Fitted,
    runs: Sequence[Run],
    noise: dict[str, ChannelNoise],
) -> Iterator[tuple[int, Run, Prediction, Share]]:
    """Of those of some runs of a problem that halved steps change: its number, the run with these, its prediction where
    a model stands, and how far the recording follows it."""
    names = [run.name for run in problem.runs]
    rigs = [rig_in(fitted.centre, fitted.parameters, fitted.scaled, run.name) for run in runs]
    shorter, there = shorter_throughout(engine, rigs, runs, noise)
    known = np.array([p.known_sd or p.prior_sd for p in fitted.parameters])
    for run, halved, prediction in zip(runs, shorter, there, strict=True):
        if halved is not run:
            k = names.index(run.name)
            share = follows([problem.runs[k]], [fitted.predictions[k]], [[prediction]], noise, known)[0]
            yield k, halved, prediction, share
