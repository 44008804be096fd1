"""Where recordings contradict what was known of a parameter before.

The fit lies between both. A linear step within bounds from there, without what was known of parameter k, leads to the
value x_k that the recordings ask for under all other priors, which weigh as much as in the search
(:mod:`sysid.solve.gauss_newton`). If recordings and prior are right, the difference of x_k from the prior's mean has
the variance s_k^2 + t_k^2, with the standard deviation s_k of x_k (:mod:`sysid.solve.covariance`, by what the step
leaves) and t_k of what was known (a check of the prior against the data: Box 1980; Evans & Moshonov 2006). A value so
far off that the rig is not linear on the way there may go unnoticed: it leaves a misfit, which is reported.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from sysid.settings.solve import SOLVE
from sysid.settings.uncertainty import UNCERTAINTY
from sysid.solve.covariance import overdispersion, uncertainty
from sysid.solve.optimum import Fitted


def prior_data_conflicts(fitted: Fitted) -> dict[str, str]:
    """A sentence for each parameter that was asked for of which that is so, by its name."""
    found = {}
    first = len(fitted.residual) - fitted.pulls
    for k, p in enumerate(fitted.parameters):
        if p.nuisance or p.known_sd is None:
            continue
        row = first + int(np.flatnonzero(fitted.jacobian[first:, k])[0])
        known = float(fitted.scaled[k] - p.known_sd * fitted.residual[row])
        step, alone = _without(fitted, k, row)
        away = float(fitted.scaled[k] + step[k]) - known
        count = abs(away) / np.hypot(uncertainty(alone).sd[k], p.known_sd)
        if count > UNCERTAINTY.conflict_sd:
            mean = p.physical(known)
            before = f"{mean:g} +- {p.known_sd * (mean if p.log else 1.0):g} {p.unit}".rstrip()
            found[p.name] = (
                f"The recordings contradict what was known of {p.name} before, {before}: without it they ask for a "
                f"{'larger' if away > 0.0 else 'smaller'} value, {count:.2g} standard deviations away. The fit lies "
                "between the two: correct what was known, or look for what the rig leaves out."
            )
    return found


def _without(fitted: Fitted, k: int, row: int) -> tuple[np.ndarray, Fitted]:
    """The step ``(p,)`` to the least squares without one ``row`` of the prior, that of parameter ``k``, and the outcome
    there. Others that end at a bound stay there."""
    kept = np.arange(len(fitted.residual)) != row
    residual, jacobian = fitted.residual[kept], fitted.jacobian[kept]
    weight = np.ones(len(residual))
    weight[len(weight) - fitted.pulls + 1 :] = np.sqrt(overdispersion(fitted))
    low, high = (bound - fitted.scaled for bound in np.array([p.scaled_bounds for p in fitted.parameters]).T)
    low, high = np.minimum(low, -1e-12), np.maximum(high, 1e-12)
    low[k], high[k] = -np.inf, np.inf
    prior = np.array([p.prior_sd for p in fitted.parameters])
    upper: np.ndarray = np.linalg.qr(np.column_stack([jacobian, residual]) * weight[:, None])[1]
    ridge = np.diag(1.0 / (SOLVE.widest_sd * prior))  # what nothing tells stays where it is
    matrix = np.vstack([upper[:, :-1], ridge])
    end = lsq_linear(matrix, -np.concatenate([upper[:, -1], np.zeros(len(prior))]), bounds=(low, high))
    moved: np.ndarray = jacobian.copy()
    moved[: len(moved) - fitted.pulls + 1, end.active_mask != 0] = 0.0
    run, channel, times = fitted.labels[-1]
    there = replace(
        fitted,
        residual=residual + jacobian @ end.x,
        jacobian=moved,
        labels=[*fitted.labels[:-1], (run, channel, times[1:])],
        sight=None if fitted.sight is None else fitted.sight[kept],
        still=None if fitted.still is None else fitted.still[kept],
    )
    return end.x, there
