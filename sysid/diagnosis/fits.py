"""One fit of a diagnosis, from a start and within so many evaluations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_core.rigs import Rig
from sysid.model.parameters import FitParameter
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


def fit_within(
    problem: Problem,
    evaluations: int,
    rig: Rig,
    parameters: Sequence[FitParameter],
    start: np.ndarray,
    tolerance: float = DIAGNOSIS.fit_tolerance,
) -> Fitted:
    """Where a search from ``start``, in the fitted scale ``(p,)``, ends. ``tolerance``: fall of chi-square, in units of
    the misfit, below which it does. Raises ``KeyboardInterrupt`` where Ctrl-C ended it: half a fit is no answer."""
    fitted = problem.fit(rig, list(parameters), start, max_evaluations=evaluations, tolerance=tolerance)
    if fitted.interrupted:
        raise KeyboardInterrupt
    return fitted
