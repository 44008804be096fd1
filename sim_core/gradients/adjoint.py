"""The gradient of a loss over a whole rollout by everything at once: parameters, fields over elements, shapes at rest,
initial state, poses of the mounts.

A loss is a function of the readings of a trace. Its derivatives by the readings are pulled back through the sensors
and cameras to positions and forces, and from step to step back to the start (:mod:`sim_core.gradients.step`): one
factorisation and one back-substitution a step, however many parameters there are. Steps that were subdivided are gone
through in their parts. Steps are recorded on a :class:`sim_core.gradients.tape.Tape`.

Poses are differentiated by small motions of a commanded mount in its own true frame at every time: translation [m] and
turn [rad], p + R rho and R exp(phi), passed back through what becomes of commands (:mod:`sim_core.commands`); an offset
of an end effector is the sum over time. At the start they take the first equilibrium along, with the way to it where it
depends on that (:mod:`sim_core.gradients.initial_equilibrium`).

Where the true derivative jumps it is that of the branch that the rollout took, as in
:mod:`sim_core.gradients.tangent`: both are the same derivative, and agree to round-off.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.commands import commanded_weights
from sim_core.energies.linearised import Linearised, cross, skew, times_back, unflatten
from sim_core.energies.term import Internals, StepContext
from sim_core.gradients.boundary_motion import carried_contacts, carried_freely
from sim_core.gradients.camera_gradients import Pictures
from sim_core.gradients.directions import Direction, checked, command_motions, motions, slopes
from sim_core.gradients.elements import Alongs, OwnNumbers
from sim_core.gradients.fields import FieldSums
from sim_core.gradients.losses import Loss, end_memory, in_sight, one_number
from sim_core.gradients.parameter_jacobian import Columns
from sim_core.gradients.step import LinearStep, Pulled, Weights, linearised_terms, no_memory
from sim_core.gradients.step_record import Made
from sim_core.gradients.tape import MEMORY_MB, Tape, backwards
from sim_core.rigs import Rigid
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.observe import Sensed
from sim_core.simulate import Trace, midway
from sim_core.solve.hessian_store import AHEAD
from sim_core.solve.integrator import at_start
from sim_core.solve.reactions import passed_on_by
from sim_core.solve.step import NewtonSettings, State


@dataclass(frozen=True)
class Gradient:
    """``value`` of the loss and its derivatives: ``parameters`` by name; ``poses``: by end effector ``(n_times, 6)``
    [1/m, 1/rad]; ``start_x`` [1/m] and ``start_v`` [s/m]: of the state that the first step starts from, ``(n, 3)``;
    ``start_memory``: of its internal variables (plastic curvature [m], elastic slip of friction [1/m], memory of
    stress), by term and name."""

    value: float
    parameters: dict[str, float]
    poses: dict[str, np.ndarray]
    start_x: np.ndarray
    start_v: np.ndarray
    start_memory: dict[str, Internals]
    trace: Trace
    fields: dict[str, np.ndarray]
    """By name, one value an element or hinge, or a vector a node (:class:`sim_core.scene.fields.Fields`)."""


def simulate_adjoint(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    loss: Loss,
    along: Sequence[Direction],
    *,
    settings: NewtonSettings | None = None,
    memory_mb: float = MEMORY_MB,
    on_step: Callable[[int, int], None] | None = None,
    fields: Sequence[str] = (),
) -> Gradient:
    """Make the rollout at ``times`` [s] ``(n,)``, and the gradient of ``loss`` by the parameters ``along``, the
    ``fields`` and all else.

    ``memory_mb``: bound on the steps that are kept; those of longer rollouts are made twice. Raises ``ConfigError``
    where ``along`` has something else than directions, where the loss is not a number, or its derivatives are not one
    for each reading of a channel.
    """
    along = checked(along)
    tape = Tape(scene, poses, times, settings, memory_mb, on_step)
    value, by_readings = loss(tape.trace)
    return Backward(tape, along, fields).gradient(one_number(value), by_readings)


class Backward:
    """Goes through a tape backwards, for as many losses as there are. Raises ``ConfigError`` if the scene was changed
    since it was recorded."""

    def __init__(self, tape: Tape, along: Sequence[Direction], fields: Sequence[str] = ()) -> None:
        tape.check_scene()
        self._tape, self._scene, self._along = tape, tape.scene, list(along)
        self._observer = tape.observer
        keys, self._slopes = slopes(self._scene, along)
        values = self._scene.values(self._scene.rig)
        self._own = OwnNumbers(self._scene, values, keys)
        self._others = [row for row in range(len(keys)) if row not in self._own.rows]
        self._columns = Columns(self._scene, values, [keys[row] for row in self._others])
        movable = [m for m in self._scene.start if m in self._scene.rig.end_effectors]
        self._followers = [f for f in self._scene.followers if f.mount in movable]
        self._turning = {
            term.name: (body.spec.mount, term, body.spec.pose.rotation().as_matrix())
            for body, term in carried_contacts(self._scene)
            if isinstance(body.spec, Rigid) and body.spec.mount in movable
        }
        self._movable = movable
        self._fields = FieldSums(self._scene, fields)
        self._moved = motions(self._scene.rig, along)
        self._moving = command_motions(self._scene.rig, along, tape.commanded, tape.trace.times)
        self._pictures = Pictures(self._along)

    @property
    def trace(self) -> Trace:
        """The readings of the rollout."""
        return self._tape.trace

    def gradient(
        self,
        value: float,
        by_readings: Mapping[str, np.ndarray],
        by_end_memory: Mapping[str, Mapping[str, np.ndarray]] | None = None,
    ) -> Gradient:
        """Gradient of the loss with these derivatives by the readings, by channel in the shape of ``trace.outputs``.

        ``by_end_memory``: its derivatives by internal variables of terms at the end of the rollout, by term and name in
        the shape of :attr:`Tape.end` (the plastic curvature of a sheet, say). Raises ``ConfigError`` where they are of
        no channel or variable of the rollout, of another shape, or not finite where the reading is in sight, and where
        the scene was changed since it was recorded.
        """
        tape, scene = self._tape, self._scene
        tape.check_scene()
        count = len(tape.trace.times)
        self._by_readings = in_sight(tape.trace, by_readings)
        self._numbers = np.zeros(len(self._slopes))
        self._pictures.clear()
        self._fields.clear()
        zero: np.ndarray = np.zeros_like(scene.rest)
        state: Weights | None = None
        if by_end_memory:
            state = Weights(zero, zero, end_memory(tape.end, by_end_memory))
        poses = [_Frames() for _ in range(count)]
        for first in reversed(tape.segments):
            intervals = tape.intervals(first)
            scene.system.forget()  # whether they were made again or not
            coming = chain(backwards(intervals), tape.kept_before(first))
            _foresee(islice(coming, AHEAD))
            for offset in reversed(range(len(intervals))):
                k = first + offset + 1
                interval = intervals[offset]
                inner: dict[int, _Frames] = {}
                for made in reversed(interval.made):
                    last = made is interval.made[-1]
                    _foresee(islice(coming, 1))
                    state = state or Weights(zero, zero, no_memory(made.after))
                    target = poses[k] if last else inner.setdefault(id(made.frames), _Frames())
                    state = self._through(made, state, k if last else None, target, interval.sensed)
                for middle, start, end in reversed(interval.middles):
                    weights = inner.get(id(middle))
                    if weights is not None:
                        for frames in (start, end):
                            there = inner.setdefault(id(frames), _Frames())
                            weights.halfway(middle, start, end, frames is start, there)
                for frames_id, weights in inner.items():
                    if frames_id not in {id(m) for m, _, _ in interval.middles}:
                        into = poses[k] if frames_id == id(interval.made[-1].frames) else poses[k - 1]
                        into.add(weights)
        state = state or Weights(zero, zero, no_memory(tape.start))
        self._at_start(state, poses[0])
        found = self._slopes.T @ self._numbers + self._pictures.total()
        for mount, moved in self._moved.items():
            found += np.sum([p.of(mount) for p in poses], axis=0) @ moved
        for at, moving in zip(poses, self._moving, strict=False):
            for mount, moved in moving.items():
                found += at.of(mount) @ moved
        by_frames = {m: np.stack([p.of(m) for p in poses]) for m in self._movable}
        return Gradient(
            value,
            {d.name: float(v) for d, v in zip(self._along, found, strict=True)},
            commanded_weights(scene.rig, tape.commanded, tape.trace.times, by_frames),
            state.x,
            state.v,
            {name: unflatten(state.memory[name], internals) for name, internals in tape.start.internals.items()},
            tape.trace,
            self._fields.gradients(),
        )

    def _through(
        self, made: Made, state: Weights, k: int | None, target: _Frames, sensed: Mapping[str, Sensed] | None
    ) -> Weights:
        """Weights before one step from those after it. ``k``: number of the time at its end, if readings are there;
        ``target``: takes the weights of the frames at its end; ``sensed``: derivatives of the readings, if kept."""
        linear = made.linear
        self._come_to(made)
        if linear is None:
            linear = LinearStep(self._scene, self._tape.keeper, made.before, made.after, made.dt)
        if k is not None:
            state = self._read_back(k, made.frames, state, target, sensed)
        columns = self._columns.of_step(linear.step, made.before.internals, made.after.internals, linear.terms)
        pulled = linear.pull(state, columns, self._turning)
        self._collect(pulled, linear.step, linear.terms, made, state, target)
        return pulled.state

    def _come_to(self, made: Made) -> None:
        """Let the system hold as much of the end of a step as it takes to go back through it."""
        linear = made.linear
        if linear is None or self._columns.need_contact(linear.terms):
            made.enter(self._scene)
        elif self._columns.keys or self._own or self._pictures or self._fields:
            self._scene.system.stand_at(made.after.x, made.unknowns)

    def _collect(
        self,
        pulled: Pulled,
        step: StepContext,
        terms: Mapping[str, Linearised],
        made: Made,
        after: Weights,
        target: _Frames,
    ) -> None:
        """Take the weights of numbers, fields, and what followed the mounts. ``after``: of the end of the step;
        ``terms``: as linearised."""
        self._numbers[self._others] += pulled.numbers
        alongs = Alongs(step, made.before.internals, pulled, after.memory)
        if self._own:
            self._numbers[self._own.rows] += self._own.of_step(alongs)
        self._fields.add(alongs, after, terms)
        self._follow(pulled.targets, pulled.turns, made.frames, target)

    def _follow(
        self, targets: np.ndarray, turns: Mapping[str, np.ndarray], frames: Mapping[str, Frame], target: _Frames
    ) -> None:
        """Take the weights of nodes ``(n, 3)`` and turns of bodies that follow the mounts."""
        self._fields.shapes.follow(targets, frames)
        for follower in self._followers:
            rotation = frames[follower.mount][1].as_matrix()
            force = (follower.axes * targets[follower.nodes]) @ rotation
            target.of(follower.mount)[:3] += force.sum(axis=0)
            target.of(follower.mount)[3:] += cross(follower.local, force).sum(axis=0)
        for term, turn in turns.items():
            mount, _, own = self._turning[term]
            target.of(mount)[3:] += own @ turn

    def _read_back(
        self,
        k: int,
        frames: Mapping[str, Frame],
        state: Weights,
        target: _Frames,
        sensed_by: Mapping[str, Sensed] | None = None,
    ) -> Weights:
        """Weights of a state with those that its readings at time number ``k`` add. ``sensed_by``: derivatives of the
        readings, if they were kept; else the system holds the state."""
        given = {c: w[k].ravel() for c, w in self._by_readings.items() if np.any(w[k])}
        if not given:
            return state
        scene, system = self._scene, self._scene.system
        actual = dict(frames)
        for mount, deflection in zip(scene.compliant, system.deflections, strict=True):
            origin, rotation = actual[mount]
            actual[mount] = (origin + deflection, rotation)
        rig = scene.rig
        x, force = state.x.copy(), np.zeros_like(state.x)
        moment: dict[str, np.ndarray] = {}
        unknowns = np.zeros(system.n_unknowns)
        deflections = unknowns[len(unknowns) - system.deflections.size :].reshape(-1, 3)
        sensed_by = sensed_by or self._observer.linearise(rig, actual, given)
        for name, w in given.items():
            sensed = sensed_by[name]
            x += sensed.by_x.back(w).reshape(-1, 3)
            if sensed.by_force is not None:
                force -= sensed.by_force.back(w).reshape(-1, 3)
            for term, by_moment in sensed.by_moment.items():
                moment[term] = moment.get(term, 0.0) + by_moment.T @ w
            by_frame = sensed.by_frame.T @ w
            target.of(sensed.mount)[:] += by_frame
            if sensed.mount in scene.compliant:
                rotation = actual[sensed.mount][1].as_matrix()
                deflections[scene.compliant.index(sensed.mount)] += rotation @ by_frame[:3]
        if self._pictures:
            self._pictures.add(self._observer.before_cameras(actual), given)
        return replace(state, x=x, force=force if force.any() else None, moment=moment, unknowns=unknowns)

    def _at_start(self, state: Weights, target: _Frames) -> None:
        """Through the first equilibrium, or to where everything was put."""
        if self._tape.settling:
            self._settled(state, target)
        else:
            self._put(state, target)

    def _settled(self, state: Weights, target: _Frames) -> None:
        """Through the first equilibrium and, where that depends on it, the way to it."""
        tape, scene = self._tape, self._scene
        for made, linear in tape.way():
            self._come_to(made)
            if made.after is tape.settling[-1].after:
                state = self._read_back(0, tape.mounts, state, target, tape.start_sensed)
            state = replace(state, v=np.zeros_like(state.x), past=None)
            columns = self._columns.of_step(linear.step, made.before.internals, made.after.internals, linear.terms)
            pulled = linear.pull(state, columns, self._turning)
            self._collect(pulled, linear.step, linear.terms, made, state, target)
            state = pulled.state
        self._follow(scene.system.fold(state.x), self._turned(state), tape.mounts, target)
        self._carry(tape.settling[0].before, state.x, np.zeros_like(state.x), target)

    def _turned(self, state: Weights) -> dict[str, np.ndarray]:
        """Weights of small turns of rigid bodies from those of how they stood at the start."""
        found = {}
        for name, (_, term, _) in self._turning.items():
            turned = np.stack([term.rotation @ skew(e) for e in np.eye(3)])
            found[name] = turned.reshape(3, 9) @ state.memory[name][:9]
        return found

    def _put(self, state: Weights, target: _Frames) -> None:
        """Nothing settled: bodies are where their mounts put them, and readings are of there."""
        tape, scene, system = self._tape, self._scene, self._scene.system
        dt = scene.rig.solver.dt_s
        made = Made(replace(tape.start, t=-dt), tape.start, dt, tape.mounts, tape.start_unknowns)
        made.enter(scene)
        state = self._read_back(0, tape.mounts, state, target)
        x, v, numbers = state.x, state.v, np.zeros(len(self._others))
        step = at_start(made.before.x, made.before.v, made.dt)
        force = passed = np.zeros_like(x)
        if state.force is not None:
            force, passed = passed_on_by(system, state.force)
            v = v - system.mass @ passed / made.dt if system.inertia else v
            for k, column in enumerate(self._columns.of_step(step, made.before.internals, made.after.internals, {})):
                parts = ((column.force, force), (column.body, passed))
                numbers[k] = sum(float(np.vdot(by, w)) for by, w in parts if by is not None)
            system.hessian_data(exact=True)
            x = x + system.nodal_product(force)
            if system.inertia:
                x = x - system.mass @ force / made.dt**2
        terms = linearised_terms(system, step, made.before, made.after) if self._fields.shapes else {}
        for term in terms.values():
            x = x + (times_back(term.force_start, force.ravel()) + np.zeros(x.size)).reshape(x.shape)
        turns = self._turned(state)
        unmade = replace(state, memory=no_memory(tape.start))  # nothing was remembered yet
        self._collect(Pulled(state, x, turns, numbers, force, passed), step, terms, made, unmade, target)
        self._carry(tape.start, x, v, target)

    def _carry(self, start: State, x: np.ndarray, v: np.ndarray, target: _Frames) -> None:
        """Take the weights of places and velocities ``(n, 3)`` at the start of what follows the mounts to it alone, or
        is where its shape at rest has it."""
        self._fields.shapes.start(x, self._tape.mounts)
        for carrier in carried_freely(self._scene, start.x, self._tape.mounts):
            turn = self._tape.mounts[carrier.mount][1].as_matrix()
            weights, nodes, to = carrier.weights[:, None], carrier.nodes, target.of(carrier.mount)
            speeds, force, push = (a @ turn for a in (start.v[nodes], weights * x[nodes], weights * v[nodes]))
            to[:3] += force.sum(axis=0)
            to[3:] += (cross(carrier.local, force) + cross(speeds, push)).sum(axis=0)


def _foresee(coming: Iterable[Made]) -> None:
    """Let steps that are gone through next be prepared on a second core, if they are linearised."""
    for made in coming:
        if made.linear is not None:
            made.linear.foresee()


class _Frames:
    """Weights of small motions of mounts in their own frames, ``(6,)`` each."""

    def __init__(self) -> None:
        self._by_mount: dict[str, np.ndarray] = {}

    def of(self, mount: str) -> np.ndarray:
        return self._by_mount.setdefault(mount, np.zeros(6))

    def add(self, other: _Frames) -> None:
        for mount, weights in other._by_mount.items():
            self.of(mount)[:] += weights

    def halfway(
        self,
        middle: Mapping[str, Frame],
        start: Mapping[str, Frame],
        end: Mapping[str, Frame],
        to_start: bool,
        out: _Frames,
    ) -> None:
        """Pass weights of frames halfway on to one of the two that they are between."""
        for mount, weights in self._by_mount.items():
            a, b = start[mount], end[mount]
            own = a if to_start else b
            turn = middle[mount][1].as_matrix().T @ own[1].as_matrix()
            out.of(mount)[:3] += 0.5 * turn.T @ weights[:3]
            for k in range(3):
                ends = []
                for h in (1e-5, -1e-5):
                    turned = (own[0], own[1] * Rotation.from_rotvec(h * np.eye(3)[k]))
                    there = midway(turned, b) if to_start else midway(a, turned)
                    ends.append((middle[mount][1].inv() * there[1]).as_rotvec())
                out.of(mount)[3 + k] += float((ends[0] - ends[1]) @ weights[3:]) / 2e-5
