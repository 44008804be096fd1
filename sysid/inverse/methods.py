"""Searches for one parameter of a rig by a recording, each counted by its rollouts.

``fit`` is that of ``thinshell fit``, with its nuisance parameters, its noise and its intervals. The two others are
those of ThinShellLab (Wang et al., ICLR 2024), on the mean square of what a model misses over the noise that the rig
declares: gradient descent with 50 steps of a rate that falls by 0.95 from one to the next, none longer than a twelfth,
and CMA-ES with five generations of ten. Both search in the scale that fits have; CMA-ES with an idle second number,
as there, since the library has no search in one dimension.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim_core.errors import ConvergenceError, ThinshellError
from sim_core.optimise.evolution import strategy_from
from sim_core.rigs import Rig, with_parameters
from sysid.fit.fit import fit_runs
from sysid.fit.options import FitOptions
from sysid.inverse.task import InverseTask
from sysid.model.parameters import FitParameter, fit_parameters, rig_at, start_of
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.noise.estimate import as_declared
from sysid.observations.observations import Run

STEPS = 50
"""Steps of gradient descent."""

DECAY = 0.95
"""Fall of its rate from one step to the next."""

LONGEST = 0.08
"""Longest step, in the logarithm: 100 of 1,200, to which ThinShellLab cuts its stiffness."""

GENERATIONS, POPULATION = 5, 10
"""Of CMA-ES."""

UNSEEN = 1e3
"""Standard deviations by which a reading that is not simulated counts as missed."""

WIDTH = 0.3
"""Standard deviation of its first generation, in the logarithm."""


@dataclass
class Found:
    """``value`` in the unit of the parameter, its 95 % interval where the method tells one, and what it took."""

    value: float
    interval: tuple[float, float] | None
    rollouts: int
    with_derivatives: int


class Counted:
    """A source of predictions that counts them."""

    def __init__(self, engine: AnyEngine) -> None:
        self._engine = engine
        self.plain = self.derived = 0

    def submit(self, *given: Any, **named: Any) -> Future[Prediction]:
        """As that of the source."""
        self.plain += 1
        return self._engine.submit(*given, **named)

    def submit_with_derivatives(self, *given: Any, **named: Any) -> Future[Prediction]:
        """As that of the source."""
        self.derived += 1
        return self._engine.submit_with_derivatives(*given, **named)

    def predict_all(self, rig: Rig, runs: Sequence[Run], *given: Any) -> list[Prediction]:
        """As that of the source."""
        self.derived += len(runs)
        return self._engine.predict_all(rig, runs, *given)


@dataclass
class _Misfit:
    """Mean square of what a rig misses of a run over the declared noise, at scaled values of one parameter."""

    engine: Counted
    rig: Rig
    run: Run
    parameters: list[FitParameter]

    def of(self, prediction: Prediction) -> tuple[float, float]:
        """Value and derivative, zero without derivatives. A reading that a simulation does not give, as of a marker out
        of sight, is missed by :data:`UNSEEN`."""
        total, slope, count = 0.0, 0.0, 0
        for m in self.run.measured:
            sigma = as_declared(self.rig, m).sigma
            miss = (prediction.values[m.channel] - m.values) / sigma
            asked, seen = np.isfinite(m.values), np.isfinite(miss)
            total += float(np.sum(miss[seen] ** 2)) + UNSEEN**2 * int((asked & ~seen).sum())
            count += int(asked.sum())
            if prediction.derivatives:
                by = prediction.derivatives[m.channel][..., 0] / sigma
                slope += 2.0 * float(np.sum((miss * by)[seen & np.isfinite(by)]))
        return total / max(count, 1), slope / max(count, 1)


def fit(engine: Counted, rig: Rig, run: Run, task: InverseTask, seed: int) -> Found:
    """The fit that users run."""
    result, _ = fit_runs(rig, [run], [task.seeks], FitOptions(seed=seed), engine=engine)
    estimate = result.estimates[0]
    return Found(estimate.value, estimate.ci95, engine.plain + engine.derived, engine.derived)


def gradient(engine: Counted, rig: Rig, run: Run, task: InverseTask, seed: int) -> Found:
    """Gradient descent, begun with the longest step; it draws nothing, and ends where a rollout fails."""
    del seed
    parameters = fit_parameters(rig, [task.seeks])
    misfit, at = _Misfit(engine, rig, run, parameters), start_of(rig, parameters)
    rate, best = 0.0, (np.inf, at)
    for step in range(STEPS):
        job = engine.submit_with_derivatives(rig_at(rig, parameters, at), run, parameters, at)
        try:
            here, slope = misfit.of(job.result())
        except ThinshellError:
            break
        best = min(best, (here, at.copy()), key=lambda pair: pair[0])
        if slope == 0.0:
            break
        rate = rate or LONGEST / abs(slope)
        at = np.clip(at - np.clip(DECAY**step * rate * slope, -LONGEST, LONGEST), *parameters[0].scaled_bounds)
    return Found(parameters[0].physical(_found(best[0], best[1][0])), None, engine.derived, engine.derived)


def evolution(engine: Counted, rig: Rig, run: Run, task: InverseTask, seed: int) -> Found:
    """CMA-ES; rollouts that fail count as worst."""
    parameters, rng = fit_parameters(rig, [task.seeks]), np.random.default_rng(seed)
    misfit, start = _Misfit(engine, rig, run, parameters), start_of(rig, parameters)
    low, high = parameters[0].scaled_bounds
    best = (np.inf, float(start[0]))
    with strategy_from(np.array([start[0], 0.0]), WIDTH, rng, {"popsize": POPULATION}) as strategy:
        for _ in range(GENERATIONS):
            asked = strategy.ask()
            points = [np.array([np.clip(x[0], low, high)]) for x in asked]
            jobs = [engine.submit(rig_at(rig, parameters, at), run) for at in points]
            values = [_or_worst(misfit, job) for job in jobs]
            strategy.tell(asked, values)
            best = min(best, *((v, float(at[0])) for v, at in zip(values, points, strict=True)))
    return Found(parameters[0].physical(_found(*best)), None, engine.plain, 0)


def _found(misfit: float, at: float) -> float:
    """Where the least misfit is, if any simulation ended."""
    if not np.isfinite(misfit):
        raise ConvergenceError("No simulation of the search ended.", "Begin nearer to what is sought.")
    return float(at)


def _or_worst(misfit: _Misfit, job: Future[Prediction]) -> float:
    try:
        return misfit.of(job.result())[0]
    except ThinshellError:
        return np.inf


METHODS: dict[str, Callable[[Counted, Rig, Run, InverseTask, int], Found]] = {
    "fit": fit,
    "gradient": gradient,
    "cma": evolution,
}


def begun_at(rig: Rig, name: str, factor: float) -> Rig:
    """The rig with a parameter off by a factor."""
    (parameter,) = fit_parameters(rig, [name])
    return with_parameters(rig, {parameter.target: factor * parameter.physical(float(start_of(rig, [parameter])[0]))})
