"""Recordings that begin in another shape than those before them.

A body without internal variables that last begins each recording in the shape at rest that the rig says. A crease, a
set or a curl that it got before is there at the first rest of later ones, before any hand moves: a law that lasts may
explain it (:mod:`sysid.model.sequence`), and what happened between the recordings no law does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sysid.diagnosis.residual_analysis import off_by
from sysid.noise.stillness import moving
from sysid.observations.observations import Measured, Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted
from sysid.solve.residuals import Problem

UNITS = {"markers": ("mm", 1e3), "tracks": ("px", 1.0)}


@dataclass(frozen=True)
class FirstRest:
    """What a model misses of the markers of one channel before any hand moves: ``miss``, root mean square over them in
    measured units, and ``excess``, over what readings may be off there."""

    run: str
    channel: str
    kind: str
    miss: float
    excess: float


def first_rests(problem: Problem, fitted: Fitted) -> list[FirstRest]:
    """Of all recordings of a problem that begin at rest, and see markers then."""
    found = []
    for i, run in enumerate(problem.runs):
        end = _moves_at(run)
        for m in run.measured:
            rest = m.t < end
            if m.kind not in UNITS or rest.sum() < DIAGNOSIS.shape_readings:
                continue
            found += _of(problem, fitted, i, m, rest)
    return found


def _of(problem: Problem, fitted: Fitted, index: int, m: Measured, rest: np.ndarray) -> list[FirstRest]:
    run = problem.runs[index]
    miss = (m.values - problem.explained(fitted, index, m))[rest]
    seen = np.isfinite(miss).sum(axis=0) >= DIAGNOSIS.shape_readings
    if not seen.any():
        return []
    mean = np.nanmean(miss[:, seen], axis=0)
    off = np.broadcast_to(off_by(problem, index, m), m.values.shape)[rest][:, seen].mean(axis=0)
    rms, ratio = (float(np.sqrt(np.mean(v**2))) for v in (mean, mean / off))
    return [FirstRest(run.name, m.channel, m.kind, rms, ratio)]


def _moves_at(run: Run) -> float:
    """When the first hand begins to move [s]."""
    spans = [span for trajectory in run.poses.values() for span in moving(trajectory)]
    return min((start for start, _ in spans), default=run.end)


def other_first_shapes(rests: Sequence[FirstRest]) -> tuple[str, ...]:
    """A sentence for each channel of which some recordings begin far off the model, and others do not."""
    said = []
    for channel in dict.fromkeys(r.channel for r in rests):
        mine = [r for r in rests if r.channel == channel]
        least = min(mine, key=lambda r: r.excess)
        far = [
            r
            for r in mine
            if r.excess
            > max(
                DIAGNOSIS.other_shape_ratio * max(1.0, least.excess),
                DIAGNOSIS.other_shape_share * max(r.excess for r in mine),
            )
        ]
        if not far:
            continue
        unit, scale = UNITS[least.kind]
        names = " and ".join(r.run for r in far)
        sizes = " and ".join(f"{scale * r.miss:.2g}" for r in far)
        said.append(
            f"{names} {'begins' if len(far) == 1 else 'begin'} in another shape than the model: before any hand moves, "
            f"markers of {channel} are off by {sizes} {unit}, those of {least.run} by {scale * least.miss:.2g} {unit}. "
            "A crease or a set that a body got between these recordings, or before them, does that. Give the recording "
            "in which it got it too; or diagnose the recordings before and after apart; or let the rig of the later "
            "ones begin in their shape (effect sheet_precurvature)."
        )
    return tuple(said)
