"""Whitened residuals of runs against a rig, and their least-squares minimum."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from sim_core.errors import ConvergenceError, ThinshellError
from sim_core.rigs import Rig
from sysid.fit.directions import Basis, Direction, Sizes, basis_of
from sysid.fit.engine import Engine, Prediction
from sysid.fit.noise import ChannelNoise, whiten
from sysid.fit.parameters import FitParameter, rig_at, start_of
from sysid.fit.pool import PooledEngine
from sysid.fit.runs import Measured, Run


@dataclass
class Fitted:
    """Outcome of one minimisation. ``scaled``: best values; ``residual`` and ``jacobian``: whitened,
    ``(n,)`` and ``(n, p)``, nuisance sizes eliminated; ``labels``: run, channel and times of the residuals;
    ``predictions``: by run; ``centre``: the rig to whose values priors pull; ``sizes``: most probable
    coefficients of the simulator's own error by run and channel (:mod:`sysid.fit.directions`)."""

    parameters: list[FitParameter]
    scaled: np.ndarray
    rig: Rig
    residual: np.ndarray
    jacobian: np.ndarray
    labels: list[tuple[int, str, np.ndarray]]
    predictions: list[Prediction]
    centre: Rig
    evaluations: int
    converged: bool
    message: str
    seconds: float
    sizes: dict[tuple[int, str], Sizes] = field(default_factory=dict)

    @property
    def interrupted(self) -> bool:
        """The search was stopped by Ctrl-C."""
        return self.message.startswith("interrupted")

    @property
    def chi2(self) -> float:
        return float(self.residual @ self.residual)

    @property
    def samples(self) -> int:
        """Number of measured values compared (the residual also has a row for each nuisance size and prior)."""
        pulls = sum(c.number for c in self.sizes.values())
        return len(self.residual) - pulls - sum(len(t) for run, _, t in self.labels if run < 0)

    @property
    def misfit(self) -> float:
        """Mean squared whitened residual: 1 for a model that is right."""
        return self.chi2 / max(self.samples, 1)

    @property
    def values(self) -> dict[str, float]:
        """Physical values by name."""
        return {p.name: p.physical(s) for p, s in zip(self.parameters, self.scaled, strict=True)}


class Problem:
    """Runs, their noise, and the known error shapes that are eliminated from the residuals.

    ``prior``: pull every parameter to the value of the rig with the width of its plausible range.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        noise: dict[str, ChannelNoise],
        engine: Engine | PooledEngine,
        directions: Sequence[Direction] = (),
        prior: bool = False,
    ) -> None:
        self.runs = list(runs)
        self.noise = noise
        self.engine = engine
        self.directions = list(directions)
        self.prior = prior
        self._bases: dict[tuple[int, str], tuple[Basis, Basis]] = {}

    def basis(self, index: int, measured: Measured) -> Basis:
        """The simulator's own error in one channel of run number ``index``."""
        return self._both_bases(index, measured)[0]

    def _both_bases(self, index: int, measured: Measured) -> tuple[Basis, Basis]:
        """The basis in measured units, and whitened."""
        key = (index, measured.channel)
        if key not in self._bases:
            basis = basis_of(self.directions, index, self.runs[index], measured)
            self._bases[key] = (basis, basis.whitened(self.noise[measured.channel]))
        return self._bases[key]

    def corrected(self, fitted: Fitted, index: int, measured: Measured) -> np.ndarray:
        """Prediction of a channel with the most probable own error added, measured units ``(n, m)``."""
        prediction = fitted.predictions[index].values[measured.channel]
        if not self.directions:
            return prediction
        error = self.basis(index, measured).error(fitted.scaled, fitted.sizes[(index, measured.channel)])
        return np.asarray(prediction + error)

    def assemble(
        self, predictions: Sequence[Prediction], p: int, scaled: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, list[tuple[int, str, np.ndarray]], dict[tuple[int, str], Sizes]]:
        """Whitened residual, jacobian, labels (run, channel, times of the samples), sizes of directions.

        The simulator's own error is eliminated channel by channel (:meth:`Basis.eliminate`).
        ``scaled``: where the predictions stand, for errors that change with the parameters.
        """
        assembled, labels = [], []
        sizes: dict[tuple[int, str], Sizes] = {}
        for i, (run, prediction) in enumerate(zip(self.runs, predictions, strict=True)):
            for m in run.measured:
                noise = self.noise[m.channel]
                # A point that is predicted out of sight says nothing; the size stays that of the data.
                unseen = np.isnan(prediction.values[m.channel])
                miss = np.where(unseen, 0.0 * m.values, m.values - prediction.values[m.channel])
                white = whiten(miss, noise)
                good = np.isfinite(white)
                vectors = [white]
                if p:
                    slopes = np.nan_to_num(-whiten(prediction.derivatives[m.channel], noise))
                    vectors += [slopes[:, :, k] for k in range(p)]
                stacked = np.stack(vectors, axis=2)
                times = np.broadcast_to(m.t[:, None], white.shape)[good]
                if self.directions:
                    basis = self._both_bases(i, m)[1]
                    if scaled is None:
                        stacked[:, :, 0] -= basis.expected
                    else:
                        stacked[:, :, 0] -= basis.mean_error(scaled)
                        stacked[:, :, 1 : 1 + len(basis.at)] -= basis.slopes
                    rows, sizes[(i, m.channel)], pulls = basis.eliminate(stacked, good)
                    times = np.concatenate([times, pulls])
                else:
                    rows = stacked[good]
                assembled.append(rows)
                labels.append((i, m.channel, times))
        rows = np.concatenate(assembled)
        return rows[:, 0], rows[:, 1:], labels, sizes

    def evaluate(self, rig: Rig, parameters: Sequence[FitParameter], scaled: np.ndarray) -> Fitted:
        """Residuals and derivatives at given values, without fitting."""
        started = time.monotonic()
        predictions = self.engine.predict_all(rig, self.runs, parameters, scaled)
        r, j, labels, sizes = self.assemble(predictions, len(parameters), scaled if len(parameters) else None)
        if self.prior and parameters:
            width = np.array([p.prior_sd for p in parameters])
            r = np.concatenate([r, (scaled - start_of(rig, parameters)) / width])
            j = np.vstack([j, np.diag(1.0 / width)])
            labels = [*labels, (-1, "prior", np.zeros(len(width)))]
        return Fitted(
            list(parameters), scaled, rig_at(rig, parameters, scaled), r, j, labels, predictions, rig, 1, True,
            "evaluated", time.monotonic() - started, sizes,
        )  # fmt: skip

    def fit(
        self,
        rig: Rig,
        parameters: Sequence[FitParameter],
        start: np.ndarray | None = None,
        max_evaluations: int = 30,
        tolerance: float = 0.5,
        on_evaluation: Callable[[int, float], None] | None = None,
    ) -> Fitted:
        """Minimise the whitened residuals (trust region, bounds, analytic derivatives).

        ``tolerance``: improvement of chi-square, in units of the misfit, below which the search ends.
        Ctrl-C keeps the best so far.
        """
        started = time.monotonic()
        start = start_of(rig, parameters) if start is None else np.asarray(start, dtype=float)
        best: list[Fitted] = []
        last: list[Fitted] = []
        count = 0
        samples = sum(int(np.isfinite(m.values).sum()) for run in self.runs for m in run.measured)

        def look(scaled: np.ndarray) -> Fitted | None:
            """The problem at these values; None where they cannot be simulated."""
            nonlocal count
            if last and np.array_equal(last[0].scaled, scaled):
                return last[0]
            count += 1
            try:
                here = self.evaluate(rig, parameters, scaled.copy())
            except ThinshellError:
                if not best:
                    raise
                return None
            last[:] = [here]
            if not best or here.chi2 < best[0].chi2:
                best[:] = [here]
            if on_evaluation is not None:
                on_evaluation(count, best[0].chi2)
            return here

        def residual(scaled: np.ndarray) -> np.ndarray:
            here = look(scaled)
            # Infinitely bad: the search takes a shorter step from where it stands.
            return np.full(len(best[0].residual), np.inf) if here is None else here.residual

        def jacobian(scaled: np.ndarray) -> np.ndarray:
            here = look(scaled)
            if here is None:
                raise ConvergenceError("The search asked for derivatives where the rig cannot be simulated.")
            return here.jacobian

        message, converged = "", True
        if parameters:
            low, high = np.array([p.scaled_bounds for p in parameters]).T
            inside = np.clip(start, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
            try:
                result = least_squares(
                    residual,
                    inside,
                    jac=jacobian,
                    bounds=(low, high),
                    x_scale=np.array([min(p.prior_sd, 1.0) for p in parameters]),
                    ftol=tolerance / max(samples, 1),
                    xtol=1e-7,
                    gtol=1e-12,
                    max_nfev=max_evaluations,
                )
                message, converged = result.message, result.status > 0
            except KeyboardInterrupt:
                if not best:
                    raise
                message, converged = "interrupted; the best values so far are kept", False
        else:
            look(start)
            message = "nothing to fit"
        found = best[0]
        found.evaluations, found.converged, found.message = count, converged, message
        found.seconds = time.monotonic() - started
        return found
