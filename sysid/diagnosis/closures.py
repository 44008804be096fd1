"""Closures: what a place of the model may do that no effect of the library describes.

Every slot (:mod:`sysid.diagnosis.slots`) has an error without a law: the modulus of a sheet, say, is off by

    E (1 + sum_f c_f phi_f),

with features phi_f of what goes on, which are the same for all recordings: how hard is pressed, where the hand is,
which way and how fast it goes, how late it is. Forces are those that the model predicts: a feature of measured ones has
their noise, and would explain it (errors in variables). With small coefficients these are what careful models differ
in; with large ones they are physics that nobody has named (Kennedy & O'Hagan, J. R. Stat. Soc. B 63, 2001, with the
discrepancy inside of the model as in Sargsyan, Huan & Najm, Int. J. Uncertain. Quantif. 9, 2019). The two widths are
those of :mod:`sysid.comparison.posterior`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.rigs import Rig
from sysid.diagnosis.slots import (
    Slot,
    coefficient_sd,
    mechanical_slots,
    reading_size,
    sensed,
    sensor_slots,
    shape_count,
)
from sysid.model.parameters import FitParameter, fit_parameters
from sysid.model.predictor import Prediction
from sysid.model.responses import Modulated
from sysid.observations.observations import Run
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.residuals import Problem


@dataclass(frozen=True)
class Course:
    """A feature of one recording. ``times`` [s] ``(n,)``, ``values`` ``(n,)``: within -1 and 1."""

    feature: str
    times: np.ndarray
    values: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """Its values at instants [s] ``(m,)``."""
        return np.asarray(np.interp(t, self.times, self.values))


@dataclass(frozen=True)
class Closure:
    """One coefficient. ``name``: what it changes, by which feature; ``sd``: its standard deviation where the physics of
    the slot is unknown, as large as what the slot is known to within."""

    slot: Slot
    name: str
    sd: float


class Closures:
    """The closures of all slots of a rig in a problem, given ``predictions`` of its recordings. ``columns``: in the
    order of what :meth:`append` adds."""

    def __init__(self, rig: Rig, problem: Problem, predictions: Sequence[Prediction]) -> None:
        self._runs = problem.runs
        self._sizes: dict[str, np.ndarray] = {}
        found = courses(problem.runs, [p.values for p in predictions])
        self._courses = {run.name: course for run, course in zip(problem.runs, found, strict=True)}
        features = [c.feature for c in next(iter(self._courses.values()))]
        slots = mechanical_slots(rig)
        parameters = {p.name: p for p in fit_parameters(rig, [n for _, names in slots for n in names])}
        self._parameters = [n for _, names in slots for n in names if n in parameters]
        self.columns = [
            Closure(slot, f"{name} by {feature}", coefficient_sd(slot, name, parameters))
            for slot, names in slots
            for name in names
            if name in parameters
            for feature in features
        ]
        none: dict[str, FitParameter] = {}
        self._sensors = sensor_slots(problem)
        self._widths = {slot: shape_count(slot, problem) for slot in self._sensors}
        for slot in self._sensors:
            sd = coefficient_sd(slot, slot.name, none)
            names = [f"shape {k + 1} by {f}" for k in range(self._widths[slot]) for f in ("nothing", *features)]
            self.columns += [Closure(slot, f"{slot.name} {name}", sd) for name in names]
        for m in (m for run in problem.runs for m in run.measured):
            self._sizes[m.channel] = np.maximum(reading_size(m), self._sizes.get(m.channel, 0.0))

    def modulated(self, run: Run) -> list[Modulated]:
        """Those of the mechanics, for the rollout of a recording."""
        return [Modulated(name, c.times, c.values) for name in self._parameters for c in self._courses[run.name]]

    def append(self, run: Run, prediction: Prediction) -> Prediction:
        """A prediction whose last derivatives are by :meth:`modulated`, with those of sensors after them."""
        derivatives = {}
        for m in run.measured:
            by = np.stack([np.ones(len(m.t)), *(c.at(m.t) for c in self._courses[run.name])], axis=-1)
            parts = [prediction.derivatives[m.channel]]
            for slot in self._sensors:
                if slot.name == m.channel:
                    parts.append(sensed(slot, m, prediction.values[m.channel], self._sizes[m.channel], by))
                else:
                    parts.append(np.zeros((*m.values.shape, self._widths[slot] * by.shape[1])))
            derivatives[m.channel] = np.concatenate(parts, axis=-1)
        return Prediction(prediction.values, derivatives, prediction.trace)


def courses(runs: Sequence[Run], predicted: Sequence[Mapping[str, np.ndarray]]) -> list[list[Course]]:
    """Features of recordings, of which readings are ``predicted`` ``(n, m)`` by channel, with one scale for all: the
    ``time`` since the first one began; along each of the axes in which the hands move notably, the ``place``, the
    ``velocity`` and the ``direction`` in which they go; the ``square`` of the first place, the ``speed``; the ``load``
    on the wrench sensors, and the ``force`` along each of its axes, without any of which these are zero."""
    grids = [np.linspace(0.0, run.end, DIAGNOSIS.feature_samples) for run in runs]
    moves = _moves(runs, grids)
    loads = [_forces(*known) for known in zip(runs, grids, predicted, strict=True)]
    sizes = [np.linalg.norm(f, axis=1) for f in loads]
    places, forces = _along_axes(moves), _along_axes(loads)
    begun = np.concatenate([[0.0], np.cumsum([run.end for run in runs])])
    features: list[dict[str, np.ndarray]] = [
        {"time": 2.0 * (begun[k] + grid) / begun[-1] - 1.0} for k, grid in enumerate(grids)
    ]
    speeds = [np.gradient(m, grid, axis=0) for m, grid in zip(moves, grids, strict=True)]
    fastest, hardest = _largest([np.linalg.norm(s, axis=1) for s in speeds]), _largest(sizes)
    for axis in range(places[0].shape[1]):
        along = [p[:, axis] for p in places]
        rates = [np.gradient(p, grid) for p, grid in zip(along, grids, strict=True)]
        reach, most = _largest(along), _largest(rates)
        for k, mine in enumerate(features):
            typical = max(float(np.sqrt(np.mean(rates[k] ** 2))), 1e-12)
            mine[f"place {axis + 1}"] = along[k] / reach
            mine[f"velocity {axis + 1}"] = rates[k] / most
            mine[f"direction {axis + 1}"] = rates[k] / np.hypot(rates[k], 0.1 * typical)
    for k, mine in enumerate(features):
        mine["square"] = mine["place 1"] ** 2
        mine["speed"] = np.linalg.norm(speeds[k], axis=1) / fastest
        mine["load"] = sizes[k] / hardest
    for axis in range(forces[0].shape[1]):
        most = _largest([f[:, axis] for f in forces])
        for k, mine in enumerate(features):
            mine[f"force {axis + 1}"] = forces[k][:, axis] / most
    return [[Course(name, grid, v) for name, v in mine.items()] for grid, mine in zip(grids, features, strict=True)]


def _along_axes(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Courses ``(n, d)`` of all recordings about their common middle along their principal axes ``(n, r)``, those with
    a notable share of the largest, one at least."""
    whole = np.vstack(parts)
    centre = whole.mean(axis=0)
    _, sizes, axes = np.linalg.svd(whole - centre, full_matrices=False)
    count = max(1, int(np.count_nonzero(sizes[: DIAGNOSIS.feature_axes] > DIAGNOSIS.feature_axis_share * sizes[0])))
    return [(p - centre) @ axes[:count].T for p in parts]


def _largest(parts: Sequence[np.ndarray]) -> float:
    return max(float(np.max(np.abs(p), initial=0.0)) for p in parts) or 1.0


def _moves(runs: Sequence[Run], grids: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Where the hands are, ``(n, 6 h)``: shifts, and turns from the first pose, each over its largest."""
    parts: list[list[np.ndarray]] = []
    for run, grid in zip(runs, grids, strict=True):
        mine = []
        for name in sorted(run.poses):
            (at, turned), (first, before) = run.poses[name].sample(grid), runs[0].poses[name].sample(grids[0][:1])
            mine += [at - first, (Rotation.from_quat(before).inv() * Rotation.from_quat(turned)).as_rotvec()]
        parts.append(mine or [np.zeros((len(grid), 1))])
    scales = [_largest([part[k] for part in parts]) for k in range(len(parts[0]))]
    return [np.hstack([p / s for p, s in zip(part, scales, strict=True)]) for part in parts]


def _forces(run: Run, grid: np.ndarray, predicted: Mapping[str, np.ndarray]) -> np.ndarray:
    """Predicted forces on all wrench sensors ``(n, 3 w)``; one course of zeros without any."""
    found = [
        np.stack([np.interp(grid, m.t, part) for part in np.nan_to_num(predicted[m.channel][:, :3]).T], axis=1)
        for m in run.measured
        if m.kind == "wrench" and np.isfinite(m.values).any()
    ]
    return np.hstack(found) if found else np.zeros((len(grid), 1))
