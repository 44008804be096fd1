"""The baseline: the rig without any further effect, fitted to the recordings as well as what is known of it allows.

It goes through the same pipeline as a fit: readings that are mistakes are left out, clocks, cameras and tool poses are
nuisance parameters within their priors, and the error of mesh and time step is measured by refinement where the fit
stands. Two things differ. Every parameter is pulled to the rig's value by what is known of it, so that a modulus does
not eat an effect; and offsets of wrench sensors are no nuisance but a hypothesis, to be named where there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy.stats import norm

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.diagnosis.beliefs import believed, open_parameters
from sysid.diagnosis.fits import fit_within
from sysid.diagnosis.held_out import PARAMETERS_ALONE, held_out_problem, held_out_together
from sysid.diagnosis.predictability import unpredictable, without
from sysid.diagnosis.reference_model import Added, Reference, Standing, reference_for, standing
from sysid.diagnosis.residual_analysis import Structure, structure
from sysid.discretisation.coarser_cells import coarsened
from sysid.discretisation.followed_model import follows
from sysid.discretisation.time_steps import predicted_with_steps, shorter_throughout
from sysid.model.nuisance_parameters import KINDS, nuisance_parameters
from sysid.model.parameters import fit_parameters, rig_in, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.model.sparing_predictor import SparingPredictor
from sysid.noise.channel_noise import ChannelNoise
from sysid.noise.estimate import channel_noise, column_groups, quantities
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.discretisation_basis import MODEL, ErrorShape
from sysid.solve.optimum import Fitted
from sysid.solve.outliers import Outliers, without_outliers, worth_another_fit
from sysid.solve.residuals import Problem

Tell = Callable[[float, str], None]


@dataclass
class Baseline:
    """``problem``, ``fitted``: the recordings given, without mistakes; ``check``, ``there``: those held out; ``noise``
    by channel; ``outliers``: readings that were left out; ``notes``: on recordings that could not be followed;
    ``reference``: the model with finer cells or wider pads whose readings are added, None where there is none;
    ``together``: structured misfit of the recordings held out where one baseline is fitted to all, None where the
    other ones alone tell."""

    problem: Problem
    fitted: Fitted
    check: Problem
    there: Fitted | None
    noise: dict[str, ChannelNoise]
    outliers: list[Outliers]
    notes: tuple[str, ...]
    reference: Reference | None
    together: Structure | None = None

    @property
    def held_out(self) -> Structure | None:
        """Structured misfit of the recordings held out, None without any."""
        if self.together is not None or self.there is None:
            return self.together
        return structure(self.check, self.there)

    @property
    def engine(self) -> SpaceMappedPredictor:
        """Predictions of the rig's model, with what the reference model adds."""
        return cast(SpaceMappedPredictor, self.problem.engine)


def fit_baseline(engine: AnyEngine, rig: Rig, runs: Sequence[Run], held_out: Sequence[Run], tell: Tell) -> Baseline:
    """Fit the baseline. Raises ``ThinshellError`` where a recording that is given cannot be simulated; ones held out
    are left out then, with a note."""
    coarser = coarsened(rig)
    rig = rig if coarser is None else coarser.rig
    parameters = believed(rig, fit_parameters(rig, open_parameters(rig)))
    parameters += nuisance_parameters(rig, runs, parameters, KINDS)
    start = start_of(rig, parameters)
    noise = channel_noise(rig, runs, held_out)
    rigs = [rig_in(rig, parameters, start, run.name) for run in runs]
    if rig.solver.inertia:  # What shorter steps change near resonances says something where the fit stands only.
        jobs = [engine.submit(there, run) for there, run in zip(rigs, runs, strict=True)]
        own = [job.result() for job in jobs]
    else:
        runs, own = predicted_with_steps(engine, rigs, runs, noise)
    tell(0.04, "cells and extent of gels")
    sparing = SparingPredictor(engine)
    reference, added, told = reference_for(sparing, rig, parameters, runs, held_out, noise, coarser)
    tell(0.08, "error of mesh and time step")

    def stands(scaled: np.ndarray, own: Sequence[Prediction], known: Added | None = None) -> Standing:
        rigs = [rig_in(rig, parameters, scaled, run.name) for run in runs]
        return standing(sparing, reference, rigs, runs, own, known)

    model = stands(start, own, added)
    clean, _ = without_outliers(runs, model.plain, noise)
    noise = channel_noise(rig, clean, held_out)
    shapes = model.shapes
    fine, left_out = fine_enough(clean, shapes, noise)
    if left_out:
        runs, clean = [runs[k] for k in fine], [clean[k] for k in fine]
        shapes = [replace(s, shapes=tuple(s.shapes[k] for k in fine), sight=_chosen(s.sight, fine)) for s in shapes]
    problem = Problem(clean, noise, model.engine, shapes, prior=True)
    tell(0.15, "baseline fit")
    fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations, rig, parameters, start)
    # While the model was far off, no reading could be told to be a mistake, and chi-square was that of the mistakes.
    again, _ = without_outliers(runs, fitted.predictions, noise)
    if worth_another_fit(clean, again):
        clean = again
        problem = Problem(clean, noise, model.engine, shapes, prior=True)
        fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations, rig, parameters, fitted.scaled)
    shorter = None
    if rig.solver.inertia:
        runs, shorter, undecided = _shorter_steps(engine, problem, fitted, runs, noise)
        told = (*told, *undecided)
    if shorter is not None:
        tell(0.2, "baseline fit with shorter time steps")
        model = stands(fitted.scaled, shorter)
        clean, _ = without_outliers(runs, model.plain, noise)
        shapes = model.shapes
        problem = Problem(clean, noise, model.engine, shapes, prior=True)
        start = fitted.scaled
        fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations, rig, parameters, start)
    elsewhere = None
    if _is_far(fitted):
        tell(0.22, "other branches of contact")
        elsewhere = best_branch(model.engine, problem, fitted)
        if elsewhere is not None:
            fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations, rig, parameters, elsewhere)
    clean, outliers = without_outliers(runs, fitted.predictions, noise)
    noise = channel_noise(rig, clean, held_out)
    tell(0.28, "error of mesh and time step where the fit stands")
    unknown = ""
    known = np.array([p.known_sd or p.prior_sd for p in parameters])
    within = DIAGNOSIS.error_measured_within_sd if reference is None else DIAGNOSIS.reference_within_sd
    within = DIAGNOSIS.ringing_within_sd if rig.solver.inertia else within
    far = bool(np.abs((fitted.scaled - start) / known).max(initial=0.0) > within)
    try:
        if elsewhere is not None or far:
            model = stands(fitted.scaled, sparing.predict_all(rig, runs, parameters, fitted.scaled))
            shapes = model.shapes
    except ThinshellError as error:
        unknown = f"it stands where its discretisation error is not known. {error}"
    problem = Problem(clean, noise, model.engine, shapes, prior=True)
    fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations_beside, rig, parameters, fitted.scaled)
    if unknown:
        fitted.converged, fitted.message = False, unknown
    problem.engine = SpaceMappedPredictor(engine, model.engine.added)
    tell(0.38, "held-out recordings")
    check, notes = held_out_problem(engine, fitted, noise, held_out, reference)
    there = check.evaluate(fitted.rig, [], np.zeros(0)) if check.runs else None
    extent = () if reference is None else reference.notes
    said = (*extent, *told, *left_out, *notes)
    base = Baseline(problem, fitted, check, there, noise, outliers, said, reference)
    missing = structure(problem, fitted).missing
    if not missing and base.held_out is not None and base.held_out.missing:
        tell(0.385, "one baseline for all recordings")
        together = held_out_together(problem, check, fitted, sparing)
        missing = together is None
        if together is not None:
            base = replace(base, together=together, notes=(*base.notes, PARAMETERS_ALONE))
    return _where_predictable(base, sparing, tell) if missing else base


def _off(problem: Problem, fitted: Fitted) -> list[int]:
    """Numbers of the recordings that a model misses by more than noise and what it may be off."""
    parts = iter(structure(problem, fitted).parts)
    found = []
    for k, run in enumerate(problem.runs):
        mine = [next(parts) for m in run.measured for _ in column_groups(m)]
        if any(p.beyond_discretisation for p in mine):
            found.append(k)
    return found


def _where_predictable(base: Baseline, sparing: SparingPredictor, tell: Tell) -> Baseline:
    """The baseline fitted again without what is unpredictable (:mod:`sysid.diagnosis.predictability`).

    ``sparing``: with the derivatives of the last search.
    """
    tell(0.39, "where recordings can be predicted")
    model = base.fitted
    pairs = [(base.problem, model)] + ([(base.check, base.there)] if base.there is not None else [])
    off = [(there, k) for there, fitted in pairs for k in _off(there, fitted)]
    everything = [there.runs[k] for there, k in off]
    refined = [
        {m.channel: [d.shapes[k][m.channel] for d in there.error_shapes if d.label != MODEL] for m in run.measured}
        for (there, k), run in zip(off, everything, strict=True)
    ]
    added = {**base.engine.added, **cast(SpaceMappedPredictor, base.check.engine).added}
    engine = SpaceMappedPredictor(base.engine.coarse, added)
    given = [model.predictions[k] for there, k in off if there is base.problem]
    others = [run for run, (there, _) in zip(everything, off, strict=True) if there is not base.problem]
    derived = [*given, *engine.predict_all(model.centre, others, model.parameters, model.scaled)]
    found = unpredictable(engine, everything, model, base.noise, derived, refined)
    if not found:
        return base
    notes = (*base.notes, *(u.sentence for u in found))
    runs, again = without(base.problem.runs, found), SpaceMappedPredictor(sparing, base.engine.added)
    problem = Problem(runs, base.noise, again, base.problem.error_shapes, prior=True)
    fitted = fit_within(problem, DIAGNOSIS.baseline_evaluations_beside, model.centre, model.parameters, model.scaled)
    problem.engine = base.engine
    check = Problem(without(base.check.runs, found), base.noise, base.check.engine, base.check.error_shapes)
    there = check.evaluate(fitted.rig, [], np.zeros(0)) if check.runs else None
    return replace(base, problem=problem, fitted=fitted, check=check, there=there, notes=notes)


def fine_enough(
    runs: Sequence[Run], shapes: Sequence[ErrorShape], noise: dict[str, ChannelNoise]
) -> tuple[list[int], tuple[str, ...]]:
    """Numbers of the recordings that mesh and time step can follow, and a sentence for each other one, which would only
    be fitted by what makes up for the discretisation error. Where there is none, all are kept."""
    kept, said = list(range(len(runs))), []
    for k, run in enumerate(runs):
        for m in run.measured:
            errors = [s.shapes[k][m.channel] for s in shapes if s.label != MODEL]
            whole = np.where(np.isfinite(m.values), np.sum(errors, axis=0), np.nan)
            for name, group in quantities(m):
                seen = whole[:, group][:, np.isfinite(whole[:, group]).any(axis=0)]
                if not seen.size or k not in kept:
                    continue
                ratio = float(np.nanmedian(np.abs(seen)) / np.median(noise[m.channel].sigma[group]))
                if ratio > DIAGNOSIS.too_coarse_ratio:
                    kept.remove(k)
                    said.append(
                        f"{run.name} weighs nothing: the error of mesh and time step in the {name} of {m.channel} is "
                        f"{ratio:.0f} times the noise most of the time, more than {DIAGNOSIS.too_coarse_ratio:g} "
                        "times. Use finer cells or a shorter solver.dt_s to ask it."
                    )
    return (kept, tuple(said)) if kept else (list(range(len(runs))), ())


def _chosen(items: tuple[dict[str, np.ndarray], ...], numbers: Sequence[int]) -> tuple[dict[str, np.ndarray], ...]:
    return tuple(items[k] for k in numbers) if items else ()


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
    engine: AnyEngine, problem: Problem, fitted: Fitted, runs: Sequence[Run], noise: dict[str, ChannelNoise]
) -> tuple[list[Run], list[Prediction] | None, tuple[str, ...]]:
    """The runs with shorter steps, their predictions where a search stands, None where no step is shorter, and in words
    where that cannot be told. A recording that follows the steps of the rig keeps them, since it may be a simulation
    with these, and so does one that follows neither, as where a strip snaps, or of which too much is not explained."""
    rigs = [rig_in(fitted.centre, fitted.parameters, fitted.scaled, run.name) for run in runs]
    found, told = list(runs), []
    shorter, there = shorter_throughout(engine, rigs, runs, noise)
    known = np.array([p.known_sd or p.prior_sd for p in fitted.parameters])
    for k, prediction in enumerate(there):
        if shorter[k] is runs[k]:
            continue
        share = follows([problem.runs[k]], [fitted.predictions[k]], [[prediction]], noise, known)[0]
        if share.surely_refines:
            found[k] = shorter[k]
        elif share.refines:
            told.append(
                f"{runs[k].name} keeps the time steps of the rig: its readings change with shorter ones, but so much "
                "of it is not explained that it cannot tell which it follows "
                f"({share.value:.2g} +- {share.robust_sd:.2g} of the way to halved steps). Repeat the "
                "diagnosis with half the solver.dt_s to see what depends on it."
            )
    if all(a is b for a, b in zip(found, runs, strict=True)):
        return found, None, tuple(told)
    # Those of the fit hold what a reference model adds, which is added to these later.
    again = {k: engine.submit(rigs[k], run) for k, run in enumerate(found) if run is not shorter[k]}
    return found, [again[k].result() if k in again else there[k] for k in range(len(runs))], tuple(told)
