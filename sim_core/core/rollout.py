"""A rollout on the compiled core: the whole of it in few calls.

Where mounts are, and readings, are worked out for many instants at once (:mod:`sim_core.sensing.instants`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from sim_core.core.failure import failure_of, unmade
from sim_core.core.library import OutputsStruct
from sim_core.core.mounts import mount_places
from sim_core.core.pointwise import raise_what_was_raised
from sim_core.core.record import ContactTerm
from sim_core.core.record_layout import COUNTS, pointer_to
from sim_core.core.slopes import NumberSlopes
from sim_core.core.state import CoreState
from sim_core.energies.linearised import places, size_of
from sim_core.errors import ConvergenceError
from sim_core.permanent_state import PermanentState, permanent_state
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.carriage import start_state
from sim_core.scene.scene import Frame, Scene
from sim_core.scene.solid_range import LeastVolume, volumes_left
from sim_core.scene.strain_range import check_strains_at
from sim_core.sensing.instants import Instants, InstantsAlong, bearing_nodes
from sim_core.sensing.observe import Observer
from sim_core.solve.report import NewtonSettings, Result, StepReport
from sim_core.solve.state import State
from sim_core.state_history import StateHistory, StateRecorder
from sim_core.threads import end_if_unwanted
from sim_core.trace import FOREVER_S, SETTLED_AFTER_S, NodePath, Trace, interpolate

FINEST = 32
"""Parts of a step that the core makes, at most (include/rollout.hpp)."""

FRUITLESS = 12
"""Damped steps that fail, from which on a balance is looked for at once: from the longest to the shortest of them there
are eleven quarterings, so with more it goes round in circles."""

CHUNK_BYTES = 3_000_000
"""Memory of what a call returns, up to which it makes several steps; readings are made of it within the cache."""


Slopes = tuple[np.ndarray, np.ndarray, Mapping[str, np.ndarray]]
"""Derivatives of the positions and velocities of the nodes at the start ``(n, 3, p)``, and of the rotations of rigid
bodies by their terms ``(9, p)``."""


@dataclass
class Chunk:
    """What some steps in a row came to: ``steps``: which; ``at``, ``along``: states and derivatives at their ends."""

    steps: slice
    at: Instants
    along: InstantsAlong | None


class CoreRollout(CoreState):
    """A rollout of a scene along frames of its mounts at ``times`` [s] ``(t,)``.

    ``poses``: by end effector; ``numbers``: derivatives of the numbers of the mechanics by p parameters, along which
    the rollout is differentiated; ``moving``: motions of the mounts by these, ``(6, p)`` each, at all times or, one,
    all the time. ``keep_states``: as of :func:`sim_core.simulate.simulate`.
    """

    scene: Scene

    def __init__(
        self,
        scene: Scene,
        poses: Mapping[str, PoseTrajectory],
        times: np.ndarray,
        settings: NewtonSettings,
        numbers: NumberSlopes | None = None,
        moving: Sequence[Mapping[str, np.ndarray]] = (),
        keep_states: bool = False,
    ) -> None:
        self._settings, self.times, self.began = settings, times, float(times[0])
        self._states = StateRecorder(scene) if keep_states else None
        self.observer = Observer(scene)
        self._mounts = list(scene.start)
        self._bearing = bearing_nodes(self.observer)
        numbers = numbers or NumberSlopes()
        super().__init__(scene, settings, numbers, self._bearing)
        if keep_states:
            self.keep_forces()
        self.places = mount_places(scene, poses, times)
        self._motions = self._motion_table(moving)
        self._weights = np.ascontiguousarray(numbers.modulations.weights)
        self._tables()
        self.counts = np.zeros(0, dtype=COUNTS)
        self.reports: list[StepReport] = []
        self.least_volumes: dict[str, LeastVolume] = {}
        """Where each gel was pressed most."""
        self._seen = np.zeros((0, 3))
        self.given: State | None = None
        """The state in which it was asked to begin, where it did not settle."""

    def left(self) -> PermanentState | None:
        """What bodies keep of what has happened to them; None where they keep nothing."""
        last, p = len(self.times) - 1, self._count
        state, frames = self.state_now(float(self.times[last]) - self.began), self.frames(last)
        if not p:
            return permanent_state(self.scene, state, frames)
        by_memory = {term: np.zeros((size_of(own), p)) for term, own in state.internals.items()}
        for k, law in enumerate(self._materials):
            at = places(state.internals[law.term])
            for name, value in law.internals(self._remembered(k, derivatives=True)).items():
                by_memory[law.term][at[name].ravel()] = value[..., :p].reshape(-1, p)
        by_x = self._array("d_x").reshape(-1, 3, self._columns)[..., :p].copy()
        return permanent_state(self.scene, state, frames, by_memory, by_x)

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

    def _motions_at(self, k: int) -> np.ndarray | None:
        """Motions of the mounts at an instant ``(1, mounts, 6, columns)``; None where none moves."""
        if self._motions is None or len(self._motions) == 1:
            return self._motions
        return self._motions[k : k + 1]

    def _tables(self) -> None:
        """Room for what a call returns."""
        nodes, width = len(self.scene.rest), self._columns
        whole = nodes + len(self.scene.compliant)  # deflections of mounts stand behind the nodes
        shapes = [(whole, 3), (nodes, 3), (len(self.contacts), 3)]
        slopes = [(whole, 3, width), (len(self._bearing), 3, width), (len(self.contacts), 3, width)]
        slopes.append((len(self._mounts), 6, width))
        each = 8 * sum(int(np.prod(s)) for s in shapes + slopes)
        self._room = 1 if self._states is not None else max(1, min(len(self.times), CHUNK_BYTES // max(each, 1)))
        self._out = [np.zeros((self._room, *s)) for s in shapes + slopes]

    def _outputs(self) -> OutputsStruct:
        return OutputsStruct(*(pointer_to(a) for a in self._out))

    # The start

    def begin(self, state: State) -> Chunk:
        """Begin in a state, at the first frames, in place of settling."""
        CoreState.put(self, state)
        self.given = state
        return self._stand()

    def settle(self, start: Slopes | None = None, left: PermanentState | None = None, balanced: bool = True) -> Chunk:
        """Come to rest at the first frames, as :func:`sim_core.simulation.settle` does; what something does not hold
        stays where it is put, and so does all where it is not to be ``balanced``. ``start``: derivatives of that;
        ``left``: what an earlier rollout has left of bodies. No fewer iterations than by default serve it: a step
        that does without inertia cannot be made in parts."""
        scene, frames = self.scene, self.frames(0)
        x, v = start_state(scene, frames, left)
        if left is not None:
            self._restore(left)
        self._array("x")[:], self._array("v")[:] = x.ravel(), v.ravel()
        self._array("rotation")[:] = np.concatenate([t.rotation_target.ravel() for t in self.contacts] or [np.zeros(0)])
        if start is not None:
            self._put(*start)
        if not (balanced and scene.all_held):
            self._library.thinshell_rest(self._handle, 1)
            return self._stand()
        enough = max(self._settings.max_iterations, NewtonSettings.max_iterations)
        self._library.thinshell_iterations(self._handle, enough)
        dt, failed = 1e-3, 0
        while dt < SETTLED_AFTER_S and failed < FRUITLESS:
            if self._settling_step(dt, inertia=True) is None:
                dt *= 3.0
            elif dt > 1e-6:
                dt, failed = dt / 4.0, failed + 1
            else:
                raise ConvergenceError(
                    "The rig finds no equilibrium under gravity at its start pose.",
                    "Check that bodies do not overlap at the start, and that every body is held.",
                )
        failure = self._settling_step(FOREVER_S, inertia=False)
        if failure is not None:
            raise failure
        self._library.thinshell_iterations(self._handle, self._settings.max_iterations)
        self._library.thinshell_rest(self._handle, 0)
        return self._chunk(slice(0, 1))

    def _stand(self) -> Chunk:
        """What there is where nothing has moved yet."""
        at, out, system = self._first(), ctypes.byref(self._outputs()), self.scene.system
        self._library.thinshell_stand(self._handle, self.scene.rig.solver.dt_s, *at, int(system.inertia), out)
        return self._chunk(slice(0, 1))

    def _put(self, d_x: np.ndarray, d_v: np.ndarray, rotations: Mapping[str, np.ndarray]) -> None:
        for name, slopes in (("d_x", d_x), ("d_v", d_v)):
            self._array(name).reshape(-1, self._columns)[:, : self._count] = slopes.reshape(-1, self._count)
        d_rotation = self._array("d_rotation").reshape(-1, 9, self._columns)
        for c, term in enumerate(self.contacts):
            if term.name in rotations:
                d_rotation[c, :, : self._count] = rotations[term.name]

    def _settling_step(self, dt: float, inertia: bool) -> ConvergenceError | None:
        """Make a step at the first instant; why there is none."""
        end_if_unwanted()
        self._library.thinshell_rest(self._handle, 0)
        counts = np.zeros(1, dtype=COUNTS)
        at, out = self._first(), ctypes.byref(self._outputs())
        made = self._library.thinshell_step(self._handle, dt, *at, int(inertia), out, pointer_to(counts))
        raise_what_was_raised()
        if made:
            return None
        return self._failed(counts[0], 0.0, dt)

    def _first(self) -> tuple[int, int | None, int | None]:
        """Frames, motions and weights at the first instant, for the core."""
        return *self._at(self.places[0], self._motions_at(0)), self._weights_at(0)

    def _weights_at(self, k: int) -> int | None:
        """Weights of the modulations from an instant on, for the core."""
        return pointer_to(self._weights[k:]) if self._weights.size else None

    # Steps

    def run(self, warm_start: NodePath | None = None) -> Iterator[Chunk]:
        """All steps, some at a time."""
        count, done = len(self.times), 1
        lengths = np.diff(self.times)
        moves = None if warm_start is None else self._moves(warm_start)
        inertia = self.scene.system.inertia
        while done < count:
            ask = min(self._room, count - done)
            made, counts = self._call(slice(done, done + ask), lengths, moves, inertia)
            self.reports += self._reports(counts[:made])
            self.counts = np.concatenate([self.counts, counts[:made]])
            if made:
                yield self._chunk(slice(done, done + made))
                done += made
            if made < ask:
                raise self._unmade(done, counts[made])

    def remember(self, k: int) -> None:
        """Keep the state at an instant, if states are kept: the one that the core is in."""
        if self._states is not None:
            state = self.state_now(float(self.times[k]) - self.began)
            self._states.take(state, self.actual_frames(k), self.pair_forces())

    def actual_frames(self, k: int) -> dict[str, Frame]:
        """Frames of the mounts at an instant, the one that the core is at, with what compliant ones have given way."""
        frames = self.frames(k)
        for name, deflection in zip(self.scene.compliant, self.deflections, strict=True):
            frames[name] = frames[name][0] + deflection, frames[name][1]
        return frames

    def history(self) -> StateHistory | None:
        """The states that were kept."""
        return None if self._states is None else self._states.history()

    def press(self, chunk: Chunk) -> None:
        """Take note of what is left of gels' volumes."""
        start, path = chunk.steps.start, chunk.at.x
        if start:
            times = self.times[start - 1 : chunk.steps.stop - 1] - self.began
            for found in volumes_left(self.scene, np.concatenate([self._seen[None], path]), times):
                if found.body not in self.least_volumes or found.ratio < self.least_volumes[found.body].ratio:
                    self.least_volumes[found.body] = found
        self._seen = path[-1]

    def _moves(self, warm_start: NodePath) -> np.ndarray | None:
        """How nodes move in each step of a rollout near by ``(t - 1, n, 3)``; None where it has not the same nodes."""
        if warm_start.positions.shape[1:] != self.scene.rest.shape:
            return None
        return np.diff(interpolate(warm_start.times, warm_start.positions, self.times), axis=0)

    def _call(
        self, steps: slice, lengths: np.ndarray, moves: np.ndarray | None, inertia: bool
    ) -> tuple[int, np.ndarray]:
        """Make the ``steps`` to these instants; how many were made, and what was done in them and in the next one."""
        end_if_unwanted()
        counts = np.zeros(steps.stop - steps.start, dtype=COUNTS)
        own, ends = slice(steps.start - 1, steps.stop - 1), slice(steps.start - 1, steps.stop)
        moving = self._motions is not None and len(self._motions) > 1
        at = self._at(self.places[ends], self._motions[ends] if self._motions is not None and moving else self._motions)
        warm_start = None if moves is None else pointer_to(np.ascontiguousarray(moves[own]))
        times, out = pointer_to(np.ascontiguousarray(lengths[own])), ctypes.byref(self._outputs())
        rest = (int(moving), self._weights_at(own.start), warm_start, int(inertia), out, pointer_to(counts))
        made = int(self._library.thinshell_steps(self._handle, len(counts), times, *at, *rest))
        raise_what_was_raised()
        return made, counts

    @staticmethod
    def _at(places: np.ndarray, motions: np.ndarray | None) -> tuple[int, int | None]:
        """Frames of mounts and their motions, parts of tables that stay as they are, for the core."""
        return pointer_to(places), None if motions is None else pointer_to(motions)

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

    def _reports(self, counts: np.ndarray) -> list[StepReport]:
        names = self._tightest
        return [
            StepReport(Result.CONVERGED, its, factors, tries, residual, update, contacts, gap, names[at], parts=parts)
            for its, factors, tries, _, contacts, at, parts, _, _, residual, update, gap in counts.tolist()
        ]

    @property
    def _tightest(self) -> list[str]:
        """Names of the contacts as counts number them; the last one where none is the tightest."""
        terms: list[ContactTerm] = [*self.contacts, *self._surfaces, *self._edges]
        return [*(term.name for term in terms), ""]

    def _failed(self, counts: np.ndarray, t: float, dt: float) -> ConvergenceError:
        """Why a step of ``dt`` [s] from ``t`` [s] was not found."""
        before, there = (self.table(name, *self.scene.rest.shape, columns=False) for name in ("x", "x_end"))
        return failure_of(self.scene, counts, self._tightest, before, there, t, dt)

    def _unmade(self, k: int, counts: np.ndarray) -> ConvergenceError:
        """Why not all of the step to an instant was found."""
        share, dt = float(counts["made"]) / FINEST, float(self.times[k] - self.times[k - 1])
        error = self._failed(counts, float(self.times[k - 1]) - self.began + share * dt, dt / FINEST)
        return type(error)(f"{error.problem} {unmade(self.frames(k - 1), self.frames(k), share)}".strip(), error.remedy)

    # What steps came to

    def _chunk(self, steps: slice) -> Chunk:
        """The states at the ends of the steps that were made last."""
        count, p = steps.stop - steps.start, self._count
        x, force, moment, d_x, d_force, d_moment, motion = (a[:count] for a in self._out)
        places = {
            name: (self.places[steps, m, :3], self.places[steps, m, 3:].reshape(-1, 3, 3))
            for m, name in enumerate(self._mounts)
        }
        nodes, size = [t.body_node for t in self.contacts], len(self.scene.rest)
        for k, name in enumerate(self.scene.compliant):
            places[name] = places[name][0] + x[:, size + k], places[name][1]
        at = Instants(places, x[:, :size].copy(), force.copy(), [(n, moment[:, c]) for c, n in enumerate(nodes)])
        if not p:
            return Chunk(steps, at, None)
        table = motion.copy()
        if self._motions is not None:
            table += self._motions if len(self._motions) == 1 else self._motions[steps]
        for k, name in enumerate(self.scene.compliant):
            table[:, self._mounts.index(name), :3] += np.swapaxes(places[name][1], 1, 2) @ d_x[:, size + k]
        moved = {name: table[:, m, :, :p] for m, name in enumerate(self._mounts) if table[:, m].any()}
        turned = [(n, d_moment[:, c, :, :p]) for c, n in enumerate(nodes)]
        return Chunk(steps, at, InstantsAlong(moved, d_x[:, :size, :, :p], self._bearing, d_force[..., :p], turned))


def tell(scene: Scene, rollout: CoreRollout, chunk: Chunk, on_step: Callable[[int, int], None] | None) -> None:
    """Warn of strains, watch volumes, and report progress."""
    rollout.press(chunk)
    if chunk.steps.start == 0:
        return
    check_strains_at(scene, rollout.times[chunk.steps] - rollout.began, chunk.at.x)
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
        rollout.history(),
        kept,
        rollout.left(),
        tuple(rollout.least_volumes.values()),
    )
