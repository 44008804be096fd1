"""The account that a diagnosis gives of itself: what became of each effect, limits, reservations."""

from __future__ import annotations

import numpy as np

from sim_core.effects import all_effects, split_key
from sim_core.rigs import Rig
from sysid.diagnosis.model_selection import Trial, Verdict
from sysid.diagnosis.residual_analysis import Structure
from sysid.fit.discretisation_refinement import large_discretisation_errors, unresolved_quantities
from sysid.model.parameters import start_of
from sysid.model.windows import not_from_rest
from sysid.noise.data_quality import data_quality_warnings
from sysid.noise.estimate import FROM_DIFFERENCES
from sysid.solve.covariance import uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


def limits(trials: list[Trial], named: set[str]) -> dict[str, float]:
    """By amplitude, the farthest from none at all that the recordings still allow (95 %)."""
    found: dict[str, float] = {}
    for trial in trials:
        if trial.effect.name in named:
            continue
        known = uncertainty(trial.fitted)
        for p, scaled, sd in zip(trial.fitted.parameters, trial.fitted.scaled, known.sd, strict=True):
            vanishing = next(
                (q.vanishing for q in trial.effect.parameters if p.name == f"effects.{trial.effect.name}.{q.name}"),
                None,
            )
            if vanishing is None:
                continue
            ends = [p.physical(scaled - 1.96 * sd), p.physical(scaled + 1.96 * sd)]
            # What vanishes at infinity (a yield curvature) is bounded from below.
            found[p.name] = max(ends, key=lambda v: abs(v - vanishing)) if np.isfinite(vanishing) else min(ends)
    return found


def fates(trials: list[Trial], failed: dict[str, str], named: set[str], rig: Rig) -> dict[str, str]:
    """What became of each effect of the library that the rig may lack, in a few words."""
    present = {split_key(key)[0] for key in rig.effects}
    apply = [e.name for e in all_effects().values() if e.name not in present and e.variants(rig)]
    became = dict.fromkeys(apply, "promised no better fit") | failed
    became |= {t.effect.name: t.rejected or "fits, but less well than the answer" for t in trials}
    return became | {name: "the answer" for name in named}


def notes(base: Fitted, problem: Problem, before: Structure, verdict: Verdict) -> tuple[str, ...]:
    """What a reader should know of the baseline, and of answers, before believing the verdict."""
    said = [f"{run.name} does not begin at rest: {n}" for run in problem.runs for n in not_from_rest(base.rig, run)]
    if not base.converged:
        said.append(f"The baseline fit did not converge: {base.message}.")
    for trial in verdict.named if verdict.kind != "unknown" else ():
        if not trial.fitted.converged:
            said.append(f"The fit with '{trial.effect.title}' did not converge: {trial.fitted.message}.")
    if before.hidden:
        said.append(
            "There is misfit beyond the noise, but no more than the error of mesh and time step could leave. "
            "Finer cells or a shorter solver.dt_s in the rig would tell."
        )
    said += (
        data_quality_warnings(base.rig, problem.runs)
        + large_discretisation_errors(problem)
        + unresolved_quantities(problem)
    )
    for name, noise in problem.noise.items():
        if noise.source == FROM_DIFFERENCES:
            said.append(
                f"Nothing stands still long enough to see the noise of {name}; it was taken from neighbouring "
                "samples. If it is smooth, misfit is overrated: record a rest of 15 samples, or declare it in the rig."
            )
    start = start_of(base.centre, base.parameters)
    for p, scaled, first in zip(base.parameters, base.scaled, start, strict=True):
        low, high = p.scaled_bounds
        value, began = p.physical(scaled), p.physical(first)
        if min(scaled - low, high - scaled) < 1e-3 * p.prior_sd:
            said.append(
                f"The baseline ends at the bound of {p.name}, {value:.4g} {p.unit}; that itself needs explaining."
            )
        elif abs(scaled - first) > p.prior_sd:
            said.append(
                f"The baseline needs {p.name} = {value:.4g} {p.unit} where the rig says {began:.4g}; that itself "
                "needs explaining."
            )
    return tuple(said)
