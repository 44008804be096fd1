"""Predictions of a rig that is changed before it is simulated: with finer cells, or wider bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future

import numpy as np

from sim_core.rigs import Rig
from sysid.model.parameters import FitParameter
from sysid.model.prediction_source import Responding
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated, SizedEffects
from sysid.observations.observations import Run


class ChangedRigPredictor:
    """As the predictor ``engine`` for rigs that ``change`` makes of those asked for."""

    def __init__(self, engine: Responding, change: Callable[[Rig], Rig]) -> None:
        self._engine = engine
        self._change = change

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        """A prediction without derivatives."""
        return self._engine.submit(self._change(rig), run, refine, dt)

    def submit_with_derivatives(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        refine: int = 1,
        dt: float | None = None,
    ) -> Future[Prediction]:
        """A prediction with derivatives."""
        return self._engine.submit_with_derivatives(self._change(rig), run, parameters, scaled, refine, dt)

    def submit_responses(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        candidates: Sequence[SizedEffects],
        modulated: Sequence[Modulated] = (),
    ) -> Future[Prediction]:
        """A prediction with responses to effects."""
        return self._engine.submit_responses(self._change(rig), run, parameters, scaled, candidates, modulated)

    def predict_all(
        self, rig: Rig, runs: Sequence[Run], parameters: Sequence[FitParameter], scaled: np.ndarray
    ) -> list[Prediction]:
        """Predictions of several runs with derivatives."""
        return self._engine.predict_all(self._change(rig), runs, parameters, scaled)
