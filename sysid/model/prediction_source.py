"""What fits and diagnoses ask for predictions, whether these are made in this process, in several, or carried over."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Protocol

import numpy as np

from sim_core.rigs import Rig
from sysid.model.parameters import FitParameter
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated, SizedEffects
from sysid.observations.observations import Run


class AnyEngine(Protocol):
    """A source of predictions (:class:`sysid.model.predictor.SerialPredictor` says what each method gives)."""

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]: ...

    def submit_with_derivatives(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        refine: int = 1,
        dt: float | None = None,
    ) -> Future[Prediction]: ...

    def predict_all(
        self, rig: Rig, runs: Sequence[Run], parameters: Sequence[FitParameter], scaled: np.ndarray
    ) -> list[Prediction]: ...


class Responding(AnyEngine, Protocol):
    """One that also tells responses to effects of finite size."""

    def submit_responses(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        candidates: Sequence[SizedEffects],
        modulated: Sequence[Modulated] = (),
    ) -> Future[Prediction]: ...
