"""Predictions of a coarse model, with what a finer one adds (output space mapping).

A rollout on a fine mesh costs many times one on a coarse mesh, and a search needs dozens. What the fine model changes
in the readings, d(t) = y_fine(t) - y_coarse(t), changes little with the parameters, by a few percent of itself where
these change by a few percent. It is therefore measured where a search stands, and the search goes on with

    y(theta) = y_coarse(theta) + d(t)

(Bandler et al., IEEE Trans. Microwave Theory Tech. 52, 2004, section III, with a shift of the outputs). Derivatives are
those of the coarse model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import cast

import numpy as np

from sim_core.rigs import Rig
from sysid.model.parameters import FitParameter
from sysid.model.prediction_source import AnyEngine, Responding
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated, SizedEffects
from sysid.observations.observations import Run

Additions = Mapping[str, Mapping[str, np.ndarray]]
"""What is added to the readings ``(n, m)``, by run and channel, measured units."""


def additions(
    runs: Sequence[Run], coarse: Sequence[Prediction], fine: Sequence[Prediction]
) -> dict[str, dict[str, np.ndarray]]:
    """What the fine model adds to the predictions of the coarse one; nothing where either is out of sight."""
    return {
        run.name: {c: np.nan_to_num(values - there.values[c]) for c, values in here.values.items()}
        for run, there, here in zip(runs, coarse, fine, strict=True)
    }


def mapped(prediction: Prediction, run: Run, added: Additions) -> Prediction:
    """A prediction of the coarse model with what is added to it."""
    changes = added.get(run.name, {})
    return replace(prediction, values={c: v + changes.get(c, 0.0) for c, v in prediction.values.items()})


class SpaceMappedPredictor:
    """As the predictor of the coarse model that it is made of, in the runs of ``added`` with what is added there."""

    def __init__(self, engine: AnyEngine, added: Additions) -> None:
        self.coarse = engine
        self.added = added

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        """A prediction without derivatives."""
        return self._later(self.coarse.submit(rig, run, refine, dt), run)

    def submit_with_derivatives(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        refine: int = 1,
        dt: float | None = None,
    ) -> Future[Prediction]:
        """A prediction with the derivatives of the coarse model."""
        return self._later(self.coarse.submit_with_derivatives(rig, run, parameters, scaled, refine, dt), run)

    def submit_responses(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        candidates: Sequence[SizedEffects],
        modulated: Sequence[Modulated] = (),
    ) -> Future[Prediction]:
        """A prediction with the responses of the coarse model."""
        responding = cast(Responding, self.coarse)
        return self._later(responding.submit_responses(rig, run, parameters, scaled, candidates, modulated), run)

    def predict_all(
        self, rig: Rig, runs: Sequence[Run], parameters: Sequence[FitParameter], scaled: np.ndarray
    ) -> list[Prediction]:
        """Predictions of several runs with the derivatives of the coarse model."""
        found = self.coarse.predict_all(rig, runs, parameters, scaled)
        return [mapped(p, run, self.added) for p, run in zip(found, runs, strict=True)]

    def _later(self, pending: Future[Prediction], run: Run) -> Future[Prediction]:
        later: Future[Prediction] = Future()

        def done(future: Future[Prediction]) -> None:
            if not later.set_running_or_notify_cancel():
                return
            try:
                later.set_result(mapped(future.result(), run, self.added))
            except BaseException as error:
                later.set_exception(error)

        pending.add_done_callback(done)
        return later
