"""An engine whose predictions run in worker processes, one a core."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from types import TracebackType

import numpy as np

from sim_core.batch import worker_pool
from sim_core.rigs import Rig
from sim_core.simulate import NodePath
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.model.responses import Modulated, SizedEffects
from sysid.model.rollout_paths import RolloutPaths
from sysid.observations.observations import Run

_ENGINE: list[SerialPredictor] = []


def _start() -> None:
    """Each worker keeps its scenes."""
    _ENGINE.append(SerialPredictor())


def _predict(rig: Rig, run: Run, refine: int, dt: float | None, keep_path: bool, beside: NodePath | None) -> Prediction:
    return _ENGINE[0].predict(rig, run, refine, dt, keep_path=keep_path, beside=beside)


def _predict_with_derivatives(
    rig: Rig,
    run: Run,
    parameters: Sequence[FitParameter],
    scaled: np.ndarray,
    refine: int,
    dt: float | None,
    keep_path: bool,
    beside: NodePath | None,
) -> Prediction:
    return _ENGINE[0].predict_with_derivatives(
        rig, run, parameters, scaled, refine, dt, keep_path=keep_path, beside=beside
    )


def _predict_responses(
    rig: Rig,
    run: Run,
    parameters: Sequence[FitParameter],
    scaled: np.ndarray,
    candidates: Sequence[SizedEffects],
    modulated: Sequence[Modulated],
    keep_path: bool,
    beside: NodePath | None,
) -> Prediction:
    return _ENGINE[0].predict_responses(
        rig, run, parameters, scaled, candidates, modulated, keep_path=keep_path, beside=beside
    )


class ParallelPredictor:
    """As :class:`sysid.model.predictor.SerialPredictor`, in ``workers`` processes. Use as a context manager.

    ``on_done``: called in a thread of the pool after each prediction, made or failed.
    """

    def __init__(self, workers: int | None = None, on_done: Callable[[], None] | None = None) -> None:
        self._workers = workers or os.cpu_count() or 1
        self._on_done = on_done
        self._paths = RolloutPaths()

    def __enter__(self) -> ParallelPredictor:
        self._open = ExitStack()
        self._pool = self._open.enter_context(worker_pool(self._workers, _start))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.__exit__(kind, error, trace)

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        """Start a prediction without derivatives."""
        return self._begun(rig, run, refine, dt, _predict, rig, run, refine, dt)

    def submit_with_derivatives(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        refine: int = 1,
        dt: float | None = None,
    ) -> Future[Prediction]:
        """Start a prediction with derivatives."""
        at = (list(parameters), np.array(scaled))
        return self._begun(rig, run, refine, dt, _predict_with_derivatives, rig, run, *at, refine, dt)

    def submit_responses(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        candidates: Sequence[SizedEffects],
        modulated: Sequence[Modulated] = (),
    ) -> Future[Prediction]:
        """Start a prediction with the responses to effects of finite size, and to parameters that change."""
        at = (list(parameters), np.array(scaled))
        effects = (list(candidates), list(modulated))
        return self._begun(rig, run, 1, None, _predict_responses, rig, run, *at, *effects)

    def predict_all(
        self, rig: Rig, runs: Sequence[Run], parameters: Sequence[FitParameter], scaled: np.ndarray
    ) -> list[Prediction]:
        """Predictions with derivatives of several runs, side by side."""
        futures = [self.submit_with_derivatives(rig, run, parameters, scaled) for run in runs]
        return [future.result() for future in futures]

    def _begun(
        self, rig: Rig, run: Run, refine: int, dt: float | None, predict: Callable[..., Prediction], *given: object
    ) -> Future[Prediction]:
        """A prediction in a worker, beside the path of the first one like it."""

        def begin(keep_path: bool, beside: NodePath | None) -> Future[Prediction]:
            return self._told(self._pool.submit(predict, *given, keep_path, beside))

        return self._paths.start(rig, run, refine, dt, begin)

    def _told(self, future: Future[Prediction]) -> Future[Prediction]:
        """The same future, which tells when it is done."""
        on_done = self._on_done
        if on_done is not None:
            future.add_done_callback(lambda _: on_done())
        return future
