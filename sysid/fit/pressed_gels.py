"""Fits whose rollouts press a gel so far that its law says little."""

from __future__ import annotations

from collections.abc import Sequence

from sysid.model.predictor import Prediction
from sysid.observations.observations import Run, of_recording


def pressed_gels(runs: Sequence[Run], predictions: Sequence[Prediction]) -> list[str]:
    """A sentence for each recording and gel that was pressed beyond where the force of a uniaxial test falls."""
    return [
        of_recording(run.name, least.sentence)
        for run, prediction in zip(runs, predictions, strict=True)
        for least in getattr(prediction.trace, "least_volumes", ())
        if least.ratio < least.softening
    ]
