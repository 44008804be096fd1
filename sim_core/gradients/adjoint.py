"""The gradient of a loss over a whole rollout by everything at once: parameters, fields over elements, shapes at rest,
initial state, poses of the mounts.

A loss is a function of the readings of a trace. Its derivatives by the readings are passed back through the sensors
and cameras to positions and forces, for many instants at once, and on the compiled core (include/adjoint.hpp) from step
to step back to the start.

Poses are differentiated by small motions of a commanded mount in its own true frame at every time: translation [m] and
turn [rad], p + R rho and R exp(phi), passed back through what becomes of commands (:mod:`sim_core.commands`); an offset
of an end effector is the sum over time. At the start they take the first equilibrium along, with the way to it.

Where the true derivative jumps it is that of the branch that the rollout took, as in
:mod:`sim_core.gradients.tangent`: both are the same derivative, and agree to round-off.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.commands import commanded_weights
from sim_core.core.adjoint import CoreAdjoint
from sim_core.core.rollout import CHUNK_BYTES
from sim_core.core.slopes import NumberSlopes
from sim_core.energies.linearised import cross, skew, unflatten
from sim_core.gradients.boundary_motion import carried_contacts, carried_freely
from sim_core.gradients.camera_gradients import CameraGradients
from sim_core.gradients.directions import Direction, checked, command_motions, motions, slopes
from sim_core.gradients.fields import FieldGradients
from sim_core.gradients.gradient import MEMORY_MB, Gradient
from sim_core.gradients.losses import Loss, end_memory, in_sight, one_number
from sim_core.gradients.tape import Tape
from sim_core.rigs import Rigid
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.carriage import start_state
from sim_core.scene.scene import Scene
from sim_core.sensing.instants import before_cameras
from sim_core.sensing.instants_pull import InstantWeights, pull_all
from sim_core.solve.step import NewtonSettings
from sim_core.trace import Trace


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
        self._tape, self._along = tape, list(along)
        scene, rollout = tape.scene, tape.rollout
        self._fields = FieldGradients(scene, fields)
        numbers = self._fields.damped(NumberSlopes(*slopes(scene, along)))
        self._adjoint = CoreAdjoint(rollout, numbers, self._fields.curving, bool(self._fields.shapes))
        self._movable = [m for m in scene.start if m in scene.rig.end_effectors]
        self._moved = motions(scene.rig, along)
        self._moving = command_motions(scene.rig, along, tape.commanded, rollout.times)
        self._pictures = CameraGradients(self._along)

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
        tape, adjoint, rollout = self._tape, self._adjoint, self._tape.rollout
        tape.check_scene()
        scene, count = tape.scene, len(rollout.times)
        weights = in_sight(tape.trace, by_readings)
        self._pictures.clear()
        frames = np.zeros((count, len(rollout.mounts), 6))
        adjoint.begin()
        if by_end_memory:
            given = end_memory(tape.end, by_end_memory)
            adjoint.give({name: unflatten(given[name], own) for name, own in tape.end.internals.items()})
        room = max(1, CHUNK_BYTES // (48 * len(scene.rest)))
        for last in range(count, 1, -room):
            first = max(1, last - room)
            adjoint.sweep(first, *self._read(slice(first, last), weights, frames), frames)
        start_x, start_v = adjoint.nodal("x"), adjoint.nodal("v")
        start_memory = adjoint.internals(tape.start.internals)
        if rollout.given is None:
            self._back_to_where_bodies_are_put(weights, frames)
        poses = {name: frames[:, m] for m, name in enumerate(rollout.mounts)}
        found = adjoint.numbers[: len(self._along)] + self._pictures.total()
        for mount, moved in self._moved.items():
            found += poses[mount].sum(axis=0) @ moved
        for k, moving in enumerate(self._moving):
            for mount, moved in moving.items():
                found += poses[mount][k] @ moved
        by_frames = {m: poses[m] for m in self._movable}
        return Gradient(
            value,
            {d.name: float(v) for d, v in zip(self._along, found, strict=True)},
            commanded_weights(scene.rig, tape.commanded, rollout.times, by_frames),
            start_x,
            start_v,
            start_memory,
            tape.trace,
            self._fields.gradients(adjoint),
        )

    def _read(
        self, span: slice, weights: Mapping[str, np.ndarray], frames: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Weights of positions, with deflections, loads and moments at some instants from those of the readings; those
        of the mounts are added to ``frames``."""
        tape, rollout = self._tape, self._tape.rollout
        rig, at = tape.scene.rig, tape.instants(span)
        own = {c: w[span] for c, w in weights.items()}
        found: InstantWeights = pull_all(tape.observer, rig, at, rollout.bearing, own)
        deflected = np.zeros((len(at.x), len(tape.scene.compliant), 3))
        for name, motion in found.frames.items():
            frames[span, rollout.mounts.index(name)] += motion
            if name in tape.scene.compliant:
                there = at.places[name][1]
                deflected[:, tape.scene.compliant.index(name)] = np.einsum("tij,tj->ti", there, motion[:, :3])
        if self._pictures:
            seen = before_cameras(tape.observer, rig, at)
            for k in range(len(at.x)):
                self._pictures.add(
                    {n: p[k] for n, p in seen.items()}, {c: w[k] for c, w in own.items() if np.any(w[k])}
                )
        moments = [found.moments[term.body_node] for term in rollout.contacts]
        x = np.concatenate([found.x, deflected], axis=1)
        return x, found.force, np.stack(moments, axis=1) if moments else np.zeros((len(at.x), 0, 3))

    def _back_to_where_bodies_are_put(self, weights: Mapping[str, np.ndarray], frames: np.ndarray) -> None:
        """Through the first equilibrium, or from where nothing settled, to the mounts at the start."""
        tape, adjoint, scene = self._tape, self._adjoint, self._tape.scene
        x, v = start_state(scene, tape.mounts)
        readings = self._read(slice(0, 1), weights, frames)
        if scene.all_held:
            adjoint.sweep(0, *readings, frames)
        else:
            rotation = np.concatenate([t.rotation_target.ravel() for t in tape.rollout.contacts] or [np.zeros(0)])
            adjoint.stand((x, v, rotation), scene.system.inertia, readings, frames)
        by_x, by_v = adjoint.nodal("x"), adjoint.nodal("v")
        if scene.all_held:
            by_v[:] = 0.0
        self._carry(x, v, by_x, by_v, {m: frames[0, k] for k, m in enumerate(tape.rollout.mounts)})

    def _carry(
        self, x: np.ndarray, v: np.ndarray, by_x: np.ndarray, by_v: np.ndarray, target: Mapping[str, np.ndarray]
    ) -> None:
        """The transpose of :func:`sim_core.gradients.boundary_motion.start_along`: weights of the places and velocities
        ``(n, 3)`` at which bodies are put, and of the rotations of rigid ones, to the motions of the mounts."""
        tape, scene = self._tape, self._tape.scene
        mounts, movable = tape.mounts, set(self._movable)
        turned = self._adjoint.weights("rotation").reshape(-1, 9)
        by_place = by_x.copy()
        free = [c for c in carried_freely(scene, x, mounts) if c.mount in movable]
        for carrier in free:
            turn, nodes, to = mounts[carrier.mount][1].as_matrix(), carrier.nodes, target[carrier.mount]
            weights = carrier.weights[:, None]
            speeds, force, push = (a @ turn for a in (v[nodes], weights * by_x[nodes], weights * by_v[nodes]))
            to[:3] += force.sum(axis=0)
            to[3:] += (cross(carrier.local, force) + cross(speeds, push)).sum(axis=0)
        for carrier in free:
            by_place[carrier.nodes] = 0.0
        followed = scene.system.fold(by_place) * scene.system.prescribed
        self._fields.shapes.put(by_x, followed, mounts)
        for follower in scene.followers:
            if follower.mount not in movable:
                continue
            turn = mounts[follower.mount][1].as_matrix()
            force = (follower.axes * followed[follower.nodes]) @ turn
            target[follower.mount][:3] += force.sum(axis=0)
            target[follower.mount][3:] += cross(follower.local, force).sum(axis=0)
        for body, term in carried_contacts(scene):
            spec = body.spec
            if isinstance(spec, Rigid) and spec.mount in movable:
                turns = np.stack([(body.rotation @ skew(e)).ravel() for e in np.eye(3)], axis=-1)
                k = tape.rollout.contacts.index(term)
                target[spec.mount][3:] += spec.pose.rotation().as_matrix() @ (turns.T @ turned[k])
