"""The adjoint by what is no parameter of a rig, against central differences of whole rollouts: the poses of the end
effectors at every time, the state in which the first step starts, and fields over elements, hinges and nodes.

Each is changed along one random direction, all its numbers at once, and compared is the derivative of a random sum of
the readings of a channel. There are no forward sensitivities by these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.gradients import Backward, Tape
from sim_core.gradients.adjoint import Gradient
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, Trace, run, step_times
from sysid.fit.noise import declared_noise
from sysid.gradients.differences import (
    NEGLIGIBLE,
    ROUND_OFF,
    TIGHT,
    Row,
    bound_of,
    largest,
    parts_of,
    plateau,
    probable_cause,
    slope_of,
    unit_of,
    verdict,
)

KINDS = ("poses", "start", "fields")

SHIFT_M, TURN_RAD = 1e-3, 1e-2
"""Standard deviation of changes of a pose at step 1."""

NODE_M, SPEED_M_S = 1e-4, 1e-2
"""Of a position, at rest or at the start, and of a velocity."""

RATIO, ANGLE_RAD = 0.1, 0.1
"""Of Poisson's ratio and of a rest angle; of other fields as much as their values."""


@dataclass(frozen=True)
class _Way:
    """A direction. ``rolled``: the rollout so many times its length along it; ``along``: the gradient's part."""

    name: str
    rolled: Callable[[float], Trace]
    along: Callable[[Gradient], float]


class Beyond:
    """A rig under a motion until ``end`` [s], and some of :data:`KINDS`."""

    def __init__(
        self,
        rig: Rig,
        poses: Mapping[str, PoseTrajectory],
        end: float,
        kinds: Sequence[str],
        on_work: Callable[[str], None],
    ) -> None:
        self._rig, self._poses, self._on_work = rig, poses, on_work
        self._times = step_times(0.0, end, rig.solver.dt_s)
        self._kinds = kinds
        self._scene, self._other = build_scene(rig), build_scene(rig)

    def amount_of_work(self, steps: Sequence[float]) -> int:
        """Number of times that ``on_work`` is called at most."""
        ways = len(self._poses) + 2 + len(self._scene.fields.names)
        return 1 + 2 * ways * len(steps)

    def rows(self, steps: Sequence[float]) -> Iterator[Row]:
        """Compare everything, one direction after the other."""
        self._on_work("adjoint")
        tape = Tape(self._scene, self._poses, self._times, TIGHT, factors=True)
        names = self._scene.fields.names if "fields" in self._kinds else ()
        backward = Backward(tape, [], names)
        weights, gradients = {}, {}
        for channel, values in tape.trace.outputs.items():
            drawn = np.random.default_rng(0).standard_normal(values.shape)
            drawn[0] = 0.0  # before the first step
            for part, columns in parts_of(tape.trace.kinds[channel]):
                w = np.zeros_like(drawn)
                w[:, columns] = np.where(np.isnan(values), 0.0, drawn)[:, columns]
                weights[channel, part] = w
                gradients[channel, part] = backward.gradient(0.0, {channel: w})
        for way in self._ways(tape):
            sweep = []
            for h in steps:
                ends = []
                for share in (h, -h):
                    self._on_work(way.name)
                    ends.append(way.rolled(share))
                sweep.append(ends)
            for (channel, part), w in weights.items():
                yield self._row(way, channel, part, w, gradients[channel, part], tape.trace, steps, sweep)

    def _ways(self, tape: Tape) -> Iterator[_Way]:
        """All directions."""
        rng = np.random.default_rng(1)
        if "poses" in self._kinds:
            for mount in self._poses:
                move = rng.standard_normal((len(self._times), 6)) * np.repeat([SHIFT_M, TURN_RAD], 3)

                def of_poses(found: Gradient, mount: str = mount, move: np.ndarray = move) -> float:
                    return float(np.vdot(found.poses[mount], move))

                yield _Way(f"poses of {mount}", partial(self._moved, mount, move), of_poses)
        if "start" in self._kinds:
            system = self._scene.system
            drawn = system.spread(rng.standard_normal(system.n_unknowns))
            places, speeds = NODE_M * drawn, SPEED_M_S * drawn
            yield _Way(
                "positions at the start",
                partial(self._begun, places, np.zeros_like(places)),
                lambda found: float(np.vdot(found.start_x, places)),
            )
            if self._rig.solver.inertia:
                yield _Way(
                    "velocities at the start",
                    partial(self._begun, np.zeros_like(speeds), speeds),
                    lambda found: float(np.vdot(found.start_v, speeds)),
                )
        if "fields" in self._kinds:
            for name in self._scene.fields.names:
                value = self._scene.fields[name]
                along = rng.standard_normal(value.shape) * _size(name, value)

                def of_field(found: Gradient, name: str = name, along: np.ndarray = along) -> float:
                    return float(np.vdot(found.fields[name], along))

                yield _Way(f"field {name}", partial(self._varied, name, value, along), of_field)

    def _moved(self, mount: str, move: np.ndarray, share: float) -> Trace:
        """The rollout with the poses of an end effector moved in their own frames, ``move`` ``(n_times, 6)``."""
        positions, quaternions = self._poses[mount].sample(self._times)
        turned = Rotation.from_quat(quaternions)
        there = PoseTrajectory(
            self._times,
            positions + turned.apply(share * move[:, :3]),
            (turned * Rotation.from_rotvec(share * move[:, 3:])).as_quat(),
        )
        return self._rolled({**self._poses, mount: there})

    def _begun(self, places: np.ndarray, speeds: np.ndarray, share: float) -> Trace:
        """The rollout from a state whose nodes, ``(n, 3)``, were put elsewhere."""
        simulation = Simulation(self._other, TIGHT)

        def put() -> None:
            state = simulation.state
            simulation.state = replace(state, x=state.x + share * places, v=state.v + share * speeds)

        return run(simulation, self._poses, self._times, on_reset=put)

    def _varied(self, name: str, value: np.ndarray, along: np.ndarray, share: float) -> Trace:
        """The rollout with another field."""
        self._other.fields[name] = value + share * along
        try:
            return self._rolled(self._poses)
        finally:
            self._other.fields[name] = value

    def _rolled(self, poses: Mapping[str, PoseTrajectory]) -> Trace:
        return run(Simulation(self._other, TIGHT), poses, self._times)

    def _row(
        self,
        way: _Way,
        channel: str,
        part: str,
        weights: np.ndarray,
        gradient: Gradient,
        trace: Trace,
        steps: Sequence[float],
        sweep: Sequence[Sequence[Trace]],
    ) -> Row:
        columns = dict(parts_of(trace.kinds[channel]))[part]
        readings = [[np.nan_to_num(t.outputs[channel]) for t in ends] for ends in sweep]
        base = np.nan_to_num(trace.outputs[channel])

        def slope(at: np.ndarray, pair: Sequence[np.ndarray], h: float) -> np.ndarray:
            return slope_of(at, pair[0], pair[1], h, -h)

        sums = [[np.array([np.vdot(weights, r)]) for r in pair] for pair in readings]
        middle = np.array([np.vdot(weights, base)])
        ours = way.along(gradient)
        products = [weights * slope(base, pair, h) for pair, h in zip(readings, steps, strict=True)]
        scale = min(float(np.linalg.norm(p)) for p in products)
        slopes = [float(slope(middle, pair, h)[0]) for pair, h in zip(sums, steps, strict=True)]
        errors = tuple(abs(ours - slope) / max(scale, 1e-300) if ours or scale else 0.0 for slope in slopes)
        best = int(np.argmin(errors))
        moved = slope(base, readings[best], steps[best])[1:, columns]
        seen = base[:, columns]
        noise = np.broadcast_to(declared_noise(self._rig, channel), base.shape[1:2])[columns][0]
        moves = max(largest(seen - seen[:1]), 1e-3 * largest(seen), float(noise))
        bound, reason = bound_of(self._rig, trace), ""
        if not np.isfinite(ours):
            found, reason = "differs", "The gradient is not finite."
        elif not (ours or scale):
            found = "no effect"
        elif largest(moved) <= NEGLIGIBLE * moves:
            found = "negligible"
        else:
            least = int(np.argmin(steps))
            off = np.linalg.norm(weights * (readings[least][0] - 2.0 * base + readings[least][1]))
            hidden = ROUND_OFF * off / (np.array(steps) * max(scale, 1e-300))
            found = verdict(steps, errors, hidden, bound)
            if found == "differs":
                reason = f"Probably {probable_cause(self._rig, self._times, sweep[best])}."
        return Row(
            way.name, None, f"{channel} {part}".strip(), unit_of(trace.kinds[channel], part), largest(moved), errors,
            errors[best], steps[best], plateau(steps, errors), None, bound, found, reason,
        )  # fmt: skip


def _size(name: str, value: np.ndarray) -> np.ndarray | float:
    """Standard deviation of changes of a field at step 1."""
    quantity = name.rpartition(".")[2]
    return {"nu": RATIO, "rest_angle_rad": ANGLE_RAD, "rest_m": NODE_M}.get(quantity, value)
