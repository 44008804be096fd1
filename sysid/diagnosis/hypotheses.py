"""Effects as explanations: a cheap look at all of them from finite amplitudes, then real refits.

An effect with a threshold has no derivative at zero, so each is switched on at typical amplitudes and
the change of all readings is simulated (a secant). From there one linear least-squares step over its own
parameters and the baseline's predicts how well it could fit; the best are refitted in full.

Evidence after Laplace: log p = -chi2/2 - log det(J^T J)/2 - sum log(prior widths), with the priors as
rows of J; the data's part of chi2 is divided by the misfit of the best model where that exceeds noise.
"""

from __future__ import annotations

import itertools
from concurrent.futures import Future
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import lsq_linear

from sim_core.effects import Effect, all_effects, split_key
from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import FitParameter, fit_parameters, start_of
from sysid.model.predictor import Prediction
from sysid.solve.covariance import overdispersion
from sysid.solve.gauss_newton import IN_SIGHT
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

LARGEST_STEP = 1.0
"""Longest step of the linear prediction in a logarithm, or in prior widths of a linear parameter."""


REFIT_TOLERANCE = 5.0
"""Improvement of chi-square, in units of the misfit, below which a refit ends."""

OUT_OF_SIGHT = "it moves readings out of sight"
"""Why an effect is no answer that explains readings by hiding them."""


@dataclass(frozen=True)
class Start:
    """An effect at starting values. ``gain``: fall of chi-square, priors weighed as the baseline's search did,
    that a refit from here should bring; ``scaled``: predicted values of baseline and effect parameters."""

    effect: Effect
    rig: Rig
    own: list[FitParameter]
    gain: float
    scaled: np.ndarray


def with_effect(rig: Rig, effect: Effect, values: dict[str, float]) -> Rig:
    """The rig with one more effect."""
    return rig.model_copy(update={"effects": {**rig.effects, effect.name: values}})


def starting_values(effect: Effect, rig: Rig) -> list[dict[str, float]]:
    """All combinations of typical values of an effect on a rig."""
    out = []
    for variant in effect.variants(rig):
        for combination in itertools.product(*variant.values()):
            out.append(dict(zip(variant, combination, strict=True)))
    return out


def screen(engine: ParallelPredictor, problem: Problem, base: Fitted) -> tuple[list[Start], dict[str, str]]:
    """Predict, for every effect and start, how well it would fit, best first; and what failed, by effects of which no
    start could be simulated with as much in sight as the baseline has."""
    pending: list[tuple[Effect, Rig, list[FitParameter], np.ndarray, list[Future[Prediction]]]] = []
    named = {split_key(key)[0] for key in base.rig.effects}
    for effect in all_effects().values():
        if effect.name in named:
            continue
        for values in starting_values(effect, base.rig):
            rig = with_effect(base.rig, effect, values)
            own = fit_parameters(rig, [f"effects.{effect.name}.{k}" for k in values])
            scaled = start_of(rig, own)
            jobs = [engine.submit_with_derivatives(rig, run, own, scaled) for run in problem.runs]
            pending.append((effect, rig, own, scaled, jobs))
    starts = []
    failed: dict[str, str] = {}
    for effect, rig, own, scaled, jobs in pending:
        try:
            predictions = [job.result() for job in jobs]
            if problem.seen(predictions) < IN_SIGHT * base.samples:
                failed[effect.name] = OUT_OF_SIGHT
                continue
            starts.append(_predict(problem, base, effect, rig, own, scaled, predictions))
        except ThinshellError as error:
            failed[effect.name] = f"could not be simulated: {error}"
    known = {start.effect.name for start in starts}
    return sorted(starts, key=lambda s: -s.gain), {name: why for name, why in failed.items() if name not in known}


def _predict(
    problem: Problem,
    base: Fitted,
    effect: Effect,
    rig: Rig,
    own: list[FitParameter],
    scaled: np.ndarray,
    predictions: list[Prediction],
) -> Start:
    """One bounded linear least-squares step from the secant."""
    shared = len(base.parameters)
    # The discretisation error stays that of the baseline, with its changes by the baseline's parameters.
    beside = [replace(p, derivatives={c: _after(shared, d) for c, d in p.derivatives.items()}) for p in predictions]
    names = [p.name for p in (*base.parameters, *own)]
    there = problem.assemble(beside, names, np.concatenate([base.scaled, scaled]))
    r, j = there.residual, there.jacobian[:, shared:]
    # The baseline was sought with priors weighed up by what chance makes of its misfit; so is this step.
    pull = np.sqrt(overdispersion(base))
    width = np.array([p.prior_sd for p in (*base.parameters, *own)]) / pull
    rows = len(r)
    prior_residual = base.residual[rows:] * pull if problem.prior else np.zeros(shared)
    # Effect parameters are pulled to their vanishing value where they have a finite one.
    rest = np.array([_rest(effect, p, s) for p, s in zip(own, scaled, strict=True)])
    matrix = np.vstack(
        [
            np.hstack([base.jacobian[:rows], j]),
            np.diag(1.0 / width),
        ]
    )
    target = -np.concatenate([r, prior_residual, (scaled - rest) / width[shared:]])
    low, high = np.array([p.scaled_bounds for p in (*base.parameters, *own)]).T
    at = np.concatenate([base.scaled, scaled])
    reach = LARGEST_STEP * np.array([1.0 if p.log else 4.0 * p.prior_sd for p in (*base.parameters, *own)])
    low, high = np.maximum(low - at, -reach), np.minimum(high - at, reach)
    upper = np.linalg.qr(np.column_stack([matrix, target]))[1]
    small, goal = upper[:, :-1], upper[:, -1]
    step = lsq_linear(small, goal, bounds=(np.minimum(low, -1e-12), np.maximum(high, 1e-12)))
    misfit = goal - small @ step.x
    before = base.residual[:rows] @ base.residual[:rows] + prior_residual @ prior_residual
    return Start(effect, rig, own, float(before - misfit @ misfit), at + step.x)


def _after(count: int, derivatives: np.ndarray) -> np.ndarray:
    """Derivatives ``(n, m, p)`` after those by ``count`` other parameters, 0."""
    return np.concatenate([np.zeros((*derivatives.shape[:2], count)), derivatives], axis=2)


def _rest(effect: Effect, parameter: FitParameter, scaled: float) -> float:
    spec = next(p for p in effect.parameters if parameter.name.endswith("." + p.name))
    if spec.vanishing is None or not np.isfinite(spec.vanishing) or (spec.log and spec.vanishing <= 0.0):
        return scaled
    return parameter.scaled(spec.vanishing)


def refit(problem: Problem, base: Fitted, start: Start, evaluations: int) -> Fitted:
    """Fit baseline and effect parameters together from a screened start."""
    parameters = [*base.parameters, *start.own]
    centred = _centred(start, base)
    return problem.fit(centred, parameters, start=start.scaled, max_evaluations=evaluations, tolerance=REFIT_TOLERANCE)


def _centred(start: Start, base: Fitted) -> Rig:
    """The rig whose values the priors pull to: the baseline's prior centre, the effect at rest."""
    centre = with_effect(base.centre, start.effect, dict(start.rig.effects[start.effect.name]))
    values = dict(centre.effects[start.effect.name])
    for p, scaled in zip(start.own, start_of(start.rig, start.own), strict=True):
        rest = _rest(start.effect, p, float(scaled))
        values[p.name.rsplit(".", 1)[1]] = p.physical(rest)
    return centre.model_copy(update={"effects": {**centre.effects, start.effect.name: values}})


def log_evidence(fitted: Fitted, temper: float) -> float:
    """Laplace evidence of a fit with prior rows, up to a constant common to all models.

    ``temper`` divides the weight of the data, not that of the priors, so that a parameter which the data do
    not touch changes nothing. Searches end where their own weights led them, so the least misfit with these
    weights is taken from where one linear step leads.
    """
    count = len(fitted.parameters)
    data = slice(0, len(fitted.residual) - count)
    j, prior = fitted.jacobian[data], fitted.jacobian[len(fitted.residual) - count :]
    pull = fitted.residual[len(fitted.residual) - count :]
    information = j.T @ j / temper + prior.T @ prior
    slope = j.T @ fitted.residual[data] / temper + prior.T @ pull
    widths = float(sum(np.log(p.prior_sd) for p in fitted.parameters))
    here = (fitted.chi2 - float(pull @ pull)) / temper + float(pull @ pull)
    least = here - float(slope @ np.linalg.solve(information, slope)) if count else here
    return -0.5 * least - 0.5 * float(np.linalg.slogdet(information)[1]) - widths
