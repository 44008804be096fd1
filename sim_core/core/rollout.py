"""A rollout on the compiled core: the whole of it in few calls, steps that its search gives up made by today's.

:mod:`sim_core.core.covers` says what is not for the core. Where mounts are, and readings, are worked out for many
instants at once (:mod:`sim_core.sensing.instants`). A step that the core's fast Newton does not find is made by slower
searches (:mod:`sim_core.core.handover`), and its end is handed back.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.commands import CommandChain, driven_frames
from sim_core.contact.edges import EdgeContact
from sim_core.contact.surface import SurfaceContact
from sim_core.core.handover import SlowSteps
from sim_core.core.library import COUNTS, OutputsStruct, filled, load, pointer_to
from sim_core.core.record import ContactTerm, NumberSlopes, contacts_of, edges_of, record_values, surfaces_of
from sim_core.errors import ConvergenceError
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.carriage import start_state
from sim_core.scene.scene import Frame, Scene
from sim_core.scene.solid_range import LeastVolume, volumes_left
from sim_core.scene.strain_range import check_strains_at
from sim_core.sensing.instants import Instants, InstantsAlong, bearing_nodes, read_all
from sim_core.sensing.observe import Observer, frame_of
from sim_core.simulation import FOREVER_S, SETTLED_AFTER_S, NodePath, Trace, interpolate
from sim_core.solve.integrator import Past
from sim_core.solve.report import NewtonSettings, Result, StepReport
from sim_core.solve.step import State, advance

STATE = ("x", "v", "x_past", "v_past", "anchor", "load", "speed", "rotation", "d_x", "d_v", "d_rotation")
"""Arrays of a state, in the order of ``thinshell_state``."""

CHUNK_BYTES = 3_000_000
"""Memory of what a call returns, up to which it makes several steps; readings are made of it within the cache."""


@dataclass
class Chunk:
    """What some steps in a row came to: ``steps``: which; ``at``, ``along``: states and derivatives at their ends."""

    steps: slice
    at: Instants
    along: InstantsAlong | None


class CoreRollout:
    """A rollout of a scene along frames of its mounts at ``times`` [s] ``(t,)``.

    ``poses``: by end effector; ``numbers``: derivatives of the numbers of the mechanics by p parameters, along which
    the rollout is differentiated; ``moving``: motions of the mounts by these, ``(6, p)`` each, at all times or, one,
    all the time.
    """

    def __init__(
        self,
        scene: Scene,
        poses: Mapping[str, PoseTrajectory],
        times: np.ndarray,
        settings: NewtonSettings,
        numbers: NumberSlopes | None = None,
        moving: Sequence[Mapping[str, np.ndarray]] = (),
    ) -> None:
        self.scene, self._settings, self.times = scene, settings, times
        self.observer = Observer(scene)
        self._library = load().functions
        self._mounts = list(scene.start)
        self.places = self._moved(poses)
        self._bearing = bearing_nodes(self.observer)
        numbers, lanes = numbers or NumberSlopes(), int(self._library.thinshell_lanes())
        self._count, self._columns = numbers.count, -(-numbers.count // lanes) * lanes
        self._record, self._kept = filled(record_values(scene, settings, self._bearing, numbers, self._columns))
        self._handle = self._library.thinshell_make(ctypes.byref(self._record))
        self.contacts = contacts_of(scene)
        self._surfaces, self._edges = surfaces_of(scene), edges_of(scene)
        self._motions = self._motion_table(moving)
        self._tables()
        self.counts = np.zeros(0, dtype=COUNTS)
        self.reports: list[StepReport] = []
        self.handed_over = 0
        """Steps that the core's search gave up."""
        self._slow: SlowSteps | None = None
        self.least_volumes: dict[str, LeastVolume] = {}
        """Where each gel was pressed most."""
        self._seen = np.zeros((0, 3))

    def __del__(self) -> None:
        if getattr(self, "_handle", None):
            self._library.thinshell_free(self._handle)

    def _array(self, name: str) -> np.ndarray:
        """One of the arrays of the state, flat; it is the core's memory, until the next step."""
        size = ctypes.c_int64()
        address = self._library.thinshell_state(self._handle, STATE.index(name), ctypes.byref(size))
        if not size.value:
            return np.zeros(0)
        return np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_double)), (size.value,))

    def _held(self, term: int, which: int, kind: Any = ctypes.c_double) -> np.ndarray:
        """What the points of a contact of surfaces or edges remember (``thinshell_held``), a copy, flat."""
        size = ctypes.c_int64()
        address = self._library.thinshell_held(self._handle, term, which, ctypes.byref(size))
        if not size.value:
            return np.zeros(0, dtype=kind)
        held = np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(kind)), (size.value,))
        return np.array(held)

    @property
    def surfaces_touch(self) -> bool:
        """Whether any contact of surfaces or edges carries a load now."""
        return any(bool(self._held(k, 1).any()) for k in range(len(self._surfaces) + len(self._edges)))

    def _moved(self, poses: Mapping[str, PoseTrajectory]) -> np.ndarray:
        """True origins [m] and rotations of the mounts ``(t, mounts, 12)``."""
        scene, count = self.scene, len(self.times)
        tracks = {name: trajectory.sample(self.times) for name, trajectory in poses.items()}
        driven = None
        if CommandChain(scene.rig):
            commanded = [{name: frame_of(p[k], q[k]) for name, (p, q) in tracks.items()} for k in range(count)]
            driven = driven_frames(scene.rig, commanded, self.times)
        out = np.empty((count, len(self._mounts), 12))
        for m, name in enumerate(self._mounts):
            if driven is not None and name in driven[0]:
                origin = np.stack([f[name][0] for f in driven])
                turn = Rotation.concatenate([f[name][1] for f in driven])
            elif name in tracks:
                origin, turn = tracks[name][0], Rotation.from_quat(tracks[name][1])
            else:
                origin, turn = np.repeat(scene.start[name][0][None], count, axis=0), scene.start[name][1]
            offset = scene.rig.end_effectors[name].offset() if name in scene.rig.end_effectors else np.zeros(6)
            if offset.any():
                origin, turn = origin + turn.apply(offset[:3]), turn * Rotation.from_rotvec(offset[3:])
            out[:, m, :3] = origin
            out[:, m, 3:] = turn.as_matrix().reshape(-1, 9)
        return out

    def frames(self, k: int) -> dict[str, Frame]:
        """True frames of the mounts at an instant."""
        return {
            name: self.scene.start[name]
            if name not in self.scene.rig.end_effectors
            else (self.places[k, m, :3], Rotation.from_matrix(self.places[k, m, 3:].reshape(3, 3)))
            for m, name in enumerate(self._mounts)
        }

    def _motion_table(self, moving: Sequence[Mapping[str, np.ndarray]]) -> np.ndarray | None:
        """Motions of the mounts ``(t or 1, mounts, 6, columns)``; None where none moves."""
        if not any(moving):
            return None
        table = np.zeros((len(moving), len(self._mounts), 6, self._columns))
        for k, motions in enumerate(moving):
            for name, motion in motions.items():
                table[k, self._mounts.index(name), :, : self._count] = motion
        return table

    def _motions_from(self, k: int) -> np.ndarray | None:
        if self._motions is None or len(self._motions) == 1:
            return self._motions
        return self._motions[k:]

    def _tables(self) -> None:
        """Room for what a call returns."""
        nodes, width = len(self.scene.rest), self._columns
        shapes = [(nodes, 3), (nodes, 3), (len(self.contacts), 3)]
        slopes = [(nodes, 3, width), (len(self._bearing), 3, width), (len(self.contacts), 3, width)]
        each = 8 * sum(int(np.prod(s)) for s in shapes + slopes)
        self._room = max(1, min(len(self.times), CHUNK_BYTES // max(each, 1)))
        self._out = [np.zeros((self._room, *s)) for s in shapes + slopes]

    def _outputs(self) -> OutputsStruct:
        return OutputsStruct(*(pointer_to(a) for a in self._out))

    # The start

    def settle(self, start: tuple[np.ndarray, Mapping[str, np.ndarray]] | None = None) -> Chunk:
        """Come to rest at the first frames, as :func:`sim_core.simulation.settle` does. ``start``: derivatives of where
        bodies are put."""
        scene, frames = self.scene, self.frames(0)
        x, _ = start_state(scene, frames)
        self._array("x")[:] = x.ravel()
        self._array("rotation")[:] = np.concatenate([t.rotation_target.ravel() for t in self.contacts] or [np.zeros(0)])
        if start is not None:
            self._put(*start)
        dt = 1e-3
        while dt < SETTLED_AFTER_S:
            if self._settling_step(dt, frames, inertia=True):
                dt *= 3.0
            elif dt > 1e-6:
                dt /= 4.0
            else:
                raise ConvergenceError(
                    "The rig finds no equilibrium under gravity at its start pose.",
                    "Check that bodies do not overlap at the start, and that every body is held.",
                )
        self._settling_step(FOREVER_S, frames, inertia=False, check=True)
        self._library.thinshell_rest(self._handle, 0)
        return self._chunk(slice(0, 1))

    def _put(self, d_x: np.ndarray, rotations: Mapping[str, np.ndarray]) -> None:
        self._array("d_x").reshape(-1, self._columns)[:, : self._count] = d_x.reshape(-1, self._count)
        d_rotation = self._array("d_rotation").reshape(-1, 9, self._columns)
        for c, term in enumerate(self.contacts):
            if term.name in rotations:
                d_rotation[c, :, : self._count] = rotations[term.name]

    def _settling_step(self, dt: float, frames: Mapping[str, Frame], inertia: bool, check: bool = False) -> bool:
        self._library.thinshell_rest(self._handle, 0)
        places, length = np.ascontiguousarray(self.places[:1]), np.array([dt])
        made, _ = self._call(1, length, places, self._motions_from(0), None, inertia)
        if made:
            return True
        system, kept = self.scene.system, self.scene.system.inertia
        try:
            system.inertia = inertia
            before = self.state_now(-dt)
            targets = self.scene.targets(frames)
            after, report = advance(system, before, targets, dt, self._settings, check=check)
        finally:
            system.inertia = kept
        if report.converged:
            self._accept(dt, places[0], self._motions_from(0), after.x, inertia)
        return report.converged

    # Steps

    def run(self, beside: NodePath | None = None) -> Iterator[Chunk]:
        """All steps, some at a time."""
        count, done = len(self.times), 1
        lengths = np.diff(self.times)
        moves = None if beside is None else self._moves(beside)
        inertia = self.scene.system.inertia
        while done < count:
            ask = min(self._room, count - done)
            made, counts = self._call(
                ask,
                np.ascontiguousarray(lengths[done - 1 : done - 1 + ask]),
                np.ascontiguousarray(self.places[done : done + ask]),
                self._motions_from(done),
                None if moves is None else np.ascontiguousarray(moves[done - 1 : done - 1 + ask]),
                inertia,
            )
            self.reports += self._reports(counts[:made])
            self.counts = np.concatenate([self.counts, counts[:made]])
            if made:
                yield self._chunk(slice(done, done + made))
                done += made
            if made < ask:
                self._make_slowly(done, float(lengths[done - 1]), inertia)
                yield self._chunk(slice(done, done + 1))
                done += 1

    def press(self, chunk: Chunk) -> None:
        """Take note of what is left of gels' volumes; steps after which nothing is left are refused by the slower
        searches."""
        for k, x in enumerate(chunk.at.x, chunk.steps.start):
            if k:
                for found in volumes_left(self.scene, self._seen, x, float(self.times[k - 1] - self.times[0])):
                    if found.body not in self.least_volumes or found.ratio < self.least_volumes[found.body].ratio:
                        self.least_volumes[found.body] = found
            self._seen = x

    def _moves(self, beside: NodePath) -> np.ndarray | None:
        """How nodes move in each step of a rollout near by ``(t - 1, n, 3)``; None where it has not the same nodes."""
        if beside.positions.shape[1:] != self.scene.rest.shape:
            return None
        return np.diff(interpolate(beside.times, beside.positions, self.times), axis=0)

    def _call(
        self,
        count: int,
        lengths: np.ndarray,
        places: np.ndarray,
        motions: np.ndarray | None,
        moves: np.ndarray | None,
        inertia: bool,
    ) -> tuple[int, np.ndarray]:
        counts = np.zeros(count, dtype=COUNTS)
        made = self._library.thinshell_steps(
            self._handle,
            count,
            pointer_to(lengths),
            pointer_to(places),
            None if motions is None else pointer_to(motions),
            int(motions is not None and self._motions is not None and len(self._motions) > 1),
            None if moves is None else pointer_to(moves),
            int(inertia),
            ctypes.byref(self._outputs()),
            pointer_to(counts),
        )
        return int(made), counts

    def _accept(
        self, dt: float, places: np.ndarray, motions: np.ndarray | None, there: np.ndarray, inertia: bool
    ) -> None:
        there = np.ascontiguousarray(there)
        self._library.thinshell_accept(
            self._handle,
            dt,
            pointer_to(np.ascontiguousarray(places)),
            None if motions is None else pointer_to(motions),
            pointer_to(there),
            int(inertia),
            ctypes.byref(self._outputs()),
        )

    def potential(
        self, dt: float, there: np.ndarray, k: int = 0, exact: bool = True
    ) -> tuple[float, np.ndarray, np.ndarray]:
        """Of a step of ``dt`` [s] from the present state to the frames of instant ``k``, at ``there`` [m] ``(n, 3)``:
        energy [J], gradient [N] ``(n, 3)`` and Hessian [N/m] ``(3 n, 3 n)``, all nodes free."""
        energy, gradient, hessian = np.zeros(1), np.zeros_like(there), np.zeros((there.size, there.size))
        there, places = np.ascontiguousarray(there), np.ascontiguousarray(self.places[k : k + 1])
        found = (pointer_to(energy), pointer_to(gradient), pointer_to(hessian))
        inertia = int(self.scene.system.inertia)
        at = (pointer_to(places), pointer_to(there))
        self._library.thinshell_potential(self._handle, dt, *at, inertia, int(exact), *found)
        return float(energy[0]), gradient, hessian

    def _make_slowly(self, k: int, dt: float, inertia: bool) -> None:
        """Make the step to an instant with today's searches."""
        self.handed_over += 1
        if self._slow is None:
            self._slow = SlowSteps(self.scene, self._settings)
        begun = float(self.times[k - 1])
        self._slow.begin(self.state_now(begun - float(self.times[0])), self.frames(k - 1))
        report = self._slow.step(self.frames(k), dt)
        before, after = self._motions_from(k - 1), self._motions_from(k)
        since = 0.0
        for part, frames, there in self._slow.parts:
            since += part
            places = np.concatenate([np.r_[frames[m][0], frames[m][1].as_matrix().ravel()] for m in self._mounts])
            motions = after
            if before is not None and after is not None and self._motions is not None and len(self._motions) > 1:
                share = since / dt  # turns of the mounts are small in a step, and so is what this leaves out
                motions = np.ascontiguousarray((1.0 - share) * before[:1] + share * after[:1])
            self._accept(part, places, motions, there, inertia)
        self.reports.append(report)
        self.counts = np.concatenate([self.counts, np.zeros(1, dtype=COUNTS)])

    def state_now(self, t: float) -> State:
        """The state as the terms have it, at a time [s]."""
        state, shape = {name: self._array(name).copy() for name in STATE[:8]}, self.scene.rest.shape
        x, v, x_past, v_past = (state[n].reshape(shape) for n in STATE[:4])
        internals, at = self.scene.system.initial_internals(), 0
        for c, term in enumerate(self.contacts):
            own = slice(at, at + len(term.areas))
            at = own.stop
            internals[term.name] = {
                "rotation": state["rotation"].reshape(-1, 3, 3)[c],
                "anchor": state["anchor"].reshape(-1, 3)[own],
                "load": state["load"][own],
                "slip_speed": state["speed"][own],
            }
        others: list[SurfaceContact | EdgeContact] = [*self._surfaces, *self._edges]
        for k, other in enumerate(others):
            anchor, load, speed = (self._held(k, which) for which in range(3))
            held = {"anchor": anchor.reshape(-1, 3), "load": load, "slip_speed": speed}
            if k >= len(self._surfaces):
                held["pair"] = self._held(k, 3, ctypes.c_int64).astype(float)
            internals[other.name] = held
        since = float(self._library.thinshell_past(self._handle))
        return State(t, x, v, internals, Past(x_past, v_past, since) if since else None)

    def _reports(self, counts: np.ndarray) -> list[StepReport]:
        terms: list[ContactTerm] = [*self.contacts, *self._surfaces, *self._edges]
        names = [term.name for term in terms] + [""]  # the last one where no contact is the tightest
        return [
            StepReport(Result.CONVERGED, iterations, factorisations, tries, residual, update, contacts, gap, names[at])
            for iterations, factorisations, tries, _, contacts, at, residual, update, gap in counts.tolist()
        ]

    # What steps came to

    def _chunk(self, steps: slice) -> Chunk:
        """The states at the ends of the steps that were made last."""
        count, p = steps.stop - steps.start, self._count
        x, force, moment, d_x, d_force, d_moment = (a[:count] for a in self._out)
        places = {
            name: (self.places[steps, m, :3], self.places[steps, m, 3:].reshape(-1, 3, 3))
            for m, name in enumerate(self._mounts)
        }
        nodes = [t.body_node for t in self.contacts]
        at = Instants(places, x.copy(), force.copy(), [(n, moment[:, c]) for c, n in enumerate(nodes)])
        if not p:
            return Chunk(steps, at, None)
        moved = {}
        if self._motions is not None:
            table = self._motions if len(self._motions) == 1 else self._motions[steps]
            table = np.broadcast_to(table, (count, *table.shape[1:]))
            moved = {name: table[:, m, :, :p] for m, name in enumerate(self._mounts) if table[:, m].any()}
        turned = [(n, d_moment[:, c, :, :p]) for c, n in enumerate(nodes)]
        return Chunk(steps, at, InstantsAlong(moved, d_x[..., :p], self._bearing, d_force[..., :p], turned))


def simulate_compiled(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    on_step: Callable[[int, int], None] | None,
    settings: NewtonSettings | None,
    *,
    keep_path: bool,
    beside: NodePath | None,
) -> Trace:
    """As :func:`sim_core.simulate.simulate`, on the core."""
    rollout = CoreRollout(scene, poses, times, settings or NewtonSettings())
    parts, path = [], []

    def take(chunk: Chunk) -> None:
        parts.append(read_all(rollout.observer, scene.rig, chunk.at))
        if keep_path:
            path.append(chunk.at.x)
        tell(scene, rollout, chunk, on_step)

    take(rollout.settle())
    for chunk in rollout.run(beside):
        take(chunk)
    outputs = {c: np.concatenate([p[c] for p in parts]) for c in parts[0]}
    return trace_of(rollout, outputs, path)


def tell(scene: Scene, rollout: CoreRollout, chunk: Chunk, on_step: Callable[[int, int], None] | None) -> None:
    """Warn of strains, watch volumes, and report progress."""
    rollout.press(chunk)
    if chunk.steps.start == 0:
        return
    check_strains_at(scene, rollout.times[chunk.steps] - rollout.times[0], chunk.at.x)
    if on_step is not None:
        for k in range(chunk.steps.start, chunk.steps.stop):
            on_step(k, len(rollout.times) - 1)


def trace_of(rollout: CoreRollout, outputs: dict[str, np.ndarray], path: list[np.ndarray]) -> Trace:
    """The trace of a rollout that was made."""
    kept = NodePath(rollout.times, np.concatenate(path)) if path else None
    observer = rollout.observer
    return Trace(
        rollout.times,
        outputs,
        observer.kinds,
        observer.ids,
        tuple(rollout.reports),
        None,
        kept,
        None,
        tuple(rollout.least_volumes.values()),
    )
