"""Of all values that fit as well, those nearest to where the fit began.

Along what the recordings do not determine a search ends anywhere: noise leads it off by orders of magnitude. From there
the least of

    chi2(theta) / kappa + w sum_k ((theta_k - theta0_k) / width_k)^2

is gone to, over the parameters k that were asked for and of which nothing was known, with their plausible widths
(Tikhonov's regularisation towards the start theta0) and kappa, what chance makes of chi-square
(:func:`sysid.fit.uncertainty.chance`). It is taken where the first term has risen by no more than :data:`RISE`, so that
what the recordings do determine stays where it is within a fraction of its standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sysid.fit.fitted import Fitted
from sysid.fit.problem import Problem
from sysid.fit.uncertainty import chance, names_undetermined, uncertainty

RISE = 4.0
"""Of chi-square, in units of what chance makes of it: a search that ends so much higher has ended as well."""

WEIGHTS = (1.0, 0.1, 0.01)
"""Of the distance from the start, tried in turns."""

MOST_STEPS = 5
"""Steps on the way back, for each weight."""

ENOUGH = 0.05
"""Fall of the sum, promised by the next step, below which the way back ends."""

SHARES = (1.0, 0.5, 0.25)
"""Shares of a step that are tried in turns."""


def nearest(
    problem: Problem, fitted: Fitted, start: np.ndarray, on_evaluation: Callable[[Fitted], None] | None = None
) -> Fitted:
    """The outcome of a search from scaled values ``start`` ``(p,)``, or the one as good that is nearer to them where
    the recordings leave parameters undetermined of which nothing was known."""
    free = {p.name for p in fitted.parameters if not p.nuisance and p.known_sd is None}
    if not fitted.converged or fitted.cut_short or not free & names_undetermined(uncertainty(fitted).findings):
        return fitted
    for weight in WEIGHTS:
        back = _Back(problem, fitted, start, weight, on_evaluation)
        there = back.gone()
        if there is not fitted and back.risen(there) <= RISE:
            return replace(
                there, evaluations=fitted.evaluations + back.evaluations, message=fitted.message, began=fitted.began
            )
    return fitted


class _Back:
    """The way back with one weight of the distance."""

    def __init__(
        self,
        problem: Problem,
        fitted: Fitted,
        start: np.ndarray,
        weight: float,
        on_evaluation: Callable[[Fitted], None] | None,
    ) -> None:
        self._problem, self._fitted, self._start = problem, fitted, start
        self._on_evaluation = on_evaluation
        self._noise = np.sqrt(chance(fitted))
        parameters = fitted.parameters
        self._low, self._high = np.array([p.scaled_bounds for p in parameters]).T
        free = np.array([not p.nuisance and p.known_sd is None for p in parameters])
        self._pull = np.diag(np.where(free, np.sqrt(weight) / np.array([p.prior_sd for p in parameters]), 0.0))
        self.evaluations = 0

    def gone(self) -> Fitted:
        """Where it ends."""
        best = self._fitted
        for _ in range(MOST_STEPS):
            residual, jacobian = self._rows(best)
            step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
            left = residual + jacobian @ step
            if residual @ residual - left @ left < ENOUGH:
                break
            further = self._along(best, step)
            if further is None:
                break
            best = further
        return best

    def _along(self, best: Fitted, step: np.ndarray) -> Fitted | None:
        """The first point on a step that is better; None if there is none."""
        for share in SHARES:
            at = np.clip(best.scaled + share * step, self._low, self._high)
            self.evaluations += 1
            try:
                there = self._problem.evaluate(self._fitted.centre, self._fitted.parameters, at)
            except ThinshellError:
                continue
            if self._on_evaluation is not None:
                self._on_evaluation(there)
            if there.samples == best.samples and self._sum(there) < self._sum(best):
                return there
        return None

    def risen(self, there: Fitted) -> float:
        """By how much chi-square has risen, in units of what chance makes of it, and priors with it."""
        before, now = (self._weighed(f, f.residual) for f in (self._fitted, there))
        return float(now @ now - before @ before)

    def _sum(self, fitted: Fitted) -> float:
        residual = self._rows(fitted)[0]
        return float(residual @ residual)

    def _rows(self, fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
        """Residual and jacobian of the sum."""
        away = self._pull @ (fitted.scaled - self._start)
        residual, jacobian = self._weighed(fitted, fitted.residual), self._weighed(fitted, fitted.jacobian)
        return np.concatenate([residual, away]), np.vstack([jacobian, self._pull])

    def _weighed(self, fitted: Fitted, rows: np.ndarray) -> np.ndarray:
        """Rows of the residual or the jacobian, those of readings in units of what chance makes of them."""
        out: np.ndarray = rows.copy()
        out[: len(out) - fitted.pulls] /= self._noise
        return out
