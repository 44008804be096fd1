"""An answer is measured against the reference model where it stands.

What the reference model adds to the readings was measured at the baseline, without the effects of the answer. An effect
that acts where the cells of the rig are too wide, adhesion at the rim of a contact say, changes it. Before an answer is
given, the reference is therefore simulated with its effects, and they are fitted on from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sysid.diagnosis.baseline import Baseline
from sysid.diagnosis.reference_model import Reference, added_at
from sysid.diagnosis.refits import Trial, scored
from sysid.model.parameters import rig_in
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.model.sparing_predictor import SparingPredictor
from sysid.observations.observations import Run

EVALUATIONS = 3
"""Evaluations allowed to an answer beside what the reference adds where it stands."""


def confirmed(base: Baseline, trial: Trial, failed: dict[str, str]) -> Trial | None:
    """The trial with what the reference model adds where it stands; None, and why in ``failed``, where that cannot be
    simulated. A baseline without a reference needs none."""
    if base.reference is None:
        return trial
    begun, coarse = trial.fitted, base.engine.coarse

    def engine(reference: Reference, runs: Sequence[Run], at: np.ndarray) -> SpaceMappedPredictor:
        rigs = [rig_in(begun.centre, begun.parameters, at, run.name) for run in runs]
        jobs = [coarse.submit(rig, run) for rig, run in zip(rigs, runs, strict=True)]
        added = added_at(coarse, reference, rigs, runs, [job.result() for job in jobs])
        return SpaceMappedPredictor(coarse, added.readings)

    try:
        problem, check = copy(base.problem), copy(base.check)
        problem.engine = SparingPredictor(engine(base.reference, problem.runs, begun.scaled))
        fitted = problem.fit(begun.centre, begun.parameters, begun.scaled, max_evaluations=EVALUATIONS, tolerance=5.0)
        if fitted.interrupted:
            raise KeyboardInterrupt
        there = None
        if check.runs:
            check.engine = engine(base.reference, check.runs, fitted.scaled)
            there = check.evaluate(fitted.rig, [], np.zeros(0))
    except ThinshellError as error:
        failed[" and ".join(sorted(trial.names))] = f"could not be simulated with finer cells: {error}"
        return None
    return replace(scored(base, trial.hypotheses, fitted, there), confirmed=True)
