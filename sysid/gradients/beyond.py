"""The adjoint by what is no parameter of a rig, against central differences of whole rollouts: the poses of the end
effectors at every time, the state in which the first step starts, and fields over elements, hinges and nodes.

Each is changed along one random direction, all its numbers at once, and compared are the derivatives of random sums
of the readings of a channel. There are no forward sensitivities by these, so nothing but the differences speaks for the
adjoint, and what they cannot tell apart from round-off or a jump is judged by stricter rules.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.contact.edges import EdgeContact
from sim_core.contact.rigid import RigidContact
from sim_core.contact.surface import SurfaceContact
from sim_core.effects import amended
from sim_core.energies.term import Internals
from sim_core.errors import ConfigError, nearest_match
from sim_core.gradients import Backward, Tape
from sim_core.gradients.gradient import Gradient
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene import build_scene
from sim_core.simulate import Simulation, Trace, run, simulate, step_times
from sim_core.solve.step import State
from sim_core.solve.system import System
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
from sysid.noise.estimate import declared_noise

KINDS = ("poses", "start", "fields")

SUMS = 4
"""Random sums of the readings of a channel; the largest error counts."""

SHIFT_M, TURN_RAD = 1e-5, 1e-4
"""Standard deviation of changes of a pose at step 1; small, since each time has one of its own."""

NODE_M, SPEED_M_S = 1e-4, 1e-2
"""Of a position, at rest or at the start, and of a velocity."""

RATIO, ANGLE_RAD, DAMPING = 0.1, 0.1, {"mass_damping_per_s": 1.0, "stiffness_damping_s": 1e-3}
"""Of Poisson's ratio, of a rest angle and of a damping that is zero; of other fields as much as their values."""

MEMORY = {"plastic_curvature": 1.0, "stress": 10.0}
"""Of internal variables [1/m, Pa] at the start, by the last part of their names."""

MIDDLE, EDGE = (1.0, -1.0), (1.0, 2.0)
"""Shares of a step at which differences look: to both sides, or where a damping is zero to one."""


@dataclass(frozen=True)
class _Way:
    """A direction. ``rolled``: the rollout so many times its length along it; ``along``: the gradient's part; ``ends``:
    :data:`MIDDLE` or :data:`EDGE`; ``switch``: why the rollout may be at a jump of the derivative, in words."""

    name: str
    rolled: Callable[[float], Trace]
    along: Callable[[Gradient], float]
    ends: tuple[float, float] = MIDDLE
    switch: str = ""


@dataclass(frozen=True)
class _Change:
    """A change of the state that the first step starts from: of positions, by which springs of friction stretch, and
    velocities ``(n, 3)``, and of some internal variables by term and name."""

    places: np.ndarray
    speeds: np.ndarray
    memory: dict[str, Internals]

    def of(self, state: State, system: System, dt: float, share: float) -> State:
        """A state so many times the change away."""
        internals = _stretched(system, state, share * self.places)
        for name, change in self.memory.items():
            known = internals[name]
            internals[name] = {**known, **{what: known[what] + share * a for what, a in change.items()}}
        x, v = state.x + share * self.places, state.v + share * self.speeds
        return replace(state, x=x, v=v, internals=internals)

    def along(self, found: Gradient, stretch: dict[str, np.ndarray]) -> float:
        """Derivative along the change. ``stretch``: of the springs of friction, by term."""
        total = np.vdot(found.start_x, self.places) + np.vdot(found.start_v, self.speeds)
        total += sum(np.vdot(found.start_memory[name]["anchor"], a) for name, a in stretch.items())
        for name, change in self.memory.items():
            total += sum(np.vdot(found.start_memory[name][what], a) for what, a in change.items())
        return float(total)


def _stretched(system: System, state: State, move: np.ndarray) -> dict[str, Internals]:
    """Internal variables with the springs of friction on rigid bodies stretched by a move ``(n, 3)`` of the start: else
    what lies on a table would slip when it begins nanometres away, closer than differences can look."""
    if not move.any():
        return state.internals
    rigid = {t.name: t.carried(state.internals[t.name], move) for t in system.terms if isinstance(t, RigidContact)}
    return {**state.internals, **rigid}


def _touching(system: System, state: State) -> np.ndarray:
    """Nodes of surfaces and edges of which some bear on each other, int ``(k,)``."""
    found = [np.empty(0, dtype=int)]
    for term in system.terms:
        if isinstance(term, SurfaceContact | EdgeContact) and state.internals[term.name]["load"].any():
            found.append(term.nodes)
    return np.unique(np.concatenate(found))


class StateGradients:
    """A rig under a motion until ``end`` [s], and some of :data:`KINDS`; ``fields``: names of those that are looked at,
    which may leave out the unit; none: all of them."""

    def __init__(
        self,
        rig: Rig,
        poses: Mapping[str, PoseTrajectory],
        end: float,
        kinds: Sequence[str],
        on_work: Callable[[str], None],
        fields: Sequence[str] = (),
    ) -> None:
        self._rig, self._poses, self._on_work = rig, poses, on_work
        self._times = step_times(0.0, end, rig.solver.dt_s)
        self._kinds = kinds
        self._scene, self._other = build_scene(rig), build_scene(rig)
        every = self._scene.fields.names if "fields" in kinds else ()
        self._fields = [_field_of(every, name) for name in fields] or list(every)

    def amount_of_work(self, steps: Sequence[float]) -> int:
        """Number of times that ``on_work`` is called at most."""
        ways = len(self._poses) + 3 + len(self._fields)
        return 1 + 2 * ways * len(steps)

    def rows(self, steps: Sequence[float]) -> Iterator[Row]:
        """Compare everything, one direction after the other."""
        self._on_work("adjoint")
        tape = Tape(self._scene, self._poses, self._times, TIGHT)
        self._start, self._mounts = tape.start, tape.mounts
        self._backward = Backward(tape, [], self._fields)
        self._known: dict[tuple[str, str, bytes], list[tuple[np.ndarray, Gradient]]] = {}
        for way in self._ways():
            sweep = []
            for h in steps:
                ends = []
                for side in way.ends:
                    self._on_work(way.name)
                    ends.append(way.rolled(side * h))
                sweep.append(ends)
            for channel in tape.trace.outputs:
                for part, columns in parts_of(tape.trace.kinds[channel]):
                    yield self._row(way, channel, part, columns, tape.trace, steps, sweep)

    def _summed(self, channel: str, part: str, columns: slice, seen: np.ndarray) -> list[tuple[np.ndarray, Gradient]]:
        """Weights of random sums of those readings that are ``seen``, and the gradients of the sums."""
        key = (channel, part, seen.tobytes())
        if key not in self._known:
            rng, drawn = np.random.default_rng(0), []
            for _ in range(SUMS):
                weights = np.zeros(seen.shape)
                weights[:, columns] = rng.standard_normal(seen.shape)[:, columns]
                weights[~seen] = weights[0] = 0.0  # the first are before the first step
                drawn.append((weights, self._backward.gradient(0.0, {channel: weights})))
            self._known[key] = drawn
        return self._known[key]

    def _ways(self) -> Iterator[_Way]:
        """All directions."""
        rng = np.random.default_rng(1)
        if "poses" in self._kinds:
            for mount in self._poses:
                move = rng.standard_normal((len(self._times), 6)) * np.repeat([SHIFT_M, TURN_RAD], 3)

                def of_poses(found: Gradient, mount: str = mount, move: np.ndarray = move) -> float:
                    return float(np.vdot(found.poses[mount], move))

                yield _Way(f"poses of {mount}", partial(self._moved, mount, move), of_poses)
        if "start" in self._kinds:
            yield from self._ways_from_the_start(rng)
        for name in self._fields:
            value = self._scene.fields[name]
            along = rng.standard_normal(value.shape) * _size(name, value)
            zero = name.rpartition(".")[2] in DAMPING and not value.any()
            along = np.abs(along) if zero else along

            def of_field(found: Gradient, name: str = name, along: np.ndarray = along) -> float:
                return float(np.vdot(found.fields[name], along))

            ends = EDGE if zero else MIDDLE
            yield _Way(f"field {name}", partial(self._varied, name, value, along), of_field, ends)

    def _ways_from_the_start(self, rng: np.random.Generator) -> Iterator[_Way]:
        """By the state that the first step starts from."""
        system, start = self._other.system, self._start
        drawn = (system.spread_matrix @ rng.standard_normal(system.n_unknowns)).reshape(-1, 3)
        drawn[_touching(system, start)] = 0.0  # for the springs of their friction are not stretched
        none = np.zeros_like(drawn)
        remembered: dict[str, Internals] = {}
        for term, internals in start.internals.items():
            for name, known in internals.items():
                size = MEMORY.get(name.rpartition(".")[2])
                if size is not None:
                    remembered.setdefault(term, {})[name] = size * rng.standard_normal(known.shape)
        ways = [("positions", _Change(NODE_M * drawn, none, {}))]
        if self._rig.solver.inertia:
            ways.append(("velocities", _Change(none, SPEED_M_S * drawn, {})))
        if remembered:
            ways.append(("memory", _Change(none, none, remembered)))
        for what, change in ways:
            stretched = _stretched(system, start, change.places)
            stretch = {
                name: stretched[name]["anchor"] - known["anchor"]
                for name, known in start.internals.items()
                if "anchor" in known
            }
            name, along = f"{what} at the start", partial(change.along, stretch=stretch)
            yield _Way(name, partial(self._begun, change), along, switch=self._at_yield())

    def _at_yield(self) -> str:
        """Whether sheets have yielded on their way to the first equilibrium, in words."""
        accumulated = [i["accumulated_curvature"] for i in self._start.internals.values() if "plastic_curvature" in i]
        count = sum(int(np.count_nonzero(a)) for a in accumulated)
        return f"{count} triangles have yielded before the first step and are just at yield." if count else ""

    def _moved(self, mount: str, move: np.ndarray, share: float) -> Trace:
        """The rollout with the true poses of an end effector moved in their own frames, ``move`` ``(n_times, 6)``."""
        positions, quaternions = self._poses[mount].sample(self._times)
        nominal = Rotation.from_quat(quaternions)
        offset = amended(self._rig).end_effectors[mount].offset()
        offset_turn = Rotation.from_rotvec(offset[3:])
        true = nominal * offset_turn
        turned = true * Rotation.from_rotvec(share * move[:, 3:])
        places = positions + nominal.apply(offset[:3]) + true.apply(share * move[:, :3])
        back = turned * offset_turn.inv()
        there = PoseTrajectory(self._times, places - back.apply(offset[:3]), back.as_quat())
        return self._rolled({**self._poses, mount: there})

    def _begun(self, change: _Change, share: float) -> Trace:
        """The rollout from another state."""
        simulation = Simulation(self._other, TIGHT)

        def put() -> None:
            simulation.state = change.of(simulation.state, self._other.system, self._rig.solver.dt_s, share)

        return run(simulation, self._poses, self._times, on_reset=put)

    def _varied(self, name: str, value: np.ndarray, along: np.ndarray, share: float) -> Trace:
        """The rollout with another field."""
        self._other.fields[name] = value + share * along
        try:
            return self._rolled(self._poses)
        finally:
            self._other.fields[name] = value

    def _rolled(self, poses: Mapping[str, PoseTrajectory]) -> Trace:
        return simulate(self._other, poses, self._times, settings=TIGHT)

    def _row(
        self,
        way: _Way,
        channel: str,
        part: str,
        columns: slice,
        trace: Trace,
        steps: Sequence[float],
        sweep: Sequence[Sequence[Trace]],
    ) -> Row:
        base = trace.outputs[channel]
        seen = np.isfinite(base) & np.all([np.isfinite(t.outputs[channel]) for ends in sweep for t in ends], axis=0)
        base = np.where(seen, base, 0.0)
        readings = [[np.where(seen, t.outputs[channel], 0.0) for t in ends] for ends in sweep]
        a, b = way.ends
        slopes = [slope_of(base, *pair, a * h, b * h) for pair, h in zip(_pairs(readings), steps, strict=True)]
        bent = [(first - base) - (second - base) * a / b for first, second in _pairs(readings)]
        least = int(np.argmin(steps))
        found, errors, hidden = [], np.zeros(len(steps)), np.zeros(len(steps))
        for weights, gradient in self._summed(channel, part, columns, seen):
            ours = way.along(gradient)
            scale = max(min(float(np.linalg.norm(weights * s)) for s in slopes), abs(ours))
            found.append((abs(ours), float(np.linalg.norm(weights))))
            if scale > 0.0:
                off = np.array([abs(ours - np.vdot(weights, s)) for s in slopes]) / scale
                errors = np.where(np.isnan(off), np.nan, np.maximum(errors, off))
                round_off = ROUND_OFF * _amplified(a, b) * float(np.linalg.norm(weights * bent[least]))
                hidden = np.maximum(hidden, round_off / (np.array(steps) * scale))
        best = int(np.argmin(errors))
        moved = largest(slopes[best][1:, columns])
        there = np.where(seen, base, np.nan)[:, columns]
        noise = np.broadcast_to(declared_noise(self._rig, channel), base.shape[1:2])[columns][0]
        moves = max(largest(there - there[:1]), 1e-3 * largest(there), float(noise))
        bound, reason = bound_of(self._rig, trace), ""
        if not all(np.isfinite(size) for size, _ in found):
            said, reason = "differs", "The gradient is not finite."
        elif moved == 0.0 and not any(size for size, _ in found):
            said = "no effect"
        elif moved <= NEGLIGIBLE * moves and all(size <= NEGLIGIBLE * moves * norm for size, norm in found):
            said = "negligible"
        else:
            said = verdict(steps, list(errors), hidden, bound, alone=True)
            if said == "differs" and way.switch:
                said, reason = "jumps", way.switch
            elif said == "differs":
                reason = f"Probably {probable_cause(self._rig, self._times, sweep[best])}, or the gradient is wrong."
        return Row(
            way.name, None, f"{channel} {part}".strip(), unit_of(trace.kinds[channel], part), moved,
            tuple(float(e) for e in errors), float(errors[best]), steps[best], plateau(steps, list(errors)), None,
            bound, said, reason,
        )  # fmt: skip


def _field_of(names: Sequence[str], given: str) -> str:
    """The field that is named, with or without its unit. Raises ``ConfigError``."""
    found = [name for name in names if given == name or name.startswith(f"{given}_")]
    if len(found) != 1:
        near = nearest_match(f"fields.{given}", [f"fields.{name}" for name in names])
        raise ConfigError(f"There is no field {given!r}.", near)
    return found[0]


def _pairs(readings: Sequence[Sequence[np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Readings at both ends, by step."""
    return [(first, second) for first, second in readings]


def _amplified(a: float, b: float) -> float:
    """Standard deviation of the slope of a parabola through values at 0, ``a`` and ``b`` that have round-off, over that
    of their distance from a straight line; 1 for a step to both sides."""

    def ratio(a: float, b: float) -> float:
        slope = np.array([a**2 - b**2, b**2, -(a**2)]) / (a * b * (b - a))
        bent = np.array([a / b - 1.0, 1.0, -a / b])
        return float(np.linalg.norm(slope) / np.linalg.norm(bent))

    return ratio(a, b) / ratio(*MIDDLE)


def _size(name: str, value: np.ndarray) -> np.ndarray | float:
    """Standard deviation of changes of a field at step 1."""
    quantity = name.rpartition(".")[2]
    if quantity in DAMPING and not value.any():
        return DAMPING[quantity]
    return {"nu": RATIO, "rest_angle_rad": ANGLE_RAD, "rest_m": NODE_M}.get(quantity, value)
