"""A fit and the errors of mesh and time step where it stands, found in turns.

These errors depend on the parameters, and the best parameters on what is taken for error. Where a strip rings, half a
percent of its stiffness shifts both by more than noise: an error that was measured there is the wrong column, and an
effect that is not there fills the gap. So errors are measured, the fit goes on from where it stands, and they are
measured again until it stays within a standard deviation of where they were, or turns no longer bring it closer, as
where a sensor's clock hangs on an impact that every step of the solver cuts in two another way. What a reference model
adds to the readings is measured with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import cast

import numpy as np

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.diagnosis.fits import fit_within
from sysid.diagnosis.reference_model import Reference, standing
from sysid.model.parameters import FitParameter, rig_in
from sysid.model.space_mapping import SpaceMappedPredictor
from sysid.model.sparing_predictor import SparingPredictor
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.settings.discretisation import DISCRETISATION
from sysid.solve.covariance import uncertainty
from sysid.solve.interruption import end_unconverged
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


def fitted_on(problem: Problem, begun: Fitted) -> Fitted:
    """A model fitted on from where it stands."""
    most = DIAGNOSIS.baseline_evaluations_on
    return fitted_from(problem, begun.centre, begun.parameters, begun.scaled, most)


def fitted_from(
    problem: Problem, rig: Rig, parameters: Sequence[FitParameter], start: np.ndarray, evaluations: int
) -> Fitted:
    """Where a search from ``start``, in the fitted scale ``(p,)``, ends, with derivatives that are carried over."""
    sparing = copy(problem)
    sparing.engine = SparingPredictor(problem.engine)
    return fit_within(sparing, evaluations, rig, parameters, start)


def settled(
    problem: Problem,
    fitted: Fitted,
    reference: Reference | None,
    at: np.ndarray | None = None,
    rounds: int = DISCRETISATION.error_rounds,
) -> tuple[Problem, Fitted, np.ndarray | None]:
    """The problem with the errors where its fit stands, the fit, and the scaled values ``(p,)`` where these errors were
    measured. ``at``: where those of the problem were, None where that is not known; ``rounds``: of measurements, at
    most. Where they cannot be measured the fit has not converged, and its message says so."""
    before = np.inf
    for _ in range(rounds):
        if at is not None:
            moved = float(np.max(np.abs(fitted.scaled - at) / uncertainty(fitted).sd, initial=0.0))
            if moved <= DISCRETISATION.remeasured_sd or moved >= before:
                break
            before = moved
        try:
            problem, at = _with_errors_of(problem, fitted, reference), fitted.scaled
            fitted = fitted_on(problem, fitted)
        except ThinshellError as error:
            end_unconverged(fitted, error, "it stands where its discretisation error is not known")
            break
    return problem, fitted, at


def _with_errors_of(problem: Problem, fitted: Fitted, reference: Reference | None) -> Problem:
    """The problem with the errors of mesh and time step, and with what the reference adds, where a model stands."""
    coarse = cast(SpaceMappedPredictor, problem.engine).coarse
    rigs = [rig_in(fitted.centre, fitted.parameters, fitted.scaled, run.name) for run in problem.runs]
    jobs = [coarse.submit(rig, run) for rig, run in zip(rigs, problem.runs, strict=True)]
    model = standing(coarse, reference, rigs, problem.runs, [job.result() for job in jobs])
    assert problem.named is not None
    found = problem.with_named(problem.named.with_refined(model.refined))
    found.engine = model.engine
    return found
