"""Forward sensitivities and adjoint of one rollout against central differences of whole rollouts, with a step sweep.

Readings are compared at the middle of the time steps, where their interpolation in time has a slope, with the delays
of sensors and effects. Rollouts are solved to 1e-14 m, so that differences of them are worth something.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.gradients import Backward, Direction, Tape, directions, simulate_tangent
from sim_core.rigs import Parameter, Rig, list_parameters, with_parameters
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Trace, simulate, step_times
from sysid.gradients.differences import (
    NEGLIGIBLE,
    ROUND_OFF,
    SIZES,
    TIGHT,
    Row,
    away_of,
    bound_of,
    largest,
    parts_of,
    plateau,
    probable_cause,
    round_off,
    side_of,
    slope_of,
    unit_of,
    verdict,
)
from sysid.model.sensor_streams import predicted, predicted_back, predicted_derivatives, stream_derivatives, total_delay
from sysid.noise.estimate import declared_noise

_End = tuple[float, Rig, Trace]
"""How far a parameter was taken from its value, the rig there, and its rollout."""


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

    def amount_of_work(self, steps: Sequence[float]) -> int:
        """Number of times that ``on_work`` is called at most."""
        return 2 + 2 * len(self._along) * len(steps)

    def rows(self, steps: Sequence[float]) -> Iterator[Row]:
        """Compare everything, parameter by parameter."""
        scene, along = self._scene, self._along
        self._on_work("forward sensitivities")
        trace, raw = simulate_tangent(scene, self._poses, self._times, along, settings=TIGHT)
        self.trace = trace
        self._on_work("adjoint")
        tape = Tape(scene, self._poses, self._times, TIGHT)
        backward = Backward(tape, along)
        found = {c: self._derivatives(c, raw[c], backward) for c in trace.outputs}
        self._bound = bound_of(self.rig, trace)
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
        for part, columns in parts_of(trace.kinds[channel]):
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
        # Delays and effects of sensors leave the rollout as it is, which the first ones show.
        moves: bool | None = None
        sweep = []
        for step in steps:
            ends = []
            for away in away_of(value, step * size, parameter.lower, parameter.upper):
                self._on_work(direction.name)
                there = with_parameters(self.rig, {direction.name: value + away})
                rolled = self.trace
                if moves is not False:
                    rolled = simulate(build_scene(there), self._poses, self._times, settings=TIGHT)
                ends.append((away, there, rolled))
            moves = any(_unlike(rolled, self.trace) for _, _, rolled in ends) if moves is None else moves
            sweep.append(ends)
        for channel, derivatives in found.items():
            for part, columns in parts_of(self.trace.kinds[channel]):
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
        slopes_found = [slope_of(base, r[0], r[1], *away) for r, away in zip(readings, aways, strict=True)]
        scale = max(largest(ours), min(largest(s) for s in slopes_found))
        errors = tuple(largest(ours - s) / scale if scale > 0.0 else 0.0 for s in slopes_found)
        best = int(np.argmin(errors))
        moves = max(largest(base - base[:1]), 1e-3 * largest(base), self._noise(channel, columns))
        bound, reason = self._bound, ""
        if not np.isfinite(ours[np.isfinite(base)]).all():
            found, reason = "differs", "The sensitivities are not finite where the readings are."
        elif scale == 0.0 or (largest(ours) == 0.0 and scale * size <= NEGLIGIBLE * moves):
            found = "no effect"
        elif scale * size <= NEGLIGIBLE * moves:
            found = "negligible"
        else:
            hidden = ROUND_OFF * round_off(base, readings, aways) / (np.abs(aways)[:, 0] * scale)
            sound = bool(derivatives.adjoint[part][k] <= bound)
            found = verdict(steps, errors, hidden, bound, sound=sound)
            if found == "differs":
                reason = f"Probably {probable_cause(self.rig, self._times, [t for _, _, t in sweep[best]])}"
                side = side_of(ours, scale, base, readings, aways, bound) if sound else None
                if side is not None:
                    found = "one side"
                    reason += f"; the sensitivities are those to the side of {side[0]} of it, to {side[1]:.0e}"
                reason += "."
        return Row(
            direction.name, value, f"{channel} {part}".strip(), unit_of(self.trace.kinds[channel], part), scale * size,
            errors, errors[best], steps[best], plateau(steps, errors), float(derivatives.adjoint[part][k]), bound,
            found, reason,
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


def _unlike(one: Trace, other: Trace) -> bool:
    """Any reading of two rollouts differs, be it by round-off."""
    return any(not np.array_equal(one.outputs[c], other.outputs[c], equal_nan=True) for c in one.outputs)
