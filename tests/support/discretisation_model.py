"""A model with a known answer and a known error, and an engine and rigs that stand for it."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Any, cast

import numpy as np

from sim_core.simulate import Trace
from sysid.discretisation.refinement import fit_with_discretisation_error
from sysid.model.parallel_predictor import ParallelPredictor
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction
from sysid.noise.channel_noise import ChannelNoise
from sysid.observations.observations import Measured, Run

T = np.linspace(0.0, 1.0, 120)
SIGMA = 0.01
NOISE = {"gauge": ChannelNoise(np.array([SIGMA, SIGMA]), 0.0, "test")}
PARAMETERS = [FitParameter(n, "-", False, -50.0, 50.0, 5.0, "") for n in ("a", "b")]
TRUTH = np.array([1.3, -0.4])


def coarse(x: np.ndarray) -> np.ndarray:
    """Readings of the model as it is solved."""
    return np.column_stack([x[0] * T + x[1] * np.sin(3 * T), x[0] * np.cos(2 * T) - x[1] * T**2])


def own(x: np.ndarray) -> np.ndarray:
    """Its error, which changes with the parameters nearly as the readings do."""
    return 0.7 * coarse(x - np.array([0.8, 0.1])) + 0.05 * np.column_stack([np.sin(9 * T), np.cos(7 * T)])


def run_of(values: np.ndarray) -> Run:
    measured = Measured("gauge", "markers", T, values, ("u", "v"))
    return Run("run", "", (), {}, (measured,), 1.0)


class Linear:
    """An engine whose rigs are the parameters themselves."""

    def __init__(self, error: Any = own) -> None:
        self.error = error
        self.refined = 0

    def submit(self, rig: Any, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        future: Future[Prediction] = Future()
        values = self._refined(rig.x, refine)
        self.refined += refine > 1
        future.set_result(Prediction({"gauge": values}, {}, cast(Trace, None)))
        return future

    def _refined(self, x: np.ndarray, refine: int) -> np.ndarray:
        return np.asarray(coarse(x) + (0.75 * self.error(x) if refine > 1 else 0.0))

    def submit_with_derivatives(
        self, rig: Any, run: Run, parameters: Any, scaled: np.ndarray, refine: int = 1, dt: float | None = None
    ) -> Future[Prediction]:
        self.refined += refine > 1
        ends = [[self._refined(scaled + s * e, refine) for s in (1e-4, -1e-4)] for e in np.eye(2)]
        slopes = np.stack([(ahead - behind) / 2e-4 for ahead, behind in ends], axis=-1)
        future: Future[Prediction] = Future()
        future.set_result(Prediction({"gauge": self._refined(scaled, refine)}, {"gauge": slopes}, cast(Trace, None)))
        return future

    def predict_all(self, rig: Any, runs: Any, parameters: Any, scaled: np.ndarray) -> list[Prediction]:
        x = scaled if len(parameters) else rig.x
        slopes = np.stack([coarse(e) for e in np.eye(2)], axis=-1)
        return [Prediction({"gauge": coarse(x)}, {"gauge": slopes}, cast(Trace, None)) for _ in runs]


class Vector:
    """Stands for a rig: its parameters, and the step of its solver."""

    class Solver:
        dt_s = 0.01
        order = 1

    solver = Solver()

    def __init__(self, x: np.ndarray) -> None:
        self.x = np.asarray(x, dtype=float)


def measured(rng: np.random.Generator, share: float = 0.5) -> np.ndarray:
    return coarse(TRUTH) + share * own(TRUTH) + SIGMA * rng.standard_normal((len(T), 2))


def fit(engine: Linear, run: Run, parameters: Sequence[FitParameter] = PARAMETERS, **settings: Any) -> Any:
    return fit_with_discretisation_error(
        cast(ParallelPredictor, engine), [run], NOISE, cast(Any, Vector(np.zeros(2))), parameters, **settings
    )
