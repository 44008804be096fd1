"""Of all values that fit as well, those nearest to where the fit began.

Along what the recordings do not determine a search ends anywhere: noise leads it off by orders of magnitude. From there
the least of

    chi2(theta) / kappa + w || V^T D (theta - theta0) ||^2

is gone to. D scales the parameters that were asked for and of which nothing was known by their plausible widths, and is
0 elsewhere; V are the directions, in these widths, along which the recordings and priors leave more than
``SOLVE.undetermined_share`` of a width: others are not drawn to the start theta0 (Tikhonov's
regularisation of a truncated basis; Hansen 1998). kappa is the overdispersion of chi-square
(:func:`sysid.solve.covariance.overdispersion`). The end is taken where the first term has risen by no more than
``FIT.chi2_rise`` and nothing that is determined has moved by more than a fifth of its standard deviation.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from sim_core.errors import ThinshellError
from sysid.settings.fit import FIT
from sysid.settings.solve import SOLVE
from sysid.solve.covariance import names_undetermined, overdispersion, uncertainty
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem


def minimum_norm_solution(
    problem: Problem,
    fitted: Fitted,
    start: np.ndarray,
    most: int,
    on_evaluation: Callable[[Fitted], None] | None = None,
) -> Fitted:
    """The outcome of a search from scaled values ``start`` ``(p,)``, or the one as good that is nearer to them where
    the recordings leave parameters undetermined of which nothing was known. ``most``: evaluations that may be made."""
    free = {p.name for p in fitted.parameters if not p.nuisance and p.known_sd is None}
    known = uncertainty(fitted)
    undetermined = names_undetermined(known.findings)
    if not fitted.converged or fitted.cut_short or not free & undetermined:
        return fitted
    stays = np.array([not p.nuisance and p.name not in undetermined for p in fitted.parameters])
    back = _Back(problem, fitted, start, most, on_evaluation)
    for weight in FIT.distance_weights:
        there = back.gone(weight)
        moved = np.abs(there.scaled - fitted.scaled)[stays]
        if (
            there is not fitted
            and back.risen(there) <= FIT.chi2_rise
            and np.all(moved <= SOLVE.short_step_sd * known.sd[stays])
        ):
            made = fitted.evaluations + back.evaluations
            return replace(there, evaluations=made, message=fitted.message, began=fitted.began)
    return fitted


class _Back:
    """The way back."""

    def __init__(
        self,
        problem: Problem,
        fitted: Fitted,
        start: np.ndarray,
        most: int,
        on_evaluation: Callable[[Fitted], None] | None,
    ) -> None:
        self._problem, self._fitted, self._start = problem, fitted, start
        self._most, self._on_evaluation = most, on_evaluation
        self._noise = np.sqrt(overdispersion(fitted))
        parameters = fitted.parameters
        self._low, self._high = np.array([p.scaled_bounds for p in parameters]).T
        self._width = np.array([p.prior_sd for p in parameters])
        self._free = np.array([not p.nuisance and p.known_sd is None for p in parameters])
        self.evaluations = 0

    def gone(self, weight: float) -> Fitted:
        """Where it ends with one weight of the distance."""
        best = self._fitted
        for _ in range(FIT.way_back_steps):
            pull = np.sqrt(weight) * self._open(best)
            residual, jacobian = self._rows(best, pull)
            step = self._step(best, residual, jacobian)
            left = residual + jacobian @ step
            if residual @ residual - left @ left < FIT.way_back_fall:
                break
            further = self._along(best, step, pull)
            if further is None:
                break
            best = further
        return best

    def _step(self, best: Fitted, residual: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
        """The step ``(p,)`` of least squares within bounds; what neither a row nor the distance tells stays."""
        upper: np.ndarray = np.linalg.qr(np.column_stack([jacobian, residual]))[1]
        matrix = np.vstack([upper[:, :-1], np.diag(1.0 / (SOLVE.widest_sd * self._width)) * 1e-3])
        target = -np.concatenate([upper[:, -1], np.zeros(len(best.scaled))])
        low, high = np.minimum(self._low - best.scaled, -1e-12), np.maximum(self._high - best.scaled, 1e-12)
        return np.asarray(lsq_linear(matrix, target, bounds=(low, high)).x)

    def _open(self, fitted: Fitted) -> np.ndarray:
        """V^T D ``(v, p)`` at a fit."""
        p = len(self._width)
        rows = np.vstack([self._weighed(fitted, fitted.jacobian) * self._width, np.zeros((p, p))])
        _, singular, directions = np.linalg.svd(rows, full_matrices=False)
        return directions[singular < 1.0 / SOLVE.undetermined_share] * np.where(self._free, 1.0 / self._width, 0.0)

    def _along(self, best: Fitted, step: np.ndarray, pull: np.ndarray) -> Fitted | None:
        """The first point on a step that is better; None if there is none."""
        for share in FIT.step_shares:
            if self.evaluations >= self._most:
                return None
            at = np.clip(best.scaled + share * step, self._low, self._high)
            self.evaluations += 1
            there = self._evaluated(at)
            known = self._sum(best, pull)
            further = there is not None and there.samples == best.samples and self._sum(there, pull) < known
            now = there if there is not None and further else best
            if self._on_evaluation is not None:
                self._on_evaluation(now)
            if now is not best:
                return now
        return None

    def _evaluated(self, at: np.ndarray) -> Fitted | None:
        """The problem at scaled values ``(p,)``; None where they cannot be simulated."""
        try:
            return self._problem.evaluate(self._fitted.centre, self._fitted.parameters, at)
        except ThinshellError:
            return None

    def risen(self, there: Fitted) -> float:
        """By how much chi-square has risen, in units of what chance makes of it, and priors with it."""
        before, now = (self._weighed(f, f.residual) for f in (self._fitted, there))
        return float(now @ now - before @ before)

    def _sum(self, fitted: Fitted, pull: np.ndarray) -> float:
        residual = self._rows(fitted, pull)[0]
        return float(residual @ residual)

    def _rows(self, fitted: Fitted, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual and jacobian of the sum."""
        residual, jacobian = self._weighed(fitted, fitted.residual), self._weighed(fitted, fitted.jacobian)
        return np.concatenate([residual, pull @ (fitted.scaled - self._start)]), np.vstack([jacobian, pull])

    def _weighed(self, fitted: Fitted, rows: np.ndarray) -> np.ndarray:
        """Rows of the residual or the jacobian, those of readings in units of what chance makes of them."""
        out: np.ndarray = rows.copy()
        out[: len(out) - fitted.pulls] /= self._noise
        return out
