"""An engine whose readings are a formula, and fits of it: they take no time."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Any, cast

import numpy as np

from sim_core.errors import ConvergenceError
from sim_core.simulate import Trace
from sysid.fit import FitOptions, fit
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.predictor import Prediction
from sysid.observations.observations import Measured, Run

T = np.linspace(0.0, 1.0, 60)
TRUTH = 1.5e5


def column(young: float) -> np.ndarray:
    return np.log(young) * np.sin(6.0 * T)[:, None]


class Readings:
    """An engine that reads log(E) of the gel; ``broken`` runs fail, ``hidden`` channels are out of sight from their
    sample ``begins`` on."""

    def __init__(self, broken: str = "", hidden: str = "", begins: int = 0) -> None:
        self.broken, self.hidden, self.begins = broken, hidden, begins

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        future.set_result(self._predict(run, rig.bodies["gel"].material.E_pa, 0))
        return future

    def submit_with_derivatives(
        self, rig: Any, run: Run, parameters: Any, scaled: np.ndarray, refine: int = 1, dt: float | None = None
    ) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        future.set_result(self._predict(run, float(np.exp(scaled[0])), len(parameters)))
        return future

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        if any(run.name == self.broken for run in runs):
            raise ConvergenceError("The step does not converge.", "Shorten solver.dt_s.")
        young = float(np.exp(scaled[0])) if parameters else rig.bodies["gel"].material.E_pa
        return [self._predict(run, young, len(parameters)) for run in runs]

    def _predict(self, run: Run, young: float, p: int) -> Prediction:
        values = {m.channel: column(young) for m in run.measured}
        slopes = {c: np.repeat(np.sin(6.0 * T)[:, None, None], p, axis=2) for c in values}
        if self.hidden in values:
            values[self.hidden][self.begins :] = np.nan
        return Prediction(values, slopes, cast(Trace, None))


def run_of(name: str, *channels: str) -> Run:
    rng = np.random.default_rng(3)
    measured = tuple(
        Measured(
            c,
            "tracks" if c == "side" else "markers",
            T,
            column(TRUTH) + 0.01 * rng.standard_normal((len(T), 1)),
            ("u",),
        )
        for c in channels
    )
    return Run(name, name, (), {}, measured, 1.0)


def result_of(engine: Readings, rig: Any, runs: list[Run], held_out: list[Run]) -> fit.FitResult:
    options = FitOptions(nuisance=("none",), intervals="quadratic", robust=False)
    return fit.fit_runs(rig, runs, ["gel.E"], options, held_out=held_out, engine=cast(ParallelPredictor, engine))[0]
