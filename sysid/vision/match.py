"""Identity of markers: one-to-one assignment of a reference layout to the markers found in a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from sysid.vision.field import Points, neighbour_residual, pitch_of, thin_plate_map
from sysid.vision.grow import grow, seeds_at

_SCHEDULE = ((1.2, 30.0), (1.0, 5.0), (0.8, 1.0), (0.7, 0.3), (0.6, 0.1), (0.6, 0.03), (0.6, 0.03))
"""Coarse to fine: gate on the distance to the prediction [pitch], and the spline's smoothing."""

FINE = 3
"""Rows of the schedule that are gone through from a start that is close."""

LOST_COST = 0.25
"""Cost of a lost marker or an unexplained detection [pitch^2], that of a misfit of half a pitch."""


@dataclass(frozen=True)
class MatchParameters:
    """How far a marker may lie from the smooth field."""

    max_residual_pitch: float = 0.32
    """Largest distance [pitch] between a marker and the place its neighbours predict. A blob of no quality,
    which may be glare near the marker, is given half of it."""
    accept_cost: float = 0.012
    """A start whose match costs less than this is taken without trying others."""
    search_pitch: float = 4.0
    """Largest displacement [pitch] of the central marker that the search considers."""


@dataclass(frozen=True)
class LayoutMatch:
    """A reference layout assigned to the markers of one frame; rows follow the reference."""

    index: NDArray[np.intp]
    """Row of the detection taken for each reference marker, -1 when lost, shape ``(n,)``."""
    uv: Points
    """Position [px] of each reference marker: seen, or the smooth field's guess when lost, ``(n, 2)``."""
    residual_px: NDArray[np.float64]
    """Distance [px] to the place the neighbours predict, NaN when lost, shape ``(n,)``."""
    cost: float
    """Mean squared misfit in units of pitch^2, lost markers and unexplained detections included."""
    start: str
    """Which start led here."""

    @property
    def found(self) -> NDArray[np.bool_]:
        """True where the marker was found, shape ``(n,)``."""
        return np.asarray(self.index >= 0)


def match_layout(
    reference: Points,
    uv: Points,
    quality: NDArray[np.float64],
    *,
    starts: dict[str, Points] | None = None,
    search: bool = True,
    whole: bool = True,
    view: tuple[int, int] | None = None,
    close: bool = False,
    parameters: MatchParameters | None = None,
) -> LayoutMatch:
    """Assign the reference layout to the detections of one frame by a globally smooth one-to-one match.

    Main arguments: ``reference`` ``(n, 2)`` and ``uv`` ``(m, 2)`` [px], ``quality`` ``(m,)`` in 0..1.
    Other arguments: ``starts`` are predicted positions of all reference markers ``(n, 2)`` by name, tried
    in order (say, the previous frame); ``search`` adds whole-pattern starts that need no prediction;
    ``whole`` says that the reference has all markers there are, so that a detection outside the pattern
    speaks against a match (False when markers enter the image that the reference does not have);
    ``view`` is width and height [px] of the image: a marker that left it is not held against a match;
    ``close`` says that starts are as near as a picture is to the one before: only the fine part of the search is done.
    """
    parameters = parameters or MatchParameters()
    pitch = pitch_of(reference)
    if len(uv) < 4 or len(reference) < 4 or pitch <= 0.0:
        lost = np.full(len(reference), -1, dtype=np.intp)
        return LayoutMatch(lost, reference.copy(), np.full(len(reference), np.nan), float("inf"), "none")

    def refine(predicted: Points, name: str) -> LayoutMatch:
        return _refine(reference, uv, quality, predicted, pitch, name, parameters, view, whole, close)

    best: LayoutMatch | None = None
    for name, predicted in (starts or {}).items():
        best = _better(best, refine(predicted, name))
        if best.cost <= parameters.accept_cost:
            return best
    if search or best is None:
        predicted = _centroid_start(reference, uv, quality)
        best = _better(best, refine(predicted, "centroid"))
        if best.cost > parameters.accept_cost:
            for name, predicted in _grown_starts(reference, uv, quality, pitch, parameters):
                best = _better(best, refine(predicted, name))
    assert best is not None
    return best


def _better(old: LayoutMatch | None, new: LayoutMatch) -> LayoutMatch:
    return new if old is None or new.cost < old.cost else old


def _grown_starts(
    reference: Points,
    uv: Points,
    quality: NDArray[np.float64],
    pitch: float,
    parameters: MatchParameters,
) -> list[tuple[str, Points]]:
    """Return the three layouts that grew furthest from seeds at the centre of the pattern."""
    ranked: list[tuple[float, NDArray[np.intp]]] = []
    for seed in seeds_at(reference, uv, quality, pitch, reach=parameters.search_pitch):
        index = grow(reference, uv, quality, seed, pitch)
        rows = np.flatnonzero(index >= 0)
        if len(rows) < 8:
            continue
        misfit = neighbour_residual(reference[rows], uv[index[rows]], pitch=pitch) / pitch
        lost = len(reference) - len(rows) + float(quality.sum() - quality[index[rows]].sum())
        cost = float(np.sum(np.minimum(misfit, 0.5) ** 2)) + LOST_COST * lost
        ranked.append((cost, index))
        if cost < parameters.accept_cost * len(reference):
            break
    ranked.sort(key=lambda item: item[0])
    starts = []
    for place, (_, index) in enumerate(ranked[:3]):
        rows = np.flatnonzero(index >= 0)
        predicted = thin_plate_map(reference[rows], uv[index[rows]], reference, pitch=pitch, smoothing=0.3)
        starts.append((f"grown {place + 1}", predicted))
    return starts


def _centroid_start(reference: Points, uv: Points, quality: NDArray[np.float64]) -> Points:
    """Put centroid and size of the sharp markers on the reference's, shape ``(n, 2)`` [px]."""
    sharp = uv[quality > 0.5] if np.count_nonzero(quality > 0.5) >= 4 else uv
    centre, target = reference.mean(axis=0), sharp.mean(axis=0)
    scale = float(np.clip(sharp.std() / max(reference.std(), 1e-9), 0.7, 1.4))
    return np.asarray(target + scale * (reference - centre), dtype=float)


def _assign(predicted: Points, uv: Points, quality: NDArray[np.float64], gate: float) -> NDArray[np.intp]:
    """Return the detection for each prediction by least total squared distance, -1 beyond ``gate`` [px].

    A detection of low quality costs a little more, so that glare does not take the place of a marker.
    """
    cost = np.minimum(cdist(predicted, uv, "sqeuclidean"), gate**2)
    cost = cost + 0.1 * gate**2 * (1.0 - quality[None, :])
    rows, columns = linear_sum_assignment(cost)
    index = np.full(len(predicted), -1, dtype=np.intp)
    near = np.linalg.norm(predicted[rows] - uv[columns], axis=1) < gate
    index[rows[near]] = columns[near]
    return index


def _refine(
    reference: Points,
    uv: Points,
    quality: NDArray[np.float64],
    predicted: Points,
    pitch: float,
    start: str,
    parameters: MatchParameters,
    view: tuple[int, int] | None,
    whole: bool,
    close: bool,
) -> LayoutMatch:
    """Alternate assignment and smooth field from coarse to fine, then take out what does not fit."""
    limit = parameters.max_residual_pitch * pitch
    index = np.full(len(reference), -1, dtype=np.intp)
    for gate, smoothing in _SCHEDULE[-FINE:] if close else _SCHEDULE:
        before = index
        index = _assign(predicted, uv, quality, gate * pitch)
        rows = np.flatnonzero(index >= 0)
        if len(rows) < 4:
            break
        if smoothing < 0.1 and np.array_equal(index, before):
            break
        misfit = neighbour_residual(reference[rows], uv[index[rows]], pitch=pitch)
        trusted = rows[misfit <= max(limit, float(np.percentile(misfit, 60)))]
        predicted = thin_plate_map(reference[trusted], uv[index[trusted]], reference, pitch=pitch, smoothing=smoothing)
    residual = np.full(len(reference), np.nan)
    for _ in range(4):
        rows = np.flatnonzero(index >= 0)
        if len(rows) < 4:
            index[:] = -1
            break
        misfit = neighbour_residual(reference[rows], uv[index[rows]], pitch=pitch)
        residual[:] = np.nan
        residual[rows] = misfit
        excess = misfit / (limit * (0.5 + 0.5 * quality[index[rows]]))
        if (excess <= 1.0).all():
            break
        index[rows[excess > max(1.0, 0.5 * float(excess.max()))]] = -1
    else:
        index[~(residual <= limit)] = -1
    residual[index < 0] = np.nan
    return _finish(reference, uv, quality, index, residual, predicted, pitch, start, view, whole)


def _finish(
    reference: Points,
    uv: Points,
    quality: NDArray[np.float64],
    index: NDArray[np.intp],
    residual: NDArray[np.float64],
    predicted: Points,
    pitch: float,
    start: str,
    view: tuple[int, int] | None,
    whole: bool,
) -> LayoutMatch:
    rows = np.flatnonzero(index >= 0)
    place = predicted.copy()
    if len(rows) >= 4:
        place = thin_plate_map(reference[rows], uv[index[rows]], reference, pitch=pitch, smoothing=0.03)
    place[rows] = uv[index[rows]]
    unused = np.ones(len(uv), dtype=bool)
    unused[index[rows]] = False
    reach = 1.5 * pitch if whole else 0.5 * pitch
    outside = cKDTree(place).query(uv)[0] > reach
    lost = index < 0
    if view is not None:
        margin = 0.25 * pitch
        left = (place < margin).any(axis=1) | (place > np.array(view) - 1.0 - margin).any(axis=1)
        lost &= ~left
    total = float(np.sum((residual[rows] / pitch) ** 2)) + LOST_COST * float(lost.sum())
    total += LOST_COST * float(np.sum(quality[unused & ~outside]))
    return LayoutMatch(index, place, residual, total / len(reference), start)
