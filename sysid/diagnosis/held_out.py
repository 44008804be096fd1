"""Recordings that the baseline is not fitted to: what it predicts of them, and what that says."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from sim_core.errors import ThinshellError
from sysid.diagnosis.beliefs import believed, open_parameters
from sysid.diagnosis.fits import fit_within
from sysid.diagnosis.reference_model import Reference, standing
from sysid.diagnosis.residual_analysis import Structure, structure
from sysid.discretisation.time_steps import predicted_with_steps
from sysid.model.nuisance_parameters import KINDS, nuisance_parameters
from sysid.model.parameters import fit_parameters, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.model.windows import not_from_rest
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.discretisation_basis import ErrorShape
from sysid.solve.optimum import Fitted
from sysid.solve.outliers import without_outliers
from sysid.solve.residuals import Problem

PARAMETERS_ALONE = (
    "What the baseline misses in recordings held out goes where it is fitted to them as well: the recordings given do "
    "not determine its parameters well enough to predict them."
)


def held_out_problem(
    engine: AnyEngine,
    fitted: Fitted,
    noise: dict[str, ChannelNoise],
    held_out: Sequence[Run],
    reference: Reference | None = None,
) -> tuple[Problem, tuple[str, ...]]:
    """The held-out recordings that the fitted rig can follow, without mistakes, beside the errors of their own."""
    kept: list[Run] = []
    shapes: list[list[ErrorShape]] = []
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
            shapes.append(model.shapes)
            added.update(model.engine.added)
        except ThinshellError as error:
            lost.append(f"{given.name} is left out, it could not be simulated: {error}")
    together = [
        replace(first, shapes=tuple(s[k].shapes[0] for s in shapes), sight=tuple(x for s in shapes for x in s[k].sight))
        for k, first in enumerate(shapes[0])
    ] if shapes else []  # fmt: skip
    return Problem(kept, noise, SpaceMappedPredictor(engine, added), together), tuple(lost)


def held_out_together(given: Problem, others: Problem, fitted: Fitted, engine: AnyEngine) -> Structure | None:
    """Structured misfit of the recordings held out (``others``) beside one baseline for all; None where misfit stays in
    any of them, and where there is no such fit. ``fitted``: the baseline of the recordings ``given``; ``engine``: of
    the rig's own model.

    What a baseline predicts of recordings that it was not fitted to is off by what is not known of its parameters, and
    by their own clocks. Misfit that goes where they are fitted as well, beside the others and within what is known of
    all, is that, and no missing physics.
    """
    labels = [[s.label for s in problem.error_shapes] for problem in (given, others)]
    if labels[0] != labels[1]:
        return None
    runs = [*given.runs, *others.runs]
    shapes = [
        replace(a, shapes=(*a.shapes, *b.shapes), sight=(*a.sight, *b.sight) if a.sight and b.sight else ())
        for a, b in zip(given.error_shapes, others.error_shapes, strict=True)
    ]
    added = {k: v for p in (given, others) for k, v in cast(SpaceMappedPredictor, p.engine).added.items()}
    problem = Problem(runs, given.noise, SpaceMappedPredictor(engine, added), shapes, prior=True)
    parameters = believed(fitted.centre, fit_parameters(fitted.centre, open_parameters(fitted.centre)))
    parameters += nuisance_parameters(fitted.centre, runs, parameters, KINDS)
    known = dict(zip((p.name for p in fitted.parameters), fitted.scaled, strict=True))
    start = [known.get(p.name, at) for p, at in zip(parameters, start_of(fitted.rig, parameters), strict=True)]
    try:
        found = fit_within(problem, DIAGNOSIS.held_out_evaluations, fitted.centre, parameters, np.array(start))
    except ThinshellError:
        return None
    whole = structure(problem, found)
    if whole.missing:
        return None
    names = {run.name for run in others.runs}
    return Structure(tuple(part for part in whole.parts if part.run in names))
