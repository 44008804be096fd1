"""The search for the parameters that fit best: trust region, bounds, analytic derivatives, in stages.

A stage ends when chi-square improves by less than its overdispersion, kappa = :func:`overdispersion`, and no parameter
is asked to go on by more than a small share of its standard deviation: kappa is a mean over all of them, and one of
which the misfit says nothing is known better than that. While the model is wrong its misfit has structure, kappa is
large, and chi-square counts the same evidence kappa times; the prior, where there is one, is then weighed up as much,
so that parameters do not run to where no material is to cover what the model lacks (a tempered posterior, Gruenwald &
van Ommen 2017). As the fit improves kappa falls, and the next stage goes on with what it is then, down to 1.

Where the calibration of sensors alone, a camera that was knocked say, makes up most of what is missed at the start, it
is searched for first: next to thousands of pixels' standard deviations that are off in every picture, each material is
good that takes some of them, and the search would end far from where it began.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sim_core.errors import ThinshellError
from sysid.model.parameters import FitParameter
from sysid.settings.solve import SOLVE
from sysid.solve.covariance import overdispersion, uncertainty
from sysid.solve.nonsmooth_trust_region import USED_UP, End, Point, minimise
from sysid.solve.optimum import Fitted

HALTED = "it came on slowly with an error of mesh and time step that was measured elsewhere"


class Search:
    """One minimisation. ``evaluate``: the problem at scaled values ``(p,)``; ``parameters``: at least one;
    ``on_evaluation``: called after each evaluation, also one that failed, what is best so far. ``halt``: whether to end
    the search before its time, given the best chi-square after each evaluation; ``calibrated``: which parameters are
    the calibration of sensors ``(p,)``, which changes readings and no motion."""

    def __init__(
        self,
        evaluate: Callable[[np.ndarray], Fitted],
        parameters: Sequence[FitParameter],
        on_evaluation: Callable[[Fitted], None] | None,
        halt: Callable[[Sequence[float]], bool] | None = None,
        calibrated: np.ndarray | None = None,
    ) -> None:
        self._evaluate = evaluate
        self._parameters = parameters
        self._on_evaluation = on_evaluation
        self._best: Fitted | None = None
        self._last: Fitted | None = None
        self._halt = halt
        self._sensors = np.zeros(len(parameters), dtype=bool) if calibrated is None else calibrated
        self._course: list[float] = []
        self._evaluations = 0
        self._seen = 0
        self._last_seen: np.ndarray | None = None
        self._weight = 1.0

    @property
    def best(self) -> Fitted:
        if self._best is None:
            raise ValueError("nothing has been evaluated")
        return self._best

    def run(self, start: np.ndarray, max_evaluations: int, tolerance: float) -> Fitted:
        """Search from scaled values ``(p,)``. Raises ``ThinshellError`` if they cannot be simulated; Ctrl-C
        keeps the best so far."""
        low, high = np.array([p.scaled_bounds for p in self._parameters]).T
        message, converged, radius, halted, interrupted = "", True, 1.0, False, False

        def go_on() -> bool:
            return self._evaluations < max_evaluations and not self._halted()

        try:
            self._look(np.clip(start, low, high))
            if self._uncalibrated():
                self._calibrate(low, high, tolerance, max_evaluations)
            while True:
                self._weight = overdispersion(self.best)
                end = self._stage(low, high, tolerance, go_on, radius)
                message, converged, radius = end.message, end.converged, max(end.radius, SOLVE.resumed_radius)
                halted = self._halted()
                if halted:
                    message, converged = HALTED, False
                    break
                if overdispersion(self.best) > SOLVE.sharper_tolerance_share * self._weight:
                    break
                if self._evaluations >= max_evaluations:
                    message, converged = USED_UP, False
                    break
        except KeyboardInterrupt:
            if self._best is None:
                raise
            interrupted = True
        found = self.best
        found.evaluations, found.converged, found.message = self._evaluations, converged, message
        found.began, found.elsewhere = self._course[0], halted
        if interrupted:
            found.interrupt()
        return found

    def _stage(
        self, low: np.ndarray, high: np.ndarray, tolerance: float, go_on: Callable[[], bool], radius: float
    ) -> End:
        """Search on from the best point within bounds ``(p,)``, data and prior as they are weighed now."""
        begin, scale = self.best.scaled, np.array([p.unit_step for p in self._parameters])

        def point(z: np.ndarray) -> Point | None:
            """The problem where z is, whose unit is the scale; z begins at 0."""
            here = self._look(np.clip(begin + scale * z, low, high))
            if here is None:
                return None
            return Point(z, self._weigh(here, self._whole(here)), self._weigh(here, here.jacobian * scale))

        first = point(np.zeros(len(scale)))
        assert first is not None
        return minimise(
            point,
            first,
            ((low - begin) / scale, (high - begin) / scale),
            tolerance=tolerance * self._weight,
            go_on=go_on,
            short=lambda step: self._short(scale * step),
            radius=radius,
        )

    def _uncalibrated(self) -> bool:
        """Whether derivatives promise that the calibration of sensors alone makes up for most of what is missed, and
        for more than all else."""
        if not self._sensors.any():
            return False
        residual = self._whole(self.best)
        taken = []
        for columns in (self._sensors, ~self._sensors):
            basis = np.linalg.qr(self.best.jacobian[:, columns])[0]
            taken.append(float(np.sum((basis.T @ residual) ** 2)))
        return taken[0] > max(taken[1], SOLVE.calibration_first_share * float(residual @ residual))

    def _calibrate(self, low: np.ndarray, high: np.ndarray, tolerance: float, max_evaluations: int) -> None:
        """Search for the calibration of sensors alone. Bodies move as before, so the search of all begins there."""
        begin = self.best.scaled
        sensors = [p for p, mine in zip(self._parameters, self._sensors, strict=True) if mine]
        alone = replace(self.best, parameters=sensors, jacobian=self.best.jacobian[:, self._sensors])
        self._weight = overdispersion(alone)
        most = self._evaluations + min(SOLVE.calibration_evaluations, max_evaluations // 2)
        self._stage(
            np.where(self._sensors, low, begin),
            np.where(self._sensors, high, begin),
            tolerance,
            lambda: self._evaluations < most,
            SOLVE.calibration_radius,
        )
        self._course = [self.best.chi2]

    def _short(self, step: np.ndarray) -> bool:
        """Whether a step from the best point ``(p,)`` moves what was asked for by little of what it is known by."""
        asked = np.array([not p.nuisance for p in self._parameters])
        return bool(np.all(np.abs(step)[asked] <= SOLVE.short_step_sd * uncertainty(self.best).sd[asked]))

    def _halted(self) -> bool:
        return self._halt is not None and self._halt(self._course)

    def _look(self, scaled: np.ndarray) -> Fitted | None:
        """The problem at these values; None where they cannot be simulated, or hide what is in sight at the best."""
        for known in (self._last, self._best):
            if known is not None and np.array_equal(known.scaled, scaled):
                return known
        try:
            here = self._evaluate(scaled.copy())
        except ThinshellError:
            if self._best is None:
                raise
            self._tell(1)
            return None
        self._seen = max(self._seen, here.samples)
        if self._best is not None and here.samples < SOLVE.in_sight_share * self._seen:
            self._tell(here.evaluations)
            return None
        self._last = here
        if self._best is None or self._weighted(here) < self._weighted(self._best):
            self._last_seen = self._whole(here)
            self._best = here
        self._tell(here.evaluations)
        return here

    def _tell(self, evaluations: int) -> None:
        """A look has been taken, which has cost an evaluation or none."""
        self._evaluations += evaluations
        self._course.append(self.best.chi2)
        if evaluations and self._on_evaluation is not None:
            self._on_evaluation(self.best)

    def _weigh(self, fitted: Fitted, rows: np.ndarray) -> np.ndarray:
        """Rows of the residual or the jacobian with the prior's weighed up."""
        if not fitted.has_prior or self._weight == 1.0:
            return rows
        weighed: np.ndarray = rows.copy()
        weighed[-fitted.pulls :] *= np.sqrt(self._weight)
        return weighed

    def _whole(self, fitted: Fitted) -> np.ndarray:
        """The residual ``(n,)`` with what is out of sight as it was missed at the best point that had it in sight, so
        that nothing is gained by hiding a reading. What none had in sight counts as the rest does on average: nothing
        is lost by seeing it, unless it is missed by more."""
        if fitted.sight is None or fitted.sight.all():
            return fitted.residual
        unknown = self._last_seen
        if unknown is None:
            unknown = np.full(len(fitted.residual), np.sqrt(fitted.misfit))
        return np.where(fitted.sight, fitted.residual, unknown)

    def _weighted(self, fitted: Fitted) -> float:
        residual = self._weigh(fitted, self._whole(fitted))
        return float(residual @ residual)
