"""Recordings that the baseline is not fitted to: what it predicts of them, and how well that is known.

A prediction is as uncertain as the parameters that it is made with: their posterior, with nuisance parameters of the
recordings at their priors, is a named error of these, along derivatives. To which side a strip snaps is no matter of
derivatives, and hangs on less than recordings can tell: what a few draws of the parameters change is another one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sysid.diagnosis.reference_model import Reference, Standing, standing
from sysid.discretisation.approximations import refinement_errors
from sysid.discretisation.time_steps import predicted_with_steps
from sysid.model.nuisance_parameters import KINDS, nuisance_parameters
from sysid.model.parameters import rig_in, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.model.windows import not_from_rest
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.covariance import uncertainty
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.named_errors import NamedError, NamedErrors
from sysid.solve.optimum import Fitted
from sysid.solve.outliers import without_outliers
from sysid.solve.residuals import Problem


def held_out_problem(
    engine: AnyEngine,
    fitted: Fitted,
    noise: dict[str, ChannelNoise],
    held_out: Sequence[Run],
    reference: Reference | None = None,
) -> tuple[Problem, tuple[str, ...]]:
    """The held-out recordings that the fitted rig can follow, without mistakes, with the errors of their own."""
    kept: list[Run] = []
    found: list[Standing] = []
    lost: list[str] = []
    added: dict[str, Mapping[str, np.ndarray]] = {}
    for given in held_out:
        moving = not_from_rest(fitted.rig, given)
        if moving:
            lost.append(
                f"{given.name} is left out, since it cannot be predicted: it does not begin at rest. {moving[0]}"
            )
            continue
        try:
            run, own = predicted_with_steps(engine, [fitted.rig], [given], noise)
            model = standing(engine, reference, [fitted.rig], run, own)
            kept += without_outliers(run, model.plain, noise)[0]
            found.append(model)
            added.update(model.engine.added)
        except ThinshellError as error:
            lost.append(f"{given.name} is left out, it could not be simulated: {error}")
    shapes = _of_all([model.refined for model in found])
    named = refinement_errors(shapes, kept)
    return Problem(kept, noise, SpaceMappedPredictor(engine, added), named=named), tuple(lost)


def _of_all(shapes: Sequence[Sequence[ErrorShape]]) -> list[ErrorShape]:
    """Error shapes of several recordings from those of each."""
    return [
        replace(first, shapes=tuple(s[k].shapes[0] for s in shapes), sight=tuple(x for s in shapes for x in s[k].sight))
        for k, first in enumerate(shapes[0] if shapes else ())
    ]


def as_predicted(check: Problem, fitted: Fitted) -> Problem:
    """The problem of recordings held out, given what a fit leaves open of their prediction."""
    if not check.runs or check.named is None or not fitted.parameters:
        return check
    shared = [k for k, p in enumerate(fitted.parameters) if not p.bag]
    asked = [fitted.parameters[k] for k in shared]
    own = [p for p in nuisance_parameters(fitted.rig, check.runs, asked, KINDS) if p.bag]
    parameters = [*asked, *own]
    at = np.concatenate([fitted.scaled[shared], start_of(fitted.rig, own)])
    known = uncertainty(fitted)
    covariance = np.zeros((len(parameters), len(parameters)))
    n = len(shared)
    covariance[:n, :n] = (known.sd[:, None] * known.correlation * known.sd)[np.ix_(shared, shared)]
    covariance[np.arange(n, len(at)), np.arange(n, len(at))] = [p.prior_sd**2 for p in own]
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    limits = np.array([p.scaled_bounds for p in parameters]).T
    rng = np.random.default_rng(0)
    draws = [np.clip(at + root @ z, *limits) for z in rng.standard_normal((DIAGNOSIS.drawn_predictions, len(at)))]
    jobs = []
    for scaled in draws:
        try:
            rigs = [rig_in(fitted.rig, parameters, scaled, run.name) for run in check.runs]
            jobs.append([check.engine.submit(rig, run) for rig, run in zip(rigs, check.runs, strict=True)])
        except ThinshellError:  # Effects of the rig that act on nothing there, as where friction is zero.
            continue
    here = check.engine.predict_all(fitted.rig, check.runs, parameters, at)
    shapes = []
    for k, (run, p) in enumerate(zip(check.runs, here, strict=True)):
        found = {m.channel: [np.nan_to_num(p.derivatives[m.channel]) @ root] for m in run.measured}
        for row in jobs:
            try:
                other = row[k].result()
            except ThinshellError:
                continue
            for m in run.measured:
                found[m.channel].append(np.nan_to_num(other.values[m.channel] - p.values[m.channel])[..., None])
        shapes.append({c: np.concatenate(parts, axis=-1) for c, parts in found.items()})
    count = max(s.shape[-1] for run in shapes for s in run.values())
    named = check.named
    columns = (*named.columns, *(NamedError("prediction", f"direction {k + 1}", 0.0, 1.0) for k in range(count)))
    whole = []
    for mine, more in zip(named.shapes, shapes, strict=True):
        wide = {c: np.pad(s, ((0, 0), (0, 0), (0, count - s.shape[-1]))) for c, s in more.items()}
        whole.append({c: np.concatenate([s, wide[c]], axis=-1) for c, s in mine.items()})
    return check.with_named(NamedErrors(columns, tuple(whole), named.refined, named.instant))
