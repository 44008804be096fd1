"""Predictions with derivatives that are carried over from where they were made last.

A rollout with derivatives by thirty parameters takes several times as long as one without. Between neighbouring
parameters derivatives hardly change, so most evaluations of a search are made with plain rollouts, and the derivatives
made last are corrected by what these showed (Broyden, Math. Comp. 19, 1965, eq. 4.5, reading by reading): with the step
s in units of the parameters' priors and the change y of a reading,

    J' = J + (y - J s) s^T / (s^T s).

They are made anew after ``MODEL.carried_evaluations`` evaluations, where the step is long, and for other parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass

import numpy as np

from sim_core.rigs import Rig
from sysid.model.parameters import FitParameter, rig_in
from sysid.model.prediction_source import AnyEngine
from sysid.model.predictor import Prediction
from sysid.observations.observations import Run
from sysid.settings.model import MODEL


@dataclass
class _Carried:
    """Predictions of all runs at scaled values; ``since``: evaluations since the derivatives were made."""

    names: tuple[str, ...]
    runs: tuple[object, ...]
    scaled: np.ndarray
    found: list[Prediction]
    since: int


class SparingPredictor:
    """As the predictor that it is made of, for one search."""

    def __init__(self, engine: AnyEngine) -> None:
        self._engine = engine
        self._carried: _Carried | None = None

    def submit(self, rig: Rig, run: Run, refine: int = 1, dt: float | None = None) -> Future[Prediction]:
        """A prediction without derivatives."""
        return self._engine.submit(rig, run, refine, dt)

    def submit_with_derivatives(
        self,
        rig: Rig,
        run: Run,
        parameters: Sequence[FitParameter],
        scaled: np.ndarray,
        refine: int = 1,
        dt: float | None = None,
    ) -> Future[Prediction]:
        """A prediction with derivatives of its own."""
        return self._engine.submit_with_derivatives(rig, run, parameters, scaled, refine, dt)

    def predict_all(
        self, rig: Rig, runs: Sequence[Run], parameters: Sequence[FitParameter], scaled: np.ndarray
    ) -> list[Prediction]:
        """Predictions of several runs with derivatives, of their own or carried over."""
        names, on = tuple(p.name for p in parameters), tuple(map(_key, runs))
        before = self._carried
        width = np.array([p.known_sd or p.prior_sd for p in parameters])
        if not names or before is None or (before.names, before.runs) != (names, on):
            return self._anew(rig, runs, parameters, scaled)
        step = (scaled - before.scaled) / width
        if not step.any():
            return before.found
        if before.since >= MODEL.carried_evaluations or np.abs(step).max(initial=0.0) > MODEL.fresh_derivatives_sd:
            return self._anew(rig, runs, parameters, scaled)
        jobs = [self._engine.submit(rig_in(rig, parameters, scaled, run.name), run) for run in runs]
        found = [
            Prediction(now.values, _corrected(then, now, step, width), now.trace)
            for then, now in zip(before.found, [job.result() for job in jobs], strict=True)
        ]
        self._carried = _Carried(names, on, np.array(scaled), found, before.since + 1)
        return found

    def _anew(
        self, rig: Rig, runs: Sequence[Run], parameters: Sequence[FitParameter], scaled: np.ndarray
    ) -> list[Prediction]:
        found = self._engine.predict_all(rig, runs, parameters, scaled)
        names, on = tuple(p.name for p in parameters), tuple(map(_key, runs))
        self._carried = _Carried(names, on, np.array(scaled), found, 0)
        return found


def _key(run: Run) -> object:
    """What of a run predictions depend on, among runs of one search."""
    return run.name, None if run.steps is None else run.steps.tobytes()


def _corrected(then: Prediction, now: Prediction, step: np.ndarray, width: np.ndarray) -> dict[str, np.ndarray]:
    """Derivatives ``(n, m, p)`` by channel, corrected by the change of the readings along the ``step``."""
    square = float(step @ step)
    found = {}
    for channel, slopes in then.derivatives.items():
        if square == 0.0:
            found[channel] = slopes
            continue
        change = now.values[channel] - then.values[channel] - slopes @ (step * width)
        added = np.nan_to_num(change)[..., None] * (step / square / width)
        # A point that comes into sight has no derivative yet: it is taken not to move.
        found[channel] = np.where(np.isnan(now.values[channel])[..., None], np.nan, np.nan_to_num(slopes) + added)
    return found
