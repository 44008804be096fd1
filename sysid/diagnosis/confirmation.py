"""An answer is measured against the reference model where it stands.

What the reference model adds to the readings was measured at the baseline, without the effects of the answer. An effect
that acts where the cells of the rig are too wide, adhesion at the rim of a contact say, changes it. Before an answer is
given, the reference is therefore simulated with its effects, and they are fitted on from there. An answer of several
effects is compared with its parts, which are fitted to the end as well (backward elimination).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import cast

import numpy as np

from sim_core.errors import ThinshellError
from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.candidates import Hypothesis
from sysid.diagnosis.fits import fit_within
from sysid.diagnosis.predictability import predicted_held_out
from sysid.diagnosis.reference_model import added_at
from sysid.diagnosis.refits import Trial, scored, without
from sysid.diagnosis.verdict import size_of
from sysid.model.parameters import rig_in
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.model.sparing_predictor import SparingPredictor
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted


def confirmed(base: Baseline, trial: Trial, failed: dict[str, str]) -> Trial | None:
    """The trial fitted to the end, with what the reference model adds where it stands, if there is one; None, and why
    in ``failed``, where that cannot be simulated."""
    if base.reference is None and trial.fitted.converged:
        return replace(trial, confirmed=True)
    return fitted_to_the_end(base, trial.hypotheses, trial.fitted, failed)


def parts_to_fit(whole: Trial, trials: Sequence[Trial]) -> list[Hypothesis]:
    """The effects of an answer of several without which the others have to be fitted to the end before the answer is
    given: not where they have been, nor where a fit that converged explains too little of the misfit."""
    if len(whole.hypotheses) < 2:
        return []
    known = {t.names: t for t in trials}
    return [one for one in whole.hypotheses if not _judged(known.get(whole.names - {one.effect.name}))]


def _judged(part: Trial | None) -> bool:
    """Whether a part of an answer is known well enough to be compared with it."""
    if part is None or part.confirmed:
        return part is not None
    return part.fitted.converged and size_of(part) < DIAGNOSIS.least_explained_share


def confirmed_without(
    base: Baseline, whole: Trial, left_out: Hypothesis, known: Trial | None, failed: dict[str, str]
) -> Trial | None:
    """An answer of several effects without one of them, fitted to the end, or as far as tells that it explains too
    little. It first comes to where it is going beside what the reference model adds to the baseline: without the
    effect, materials may be far from those of the answer, and what the reference model adds there is no matter of where
    it ends. ``known``: the part as it was fitted before, which is gone on from if it is better than from where the
    answer stands."""
    part = without(base, whole, left_out, failed)
    if known is not None and (part is None or known.fitted.chi2 < part.fitted.chi2):
        part = known
    return part if part is None or _judged(part) else confirmed(base, part, failed)


def fitted_to_the_end(
    base: Baseline, hypotheses: tuple[Hypothesis, ...], begun: Fitted, failed: dict[str, str]
) -> Trial | None:
    """A set of effects fitted on from where a model with them stands, whatever that was fitted beside: beside the
    errors of mesh and time step of the baseline, and what the reference model adds where it stands."""

    def engine(known: SpaceMappedPredictor, runs: Sequence[Run], at: np.ndarray) -> SpaceMappedPredictor:
        if base.reference is None:
            return known
        coarse = base.engine.coarse
        rigs = [rig_in(begun.centre, begun.parameters, at, run.name) for run in runs]
        jobs = [coarse.submit(rig, run) for rig, run in zip(rigs, runs, strict=True)]
        added = added_at(coarse, base.reference, rigs, runs, [job.result() for job in jobs])
        return SpaceMappedPredictor(coarse, added.readings)

    try:
        problem, check = copy(base.problem), copy(base.check)
        problem.engine = SparingPredictor(engine(base.engine, problem.runs, begun.scaled))
        fitted = fit_within(problem, DIAGNOSIS.confirmation_evaluations, begun.centre, begun.parameters, begun.scaled)
        there = None
        if check.runs:
            check.engine = engine(cast(SpaceMappedPredictor, check.engine), check.runs, fitted.scaled)
            there = predicted_held_out(check, base.there, fitted)
    except ThinshellError as error:
        failed[" and ".join(sorted(h.effect.name for h in hypotheses))] = (
            f"could not be simulated{'' if base.reference is None else ' with finer cells'}: {error}"
        )
        return None
    return replace(scored(base, hypotheses, fitted, there), confirmed=True)
