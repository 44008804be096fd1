"""An engine whose predictions run on threads, one a core."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from types import TracebackType

import numpy as np

from sim_core.rigs import Rig
from sim_core.simulate import NodePath
from sim_core.threads import worker_threads
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction, SerialPredictor
from sysid.model.responses import Modulated, SizedEffects
from sysid.model.rollout_paths import RolloutPaths
from sysid.observations.observations import Run
from sysid.progress.rollout_costs import Kind, OnStep, RolloutCosts

Predict = Callable[[SerialPredictor, bool, NodePath | None, OnStep | None], Prediction]
"""Makes a prediction with an engine; whether it keeps its path, the path that it starts from, and what is called after
each step."""


class ParallelPredictor:
    """As :class:`sysid.model.predictor.SerialPredictor`, on ``workers`` threads, each with scenes of its own. Use as a
    context manager; when it is left, what runs is asked to end.

    ``on_done``: called on such a thread after each prediction, made or failed; ``costs``: measures each rollout.
    """

    def __init__(
        self,
        workers: int | None = None,
        on_done: Callable[[], None] | None = None,
        costs: RolloutCosts | None = None,
    ) -> None:
        self._workers = workers or os.cpu_count() or 1
        self._on_done = on_done
        self._costs = costs
        self._paths = RolloutPaths()
        self._own = threading.local()
        self._unwanted = threading.Event()

    def end(self) -> None:
        """Ask all predictions to end, with ``CancelledError``, those that are begun afterwards as well."""
        self._unwanted.set()

    def __enter__(self) -> ParallelPredictor:
        self._open = ExitStack()
        self._pool = self._open.enter_context(worker_threads(self._workers, self._unwanted))
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.__exit__(kind, error, trace)

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        """Start a prediction without derivatives."""

        def predict(
            engine: SerialPredictor, keep_path: bool, warm_start: NodePath | None, on_step: OnStep | None
        ) -> Prediction:
            return engine.predict(rig, run, refine, dt, keep_path=keep_path, warm_start=warm_start, on_step=on_step)

        return self._begun(rig, run, refine, dt, predict, _kind(rig, refine, dt))

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
        own, at = list(parameters), np.array(scaled)

        def predict(
            engine: SerialPredictor, keep_path: bool, warm_start: NodePath | None, on_step: OnStep | None
        ) -> Prediction:
            return engine.predict_with_derivatives(
                rig, run, own, at, refine, dt, keep_path=keep_path, warm_start=warm_start, on_step=on_step
            )

        return self._begun(rig, run, refine, dt, predict, _kind(rig, refine, dt, derivatives=True))

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
        own, at, sized, changing = list(parameters), np.array(scaled), list(candidates), list(modulated)

        def predict(
            engine: SerialPredictor, keep_path: bool, warm_start: NodePath | None, on_step: OnStep | None
        ) -> Prediction:
            return engine.predict_responses(
                rig, run, own, at, sized, changing, keep_path=keep_path, warm_start=warm_start, on_step=on_step
            )

        return self._begun(rig, run, 1, None, predict, Kind(responses=True))

    def predict_all(
        self, rig: Rig, runs: Sequence[Run], parameters: Sequence[FitParameter], scaled: np.ndarray
    ) -> list[Prediction]:
        """Predictions with derivatives of several runs, side by side."""
        futures = [self.submit_with_derivatives(rig, run, parameters, scaled) for run in runs]
        return [future.result() for future in futures]

    def _begun(
        self, rig: Rig, run: Run, refine: int, dt: float | None, predict: Predict, kind: Kind
    ) -> Future[Prediction]:
        """A prediction on a thread, warm-started from the path of the first one like it."""

        def make(keep_path: bool, warm_start: NodePath | None) -> Prediction:
            if not hasattr(self._own, "engine"):
                self._own.engine = SerialPredictor()
            if self._costs is None:
                return predict(self._own.engine, keep_path, warm_start, None)
            with self._costs.rollout(kind) as on_step:
                return predict(self._own.engine, keep_path, warm_start, on_step)

        def begin(keep_path: bool, warm_start: NodePath | None) -> Future[Prediction]:
            return self._reporting(self._pool.submit(make, keep_path, warm_start))

        return self._paths.start(rig, run, refine, dt, begin)

    def _reporting(self, future: Future[Prediction]) -> Future[Prediction]:
        """The same future, which tells when it is done."""
        on_done = self._on_done
        if on_done is not None:
            future.add_done_callback(lambda _: on_done())
        return future


def _kind(rig: Rig, refine: int, dt: float | None, derivatives: bool = False) -> Kind:
    """The kind of a rollout, by which its cost is measured."""
    return Kind(derivatives=derivatives, finer=refine > 1, shorter=dt is not None and dt < rig.solver.dt_s)
