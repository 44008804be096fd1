"""By how much each marker is off at the instant at which a model errs most, before and after a fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid.noise.estimate import column_groups
from sysid.observations.observations import UNITS, Measured
from sysid.settings.fit import FIT
from sysid.solve.optimum import Fitted
from sysid.solve.outliers import DIMENSIONS
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class MarkerField:
    """One channel of one run at one instant ``t`` [s]. ``places`` ``(k, 2)``: of the markers as measured; ``before``,
    ``after`` ``(k, 2)``: measured less simulated; ``noise``: its standard deviation; all in ``unit``. ``axes``: names
    of the two coordinates, of three those in which the markers are spread most; ``downwards``: the second one points
    down, as in a picture."""

    run: str
    channel: str
    unit: str
    held_out: bool
    t: float
    places: np.ndarray
    before: np.ndarray
    after: np.ndarray
    noise: float
    axes: tuple[str, str]
    downwards: bool


def marker_fields(problem: Problem, before: Fitted, after: Fitted, held_out: bool) -> list[MarkerField]:
    """Of every channel of markers of every run, at the instant at which the model ``before`` errs most (root mean
    square over the markers that are in sight)."""
    found = []
    for i, run in enumerate(problem.runs):
        for m in run.measured:
            if m.values.shape[1] < FIT.field_markers * DIMENSIONS.get(m.kind, np.inf):
                continue
            was, now = (m.values - problem.tared(fitted, i, m) for fitted in (before, after))
            field = _of(m, was, now)
            if field is None:
                continue
            at, first, second, seen = field
            sigma = float(np.median(np.concatenate([problem.noise[m.channel].sigma[g] for g in column_groups(m)])))
            both = [first, second]
            places, earlier, later = (_points(m, values)[at][seen][:, both] for values in (m.values, was, now))
            axes = ("xyz"[first], "xyz"[second]) if DIMENSIONS[m.kind] == 3 else ("u", "v")
            where = (run.name, m.channel, UNITS[m.kind][0], held_out, float(m.t[at]))
            found.append(MarkerField(*where, places, earlier, later, sigma, axes, DIMENSIONS[m.kind] == 2))
    return found


def _points(measured: Measured, values: np.ndarray) -> np.ndarray:
    """Columns ``(n, m)`` as points ``(n, k, d)``."""
    return np.asarray(values.reshape(len(values), -1, DIMENSIONS[measured.kind]))


def _of(measured: Measured, was: np.ndarray, now: np.ndarray) -> tuple[int, int, int, np.ndarray] | None:
    """Number of the instant, of the two coordinates, and which markers are in sight there; None where there are few."""
    errors = _points(measured, was)
    seen = np.isfinite(errors).all(axis=2) & np.isfinite(_points(measured, now)).all(axis=2)
    enough = seen.sum(axis=1) >= FIT.field_markers
    if not enough.any():
        return None
    square = np.where(seen, np.sum(np.nan_to_num(errors) ** 2, axis=2), 0.0)
    rms = np.where(enough, square.sum(axis=1) / np.maximum(seen.sum(axis=1), 1), -1.0)
    at = int(np.argmax(rms))
    spread = np.ptp(_points(measured, measured.values)[at][seen[at]], axis=0)
    first, second = sorted(np.argsort(-spread, kind="stable")[:2].tolist())
    return at, first, second, seen[at]
