"""Derivatives of readings against central differences of rollouts with a sweep of steps: errors, and what they say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim_core.rigs import Rig
from sim_core.simulate import Trace
from sim_core.solve.step import NewtonSettings

TIGHT = NewtonSettings(step_tolerance_m=1e-14)
"""Kept tangents leave an error that depends on the parameter: what differences of 1e-6 of its value still see."""

STEPS = (1e-2, 1e-3, 1e-4, 2e-5, 1e-6, 1e-7)
"""Steps of the differences as shares of a parameter's value (of :data:`SIZES` where that is zero). Not 1e-5, by which
readings are themselves differentiated by what is of the sensors (:mod:`sim_core.gradients.directions`): both would make
the same error."""

SIZES = {"m": 1e-3, "s": 1e-2}
"""Size of a parameter that is zero, by its unit; 1 in others."""

SMOOTH, SWITCHING = 1e-5, 1e-4
"""Bounds on relative errors: smooth mechanics; with contact that rubs, or plastic flow."""

NEGLIGIBLE = 1e-6
"""Share of what a channel does in the rollout, or of its sensor's noise, below which a parameter's effect on it is not
judged."""

ROUND_OFF = 3.0
"""Errors within this many times what round-off of the rollouts makes of differences are put down to it."""

SAME = 1.2
"""Ratio of errors up to which they are the same."""

LOST = 0.5
"""Relative error of the best difference above which none is of the derivative."""

GROWS = 2.0
"""By how much errors grow at least towards the smaller of two steps, where there are jumps."""

STRIDE = 100.0
"""Steps whose error is so many times that of the next shorter one stride over a jump."""

PLATEAU = 10.0
"""Steps whose error is within this factor of the least belong to the plateau."""

Parts = tuple[tuple[str, slice], ...]


@dataclass(frozen=True)
class Row:
    """One parameter, or a direction, which has no ``value``, and channel. ``effect``: largest change of a reading per
    relative change of the parameter; ``errors``: of the forward sensitivity against central differences, by step;
    ``plateau``: steps of which the errors are about as small as the least; ``adjoint``: relative error
    of the adjoint against the forward sensitivity of a random sum of readings, None where the errors are its own;
    ``verdict``: 'agrees', 'one side' (central differences miss, those to one side agree: it jumps here), 'no effect',
    'negligible', 'unresolved' (round-off hides it in the differences), 'jumps' (differences have no limit: the rollout
    jumps here) or 'differs'; ``reason``: of the last, and of 'one side'."""

    parameter: str
    value: float | None
    channel: str
    unit: str
    effect: float
    errors: tuple[float, ...]
    best: float
    best_step: float
    plateau: tuple[float, ...]
    adjoint: float | None
    bound: float
    verdict: str
    reason: str = ""


def verdict(
    steps: Sequence[float],
    errors: Sequence[float],
    hidden: np.ndarray,
    bound: float,
    *,
    sound: bool = True,
    alone: bool = False,
) -> str:
    """What the errors of a derivative that has an effect say. ``hidden``: errors by step that round-off makes;
    ``sound``: both ways of differentiating agree; ``alone``: there is only one."""
    best = errors[int(np.argmin(errors))]
    if sound and best <= bound:
        return "agrees"
    within = np.array(errors) <= hidden
    if _constant(steps, np.where(within, np.nan, errors)):
        return "differs"
    widest = int(np.argmin(np.where(_short_of_a_jump(steps, errors), hidden, np.inf)))
    near, smallest = within[int(np.argmin(errors))], within[np.argsort(steps)[:3]]
    if sound and (within[widest] or (best <= 10.0 * bound and near)):
        return "unresolved"
    grown_by_round_off = best <= LOST and not near and smallest[:2].all()
    if not sound or grown_by_round_off or not jumps(steps, errors, bound):
        return "differs"
    return "unresolved" if alone and smallest.any() else "jumps"


def _constant(steps: Sequence[float], errors: np.ndarray) -> bool:
    """Whether three steps in a row have the same error, as those of a wrong derivative do, and of jumps do not; NaN is
    like no other."""
    sizes = np.array(errors)[np.argsort(steps)]
    return any(bool(sizes[k : k + 3].max() <= SAME * sizes[k : k + 3].min()) for k in range(len(sizes) - 2))


def _short_of_a_jump(steps: Sequence[float], errors: Sequence[float]) -> np.ndarray:
    """Which steps do not stride over a jump next to the place: the largest ones do, at least two, where each misses the
    derivative by more than itself, and the next shorter one by :data:`STRIDE` times less than the last of them."""
    order = np.argsort(steps)[::-1]
    sizes, over = np.array(errors)[order], 0
    for k in range(2, len(sizes)):
        if sizes[:k].min() > 1.0 and sizes[k] * STRIDE < sizes[k - 1]:
            over = k
    short = np.ones(len(sizes), dtype=bool)
    short[order[:over]] = False
    return short


def plateau(steps: Sequence[float], errors: Sequence[float]) -> tuple[float, ...]:
    """Steps of which the errors are about as small as the least."""
    return tuple(s for s, e in zip(steps, errors, strict=True) if e <= PLATEAU * errors[int(np.argmin(errors))])


def bound_of(rig: Rig, trace: Trace) -> float:
    """Largest relative error that is allowed in a rollout."""
    switches = any(r.contacts for r in trace.reports) or "bending_plasticity" in rig.effects
    return SWITCHING if switches else SMOOTH


def probable_cause(rig: Rig, times: np.ndarray, ends: Sequence[Trace]) -> str:
    """What probably makes the derivative jump between two rollouts."""
    counts = [np.array([r.contacts for r in trace.reports]) for trace in ends]
    changed = np.flatnonzero(counts[0] != counts[1])
    if len(changed):
        n = changed[0]
        return f"contact made or lost at t = {times[n + 1]:.4g} s ({counts[1][n]} or {counts[0][n]} points)"
    if "bending_plasticity" in rig.effects:
        return "the onset of yield in the sheet, or of sliding"
    return "the onset of sliding, or of contact at a point"


def away_of(value: float, step: float, lower: float, upper: float) -> tuple[float, float]:
    """How far from its value a parameter is taken: up and down, or twice to the same side where a bound is near."""
    if value - step < lower:
        return step, 2.0 * step
    return (step, -step) if value + step <= upper else (-step, -2.0 * step)


def slope_of(base: np.ndarray, first: np.ndarray, second: np.ndarray, a: float, b: float) -> np.ndarray:
    """Derivative at 0 of the parabola through ``base`` at 0, ``first`` at ``a`` and ``second`` at ``b``."""
    return np.asarray(((first - base) * b**2 - (second - base) * a**2) / (a * b * (b - a)))


def side_of(
    ours: np.ndarray,
    scale: float,
    base: np.ndarray,
    readings: Sequence[Sequence[np.ndarray]],
    aways: Sequence[tuple[float, float]],
    bound: float,
) -> tuple[str, float] | None:
    """Side of a place where the derivative jumps that sensitivities ``ours`` are those to, 'more' or 'less', and their
    least relative error against differences to that side, of second order from two neighbouring steps of the sweep.
    None where they miss by more than the ``bound`` on either, or where one pair of steps stands alone: a neighbour
    must be within :data:`PLATEAU` times the bound. ``readings``: at both ends of each step, that far ``aways``."""
    best: tuple[float, str] = (np.inf, "")
    for side, sign in (("more", 1.0), ("less", -1.0)):
        there = sorted(
            ((away, reading) for both, step in zip(aways, readings, strict=True)
             for away, reading in zip(both, step, strict=True) if sign * away > 0.0),
            key=lambda pair: abs(pair[0]),
        )  # fmt: skip
        errors = [
            largest(ours - slope_of(base, first, second, near, far)) / scale
            for (near, first), (far, second) in pairwise(there)
        ]
        best = min([best, *((min(pair), side) for pair in pairwise(errors) if max(pair) <= PLATEAU * bound)])
    error, side = best
    return (side, error) if error <= bound else None


def jumps(steps: Sequence[float], errors: Sequence[float], bound: float) -> bool:
    """Whether errors grow as steps shrink, as those of differences across jumps do: to the smallest step in proportion
    to 1 / step or nearly so, and to the one before as well, or all differences miss by about the derivative or more."""
    if len(steps) < 3:
        return False
    (step, most), (wider, less), (_, least) = sorted(zip(steps, errors, strict=True))[:3]
    grow = less > GROWS * least and min(most, less, least) > bound
    return bool(most > np.sqrt(wider / step) * less and (grow or min(errors) > LOST))


def round_off(
    base: np.ndarray, readings: Sequence[Sequence[np.ndarray]], aways: Sequence[tuple[float, float]]
) -> float:
    """Round-off of rollouts in their readings: how far those of the smallest step are from a straight line."""
    k = int(np.argmin([abs(a) for a, _ in aways]))
    (first, second), (a, b) = readings[k], aways[k]
    return largest((first - base) - (second - base) * a / b)


def parts_of(kind: str) -> Parts:
    return (("force", slice(0, 3)), ("torque", slice(3, 6))) if kind == "wrench" else (("", slice(None)),)


def unit_of(kind: str, part: str) -> str:
    return {"markers": "m", "tracks": "px"}.get(kind, "N m" if part == "torque" else "N")


def largest(values: np.ndarray) -> float:
    """Largest absolute value, of points in sight."""
    seen = np.abs(values[np.isfinite(values)])
    return float(seen.max(initial=0.0))
