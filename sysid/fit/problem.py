"""Whitened residuals of runs against a rig, and their least-squares minimum."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from sim_core.errors import ThinshellError
from sim_core.rigs import Rig
from sysid.fit.engine import Engine, Prediction
from sysid.fit.noise import ChannelNoise, whiten
from sysid.fit.parameters import FitParameter, rig_at, start_of
from sysid.fit.pool import PooledEngine
from sysid.fit.runs import Run

RIGHT_SD = 0.5
"""Standard deviation of the coefficient of a discretisation direction about its expected value one."""

COST_OF_FAILURE = 1e3
"""Whitened residual charged to every sample of a run that could not be simulated."""


@dataclass(frozen=True)
class Direction:
    """A known shape of error for each run and channel (measured units), with an uncertain size.

    ``shapes[run index][channel]``: ``(n, m)``. Size: normal with ``mean`` and ``sd``, one number a run
    and channel.
    """

    label: str
    shapes: tuple[dict[str, np.ndarray], ...]
    mean: float = 1.0
    sd: float = RIGHT_SD


@dataclass
class Fitted:
    """Outcome of one minimisation. ``scaled``: best values; ``residual`` and ``jacobian``: whitened,
    ``(n,)`` and ``(n, p)``, nuisance sizes eliminated; ``blocks``: sample ranges of the run and channel
    of each residual; ``predictions``: by run."""

    parameters: list[FitParameter]
    scaled: np.ndarray
    rig: Rig
    residual: np.ndarray
    jacobian: np.ndarray
    labels: list[tuple[int, str, np.ndarray]]
    predictions: list[Prediction]
    evaluations: int
    converged: bool
    message: str
    seconds: float
    sizes: dict[tuple[str, int, str], float] = field(default_factory=dict)

    @property
    def interrupted(self) -> bool:
        """The search was stopped by Ctrl-C."""
        return self.message.startswith("interrupted")

    @property
    def chi2(self) -> float:
        return float(self.residual @ self.residual)

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

    def assemble(
        self, predictions: Sequence[Prediction], p: int
    ) -> tuple[np.ndarray, np.ndarray, list[tuple[int, str, np.ndarray]], dict[tuple[str, int, str], float]]:
        """Whitened residual, jacobian, labels (run, channel, times of the samples), sizes of directions.

        Directions are eliminated channel by channel: r <- r - D c with the most probable sizes c, whose
        prior pull (c - mean)/sd joins as further residuals, so that derivatives stay exact.
        """
        residuals, jacobians, labels = [], [], []
        sizes: dict[tuple[str, int, str], float] = {}
        for i, (run, prediction) in enumerate(zip(self.runs, predictions, strict=True)):
            for m in run.measured:
                noise = self.noise[m.channel]
                # A point that is predicted out of sight says nothing; the size stays that of the data.
                unseen = np.isnan(prediction.values[m.channel])
                miss = np.where(unseen, 0.0 * m.values, m.values - prediction.values[m.channel])
                white = whiten(miss, noise)
                good = np.isfinite(white)
                r = white[good]
                rows = [r]
                if p:
                    j = -whiten(prediction.derivatives[m.channel], noise)[good]
                    columns = [np.nan_to_num(j)]
                times = np.broadcast_to(m.t[:, None], white.shape)[good]
                shapes = [
                    np.nan_to_num(whiten(d.shapes[i][m.channel], noise)[good])
                    for d in self.directions
                    if m.channel in d.shapes[i]
                ]
                if shapes and any(np.any(s) for s in shapes):
                    basis = np.column_stack(shapes)
                    mean = np.array([d.mean for d in self.directions])
                    sd = np.array([d.sd for d in self.directions])
                    root = basis * sd
                    gram = np.linalg.inv(np.eye(len(sd)) + root.T @ root)
                    r0 = r - basis @ mean
                    c = gram @ (root.T @ r0)
                    rows = [r0 - root @ c, -c]
                    for d, size in zip(self.directions, mean + sd * c, strict=True):
                        sizes[(d.label, i, m.channel)] = float(size)
                    if p:
                        back = gram @ (root.T @ columns[0])
                        columns = [columns[0] - root @ back, -back]
                    times = np.concatenate([times, np.full(len(c), m.t[-1])])
                residuals += rows
                if p:
                    jacobians += columns
                labels.append((i, m.channel, times))
        jacobian = np.vstack(jacobians) if p else np.zeros((sum(len(r) for r in residuals), 0))
        return np.concatenate(residuals), jacobian, labels, sizes

    def evaluate(self, rig: Rig, parameters: Sequence[FitParameter], scaled: np.ndarray) -> Fitted:
        """Residuals and derivatives at given values, without fitting."""
        started = time.monotonic()
        predictions = self.engine.predict_all(rig, self.runs, parameters, scaled)
        r, j, labels, sizes = self.assemble(predictions, len(parameters))
        if self.prior and parameters:
            width = np.array([p.prior_sd for p in parameters])
            r = np.concatenate([r, (scaled - start_of(rig, parameters)) / width])
            j = np.vstack([j, np.diag(1.0 / width)])
            labels = [*labels, (-1, "prior", np.zeros(len(width)))]
        return Fitted(
            list(parameters), scaled, rig_at(rig, parameters, scaled), r, j, labels, predictions, 1, True,
            "evaluated", time.monotonic() - started, sizes,
        )  # fmt: skip

    def fit(
        self,
        rig: Rig,
        parameters: Sequence[FitParameter],
        start: np.ndarray | None = None,
        max_evaluations: int = 30,
        tolerance: float = 1e-3,
        on_evaluation: Callable[[int, float], None] | None = None,
    ) -> Fitted:
        """Minimise the whitened residuals (trust region, bounds, analytic derivatives).

        ``tolerance``: relative change of the cost that ends the search. Ctrl-C keeps the best so far.
        """
        started = time.monotonic()
        start = start_of(rig, parameters) if start is None else np.asarray(start, dtype=float)
        best: list[Fitted] = []
        last: list[Fitted] = []
        count = 0
        size = 0

        def evaluate(scaled: np.ndarray) -> np.ndarray:
            nonlocal count, size
            if last and np.array_equal(last[0].scaled, scaled):
                return last[0].residual
            count += 1
            try:
                here = self.evaluate(rig, parameters, scaled.copy())
            except ThinshellError:
                if not best:
                    raise
                return np.full(size, COST_OF_FAILURE)
            size = len(here.residual)
            last[:] = [here]
            if not best or here.chi2 < best[0].chi2:
                best[:] = [here]
            if on_evaluation is not None:
                on_evaluation(count, best[0].chi2)
            return here.residual

        def jacobian(scaled: np.ndarray) -> np.ndarray:
            evaluate(scaled)
            return last[0].jacobian

        message, converged = "", True
        if parameters:
            low, high = np.array([p.scaled_bounds for p in parameters]).T
            inside = np.clip(start, low + 1e-9 * (high - low), high - 1e-9 * (high - low))
            try:
                result = least_squares(
                    evaluate,
                    inside,
                    jac=jacobian,
                    bounds=(low, high),
                    x_scale=np.array([min(p.prior_sd, 1.0) for p in parameters]),
                    ftol=tolerance,
                    xtol=1e-5,
                    gtol=1e-12,
                    max_nfev=max_evaluations,
                )
                message, converged = result.message, result.status > 0
            except KeyboardInterrupt:
                if not best:
                    raise
                message, converged = "interrupted; the best values so far are kept", False
        else:
            evaluate(start)
            message = "nothing to fit"
        found = best[0]
        found.evaluations, found.converged, found.message = count, converged, message
        found.seconds = time.monotonic() - started
        return found
