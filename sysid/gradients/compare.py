"""Forward sensitivities and adjoint of one rollout against central differences of whole rollouts, with a step sweep.

Readings are compared at the middle of the time steps, where their interpolation in time has a slope, with the delays
of sensors and effects. Rollouts are solved to 1e-13 m, so that differences of them are worth something.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sim_core.gradients import Backward, Direction, Tape, directions, simulate_tangent
from sim_core.gradients.directions import motions, slopes
from sim_core.rigs import Parameter, Rig, list_parameters, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Trace, simulate, step_times
from sim_core.solve.step import NewtonSettings
from sysid.fit.noise import declared_noise
from sysid.streams import predicted, predicted_back, predicted_derivatives, stream_derivatives, total_delay

TIGHT = NewtonSettings(step_tolerance_m=1e-13)

STEPS = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Steps of the differences as shares of a parameter's value (of :data:`SIZES` where that is zero)."""

SIZES = {"m": 1e-3, "s": 1e-2}
"""Size of a parameter that is zero, by its unit; 1 in others."""

SMOOTH, SWITCHING = 1e-5, 1e-4
"""Bounds on relative errors: smooth mechanics; with contact that rubs, or plastic flow."""

NEGLIGIBLE = 1e-6
"""Share of what a channel does in the rollout, or of its sensor's noise, below which a parameter's effect on it is not
judged."""

ROUND_OFF = 3.0
"""Errors within this many times what round-off of the rollouts makes of differences are put down to it."""

PLATEAU = 10.0
"""Steps whose error is within this factor of the least belong to the plateau."""

Parts = tuple[tuple[str, slice], ...]

_End = tuple[float, Rig, Trace]
"""How far a parameter was taken from its value, the rig there, and its rollout."""


@dataclass(frozen=True)
class Row:
    """One parameter and channel. ``effect``: largest change of a reading per relative change of the parameter;
    ``errors``: of the forward sensitivity against central differences, by step; ``plateau``: steps of which the errors
    are about as small as the least; ``adjoint``: relative error of the adjoint against the forward sensitivity of a
    random sum of readings; ``verdict``: 'agrees', 'no effect', 'negligible', 'unresolved' (round-off hides it in the
    differences), 'jumps' (differences have no limit: the rollout jumps here) or 'differs'; ``reason``: of the last."""

    parameter: str
    value: float
    channel: str
    unit: str
    effect: float
    errors: tuple[float, ...]
    best: float
    best_step: float
    plateau: tuple[float, ...]
    adjoint: float
    bound: float
    verdict: str
    reason: str = ""


@dataclass(frozen=True)
class _Derivatives:
    """Readings at stamps of one channel ``(k, ...)`` and their derivatives ``(..., p)``; ``adjoint``: relative
    difference of both ways of differentiating, by part and parameter."""

    stamps: np.ndarray
    values: np.ndarray
    forward: np.ndarray
    adjoint: dict[str, np.ndarray]


class Comparison:
    """A rig under a motion until ``end`` [s], and its parameters by their full names."""

    def __init__(
        self,
        rig: Rig,
        poses: Mapping[str, PoseTrajectory],
        end: float,
        names: Sequence[str],
        on_work: Callable[[str], None],
    ) -> None:
        self.rig, self._poses, self._on_work = rig, poses, on_work
        self._times = step_times(0.0, end, rig.solver.dt_s)
        self._along = directions(rig, names)
        self._known = {p.name: p for p in list_parameters(rig)}
        self._scene = build_scene(rig)

    @staticmethod
    def amount_of_work(names: Sequence[str], steps: Sequence[float]) -> int:
        """Number of times that ``on_work`` is called at most."""
        return 2 + 2 * len(names) * len(steps)

    def rows(self, steps: Sequence[float]) -> Iterator[Row]:
        """Compare everything, parameter by parameter."""
        scene, along = self._scene, self._along
        self._on_work("forward sensitivities")
        trace, raw = simulate_tangent(scene, self._poses, self._times, along, settings=TIGHT)
        self.trace = trace
        self._on_work("adjoint")
        tape = Tape(scene, self._poses, self._times, TIGHT, factors=True)
        backward = Backward(tape, along)
        found = {c: self._derivatives(c, raw[c], backward) for c in trace.outputs}
        self._switches = any(r.contacts for r in trace.reports) or "bending_plasticity" in self.rig.effects
        for k, direction in enumerate(along):
            yield from self._of_parameter(k, direction, found, steps)

    def _derivatives(self, channel: str, raw: np.ndarray, backward: Backward) -> _Derivatives:
        """Forward derivatives of a channel at its stamps, and how far the adjoint is from them."""
        trace = self.trace
        delay = total_delay(self.rig, channel, trace.kinds[channel])
        stamps = 0.5 * (self._times[1:] + self._times[:-1]) + delay
        values = predicted(trace, self.rig, channel, stamps)
        forward = predicted_derivatives(trace, raw, self.rig, channel, stamps)
        forward = forward + stream_derivatives(trace, self._along, channel, stamps)
        adjoint = {}
        weights = np.random.default_rng(0).standard_normal(values.shape)
        for part, columns in _parts(trace.kinds[channel]):
            w = np.zeros_like(weights)
            w[:, columns] = np.where(np.isnan(values), 0.0, weights)[:, columns]
            given, by_stream = predicted_back(trace, self.rig, channel, stamps, w, self._along)
            gradient = backward.gradient(0.0, {channel: given}).parameters
            products = np.nan_to_num(forward) * w[..., None]
            total, size = (a.reshape(-1, len(self._along)).sum(axis=0) for a in (products, np.abs(products)))
            ours = np.array([gradient[d.name] for d in self._along]) + by_stream
            adjoint[part] = np.abs(ours - total) / np.where(size > 0.0, size, 1.0)
        return _Derivatives(stamps, values, forward, adjoint)

    def _of_parameter(
        self, k: int, direction: Direction, found: Mapping[str, _Derivatives], steps: Sequence[float]
    ) -> Iterator[Row]:
        parameter = self._known[direction.name]
        value, size = self._size(parameter)
        one = [direction]
        inside = (
            direction.low.cameras != direction.high.cameras
            or bool(slopes(self._scene, one)[0])
            or bool(motions(self.rig, one))
        )
        sweep = []
        for step in steps:
            ends = []
            for away in _away(value, step * size, parameter.lower, parameter.upper):
                self._on_work(direction.name)
                there = with_parameters(self.rig, {direction.name: value + away})
                rolled = self.trace
                if inside:
                    rolled = simulate(build_scene(there), self._poses, self._times, settings=TIGHT)
                ends.append((away, there, rolled))
            sweep.append(ends)
        for channel, derivatives in found.items():
            for part, columns in _parts(self.trace.kinds[channel]):
                yield self._row(k, direction, channel, part, columns, derivatives, steps, sweep)

    def _row(
        self,
        k: int,
        direction: Direction,
        channel: str,
        part: str,
        columns: slice,
        derivatives: _Derivatives,
        steps: Sequence[float],
        sweep: Sequence[Sequence[_End]],
    ) -> Row:
        value, size = self._size(self._known[direction.name])
        ours = derivatives.forward[:, columns, ..., k]
        base = derivatives.values[:, columns]
        readings = [[predicted(t, r, channel, derivatives.stamps)[:, columns] for _, r, t in ends] for ends in sweep]
        aways = [(ends[0][0], ends[1][0]) for ends in sweep]
        slopes_found = [_slope(base, r[0], r[1], *away) for r, away in zip(readings, aways, strict=True)]
        scale = max(_largest(ours), min(_largest(s) for s in slopes_found))
        errors = tuple(_largest(ours - s) / scale if scale > 0.0 else 0.0 for s in slopes_found)
        best = int(np.argmin(errors))
        moves = max(_largest(base - base[:1]), 1e-3 * _largest(base), self._noise(channel, columns))
        plateau = tuple(s for s, e in zip(steps, errors, strict=True) if e <= PLATEAU * errors[best])
        bound = SWITCHING if self._switches else SMOOTH
        verdict, reason = "agrees", ""
        if not np.isfinite(ours[np.isfinite(base)]).all():
            verdict, reason = "differs", "The sensitivities are not finite where the readings are."
        elif scale == 0.0 or (_largest(ours) == 0.0 and scale * size <= NEGLIGIBLE * moves):
            verdict = "no effect"
        elif scale * size <= NEGLIGIBLE * moves:
            verdict = "negligible"
        elif not derivatives.adjoint[part][k] <= bound or not errors[best] <= bound:
            hidden = ROUND_OFF * _round_off(base, readings, aways) / (np.abs(aways)[:, 0] * scale)
            within, widest = np.array(errors) <= hidden, int(np.argmin(hidden))
            near = errors[best] <= 10.0 * bound and within.any()
            if derivatives.adjoint[part][k] <= bound and (within[widest] or near):
                verdict = "unresolved"
            elif derivatives.adjoint[part][k] <= bound and _jumps(steps, errors, bound):
                verdict = "jumps"
            else:
                verdict = "differs"
                reason = self._reason(ours, scale, base, readings[best], sweep[best], bound)
        return Row(
            direction.name, value, f"{channel} {part}".strip(), _unit(self.trace.kinds[channel], part), scale * size,
            errors, errors[best], steps[best], plateau, float(derivatives.adjoint[part][k]), bound, verdict, reason,
        )  # fmt: skip

    @staticmethod
    def _size(parameter: Parameter) -> tuple[float, float]:
        """Value of a parameter, and what its steps are shares of."""
        value = parameter.value or 0.0
        return value, abs(value) or SIZES.get(parameter.unit, 1.0)

    def _noise(self, channel: str, columns: slice) -> float:
        """Declared noise of the readings in some columns of a channel."""
        return float(
            np.broadcast_to(declared_noise(self.rig, channel), self.trace.outputs[channel].shape[1:2])[columns][0]
        )

    def _reason(
        self,
        ours: np.ndarray,
        scale: float,
        base: np.ndarray,
        readings: Sequence[np.ndarray],
        ends: Sequence[_End],
        bound: float,
    ) -> str:
        """What probably makes the derivative jump, and which side the sensitivities are on."""
        counts = [np.array([r.contacts for r in trace.reports]) for _, _, trace in ends]
        changed = np.flatnonzero(counts[0] != counts[1])
        if len(changed):
            n = changed[0]
            cause = f"contact made or lost at t = {self._times[n + 1]:.4g} s ({counts[1][n]} or {counts[0][n]} points)"
        elif "bending_plasticity" in self.rig.effects:
            cause = "the onset of yield in the sheet, or of sliding"
        else:
            cause = "the onset of sliding, or of contact at a point"
        sides = []
        for reading, (away, _, _) in zip(readings, ends, strict=True):
            if _largest((reading - base) / away - ours) <= 10.0 * bound * scale:
                sides.append("more" if away > 0.0 else "less")
        side = f"; the sensitivities are those to the side of {sides[0]} of it" if len(sides) == 1 else ""
        return f"Probably {cause}{side}."


def _away(value: float, step: float, lower: float, upper: float) -> tuple[float, float]:
    """How far from its value a parameter is taken: up and down, or twice to the same side where a bound is near."""
    if value - step < lower:
        return step, 2.0 * step
    return (step, -step) if value + step <= upper else (-step, -2.0 * step)


def _slope(base: np.ndarray, first: np.ndarray, second: np.ndarray, a: float, b: float) -> np.ndarray:
    """Derivative at 0 of the parabola through ``base`` at 0, ``first`` at ``a`` and ``second`` at ``b``."""
    return np.asarray(((first - base) * b**2 - (second - base) * a**2) / (a * b * (b - a)))


def _jumps(steps: Sequence[float], errors: Sequence[float], bound: float) -> bool:
    """Whether errors grow as steps shrink, as those of differences across a jump do: in proportion to 1 / step or
    nearly so, over the three smallest steps."""
    if len(steps) < 3:
        return False
    last = sorted(zip(steps, errors, strict=True))[:3]
    grow = all(e > np.sqrt(wider / step) * less for (step, e), (wider, less) in pairwise(last))
    return grow and min(e for _, e in last) > bound


def _round_off(
    base: np.ndarray, readings: Sequence[Sequence[np.ndarray]], aways: Sequence[tuple[float, float]]
) -> float:
    """Round-off of rollouts in their readings: how far those of the smallest step are from a straight line."""
    k = int(np.argmin([abs(a) for a, _ in aways]))
    (first, second), (a, b) = readings[k], aways[k]
    return _largest((first - base) - (second - base) * a / b)


def _parts(kind: str) -> Parts:
    return (("force", slice(0, 3)), ("torque", slice(3, 6))) if kind == "wrench" else (("", slice(None)),)


def _unit(kind: str, part: str) -> str:
    return {"markers": "m", "tracks": "px"}.get(kind, "N m" if part == "torque" else "N")


def _largest(values: np.ndarray) -> float:
    """Largest absolute value, of points in sight."""
    seen = np.abs(values[np.isfinite(values)])
    return float(seen.max(initial=0.0))
