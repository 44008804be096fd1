"""A scene that is stepped from Python, under end-effector motion, and what its sensors would read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from sim_core.commands import driven_frames
from sim_core.contact_wrenches import contact_wrenches
from sim_core.errors import ConfigError, ConvergenceError
from sim_core.permanent_state import PermanentState, permanent_state
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.carriage import start_state
from sim_core.scene.offset import with_offsets
from sim_core.scene.scene import Frame, Scene
from sim_core.scene.solid_range import LeastVolume, volumes_left
from sim_core.scene.strain_range import check_strains
from sim_core.sensing.observe import Observer, frame_of
from sim_core.solve.integrator import at_start
from sim_core.solve.step import NewtonSettings, State, StepReport, advance
from sim_core.state_history import StateHistory, StateRecorder, pair_forces

MAX_HALVINGS = 5
"""A step that does not converge is retried as 2, 4, ... up to 2^5 shorter ones."""

SETTLED_AFTER_S = 3.0
"""Length of a damped pseudo time step [s] beyond which rest is as good as reached."""

FOREVER_S = 1e9
"""Length of the last step of settling [s]: all that relaxes has relaxed."""


@dataclass(frozen=True)
class NodePath:
    """Where the nodes of a rollout were: ``times`` [s] ``(n,)``, ``positions`` [m] ``(n, N, 3)`` in the order of
    :class:`sim_core.scene.Scene`."""

    times: np.ndarray
    positions: np.ndarray

    def onward(self, state: State, t: float) -> np.ndarray | None:
        """Where a rollout that is near this one, in a ``state``, comes to until ``t`` [s], if both move alike ``(N,
        3)``; None if they have not the same nodes."""
        if self.positions.shape[1:] != state.x.shape:
            return None
        here, there = interpolate(self.times, self.positions, np.array([state.t, t]))
        return np.asarray(state.x + (there - here))


@dataclass(frozen=True)
class Trace:
    """Readings of all channels at the instants of the steps.

    ``times`` [s] ``(n,)``; ``outputs``: channel to ``(n, ...)``; ``kinds``: channel to 'wrench',
    'markers' or 'tracks'; ``ids``: marker numbers; ``reports``: one a step (``n - 1``); ``states``: node positions,
    frames, contact forces and slip at the same instants, where they were asked for, and ``path`` the positions alone.
    ``left``: what bodies keep at the end, None where they keep nothing.
    ``least_volumes``: where gels were pressed most.
    """

    times: np.ndarray
    outputs: dict[str, np.ndarray]
    kinds: dict[str, str]
    ids: dict[str, np.ndarray]
    reports: tuple[StepReport, ...]
    states: StateHistory | None = None
    path: NodePath | None = None
    left: PermanentState | None = None
    least_volumes: tuple[LeastVolume, ...] = ()

    def at(self, channel: str, times: np.ndarray) -> np.ndarray:
        """Readings at any times [s], linear between steps, held at the ends: ``(k, ...)``."""
        return interpolate(self.times, self.outputs[channel], times)


def interpolate(times: np.ndarray, values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Linear interpolation of ``values`` ``(n, ...)`` at the ``times`` [s] ``(n,)`` along the first axis, in their
    unit, held beyond the ends; ``at`` [s] ``(k,)``."""
    if len(times) == 1:
        return np.repeat(values, len(at), axis=0)
    right = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
    share = np.clip((at - times[right - 1]) / (times[right] - times[right - 1]), 0.0, 1.0)
    share = share.reshape(-1, *([1] * (values.ndim - 1)))
    return np.asarray((1.0 - share) * values[right - 1] + share * values[right])


@dataclass(frozen=True)
class Settling:
    """A step on the way to the first equilibrium, from ``before``, at rest, to ``after`` in ``dt`` [s], with or without
    ``inertia``; at its end the system has the ``unknowns`` ``(u,)`` [m]."""

    before: State
    after: State
    dt: float
    inertia: bool
    unknowns: np.ndarray


class Simulation:
    """A scene being stepped. ``frames``: where the mounts are now, offsets of end effectors against their poses
    included; ``halvings``: how often a step was halved since the last reset; ``beside``: the path of a rollout near by,
    from which the search of each step begins. It changes results within the tolerance of the search alone, where a step
    has one solution. ``left``: what an earlier rollout has left of the bodies, which are virgin without."""

    def __init__(
        self,
        scene: Scene,
        settings: NewtonSettings | None = None,
        settle: bool = True,
        left: PermanentState | None = None,
    ) -> None:
        self.scene, self.left = scene, left
        self.observer, self._system = Observer(scene), scene.system
        self._settings = settings or NewtonSettings()
        self._settle = settle
        self.beside: NodePath | None = None
        self.reset()

    def reset(self, frames: Mapping[str, Frame] | None = None) -> None:
        """Back to rest at the start poses (or ``frames``, as told), in equilibrium when everything is held."""
        scene = self.scene
        self._check_scene()
        self.halvings = 0
        self.least_volumes: dict[str, LeastVolume] = {}
        """Where each gel was pressed most since then."""
        self.frames = with_offsets(scene.rig, {**scene.start, **(frames or {})})
        targets = scene.targets(self.frames)
        x, v = start_state(scene, self.frames, self.left)
        scene.system.deflections[:] = 0.0
        virgin = scene.system.initial_internals()
        self.state = State(0.0, x, v, virgin if self.left is None else self.left.restored(virgin))
        scene.system.x[:] = x
        self.settling: tuple[Settling, ...] = ()
        """The way to the equilibrium, if anything settled."""
        if self._settle and scene.all_held:
            self.settling = settle(scene, self.state, targets, self._settings)
            after = self.settling[-1].after
            self.state = State(0.0, after.x, np.zeros_like(after.x), after.internals)
        else:
            scene.system.set_targets(targets)
            scene.system.begin_step(at_start(x, v, scene.rig.solver.dt_s), self.state.internals)

    def step(self, frames: Mapping[str, Frame], dt: float) -> StepReport:
        """Move the mounts to ``frames``, as told, within ``dt`` [s]; halve the step where it does not converge."""
        self._check_scene()
        begin, target = self.frames, {**self.frames, **with_offsets(self.scene.rig, frames)}
        try:
            report = self._step(begin, target, dt, MAX_HALVINGS)
        except ConvergenceError as error:
            raise type(error)(f"{error.problem} {self._unmade(begin, target)}".strip(), error.remedy) from error
        check_strains(self.scene, self.state.t)
        return report

    def _check_scene(self) -> None:
        """Raise if the scene was built anew since the simulation was made."""
        if self._system is not self.scene.system:
            raise ConfigError(
                "A body of the scene was given another shape at rest since the simulation was made.",
                "Make another simulation.",
            )

    def _unmade(self, begin: Mapping[str, Frame], target: Mapping[str, Frame]) -> str:
        """How much of the mounts' motion in a step that failed was made, in words."""
        parts = []
        for mount, (end, _) in target.items():
            whole, left = (1e3 * float(np.linalg.norm(end - frames[mount][0])) for frames in (begin, self.frames))
            if whole > 0.0:
                parts.append(f"{mount} has made {whole - left:.3g} of the {whole:.3g} mm of this step.")
        return " ".join(parts)

    def _step(self, start: Mapping[str, Frame], end: Mapping[str, Frame], dt: float, halvings: int) -> StepReport:
        try:
            report = self._advance(end, dt)
        except ConvergenceError:
            if halvings == 0:
                raise
            self.halvings += 1
            middle = self._between(start, end)
            self._step(start, middle, dt / 2, halvings - 1)
            report = self._step(middle, end, dt / 2, halvings - 1)
        self.frames = dict(end)
        return report

    def _between(self, start: Mapping[str, Frame], end: Mapping[str, Frame]) -> dict[str, Frame]:
        """Frames halfway, to which a step goes first that does not converge."""
        return {m: midway(start[m], end[m]) for m in end}

    def _advance(self, end: Mapping[str, Frame], dt: float) -> StepReport:
        """One step without subdivision."""
        targets = self.scene.targets(end)
        guess = None if self.beside is None else self.beside.onward(self.state, self.state.t + dt)
        after, report = advance(self.scene.system, self.state, targets, dt, self._settings, guess)
        for found in volumes_left(self.scene, self.state.x, after.x, self.state.t):
            if not found.ratio > 0.0:
                raise found.refused()
            if found.body not in self.least_volumes or found.ratio < self.least_volumes[found.body].ratio:
                self.least_volumes[found.body] = found
        self.state = after
        return report

    def actual_frames(self) -> dict[str, Frame]:
        """Frames of the mounts with what compliant ones have given way."""
        frames = dict(self.frames)
        for mount, deflection in zip(self.scene.compliant, self.scene.system.deflections, strict=True):
            origin, rotation = frames[mount]
            frames[mount] = (origin + deflection, rotation)
        return frames

    def permanent_state(self) -> PermanentState | None:
        """What bodies keep of what has happened to them; None where they keep nothing."""
        return permanent_state(self.scene, self.state, self.frames)

    def read(self) -> dict[str, np.ndarray]:
        """Readings of all channels now."""
        return self.observer.read(self.scene.rig, self.actual_frames())

    def contact_forces(self) -> dict[str, np.ndarray]:
        """Force [N] ``(N, 3)`` in the world that each declared contact exerts now on every node of the scene, friction
        included; that on a rigid body is at its nodes. Those of ``scene.bodies[name].nodes`` sum to the force on a
        body."""
        return pair_forces(self)

    def contact_wrenches(self) -> dict[str, np.ndarray]:
        """Force [N] and torque [N m] ``(6,)`` of each declared contact now on the first body that it names, in the
        world and about its origin (:func:`sim_core.contact_wrenches.contact_wrenches`)."""
        return contact_wrenches(self.scene, self.scene.system.x, self.contact_forces())


def settle(scene: Scene, state: State, targets: np.ndarray, settings: NewtonSettings) -> tuple[Settling, ...]:
    """The way to equilibrium under gravity and loads with everything held in place: short, then ever longer damped
    steps, and a last one without inertia. All of them end at the time 0, at which loads are those of the start.
    ``targets`` [m] ``(n, 3)``: positions of what is prescribed."""
    system = scene.system
    inertia = system.inertia
    made: list[Settling] = []
    dt = 1e-3

    def still(dt: float) -> State:
        last = made[-1].after if made else state
        return State(-dt, last.x, np.zeros_like(last.x), last.internals)

    try:
        system.inertia = True
        while dt < SETTLED_AFTER_S:
            before = still(dt)
            after, report = advance(system, before, targets, dt, settings, check=False)
            if report.converged:
                made.append(Settling(before, after, dt, True, system.unknowns()))
                dt *= 3.0
            elif dt > 1e-6:
                dt /= 4.0
            else:
                raise ConvergenceError(
                    "The rig finds no equilibrium under gravity at its start pose.",
                    "Check that bodies do not overlap at the start, and that every body is held.",
                )
        system.inertia = False
        before = still(FOREVER_S)
        after, _ = advance(system, before, targets, FOREVER_S, settings)
        made.append(Settling(before, after, FOREVER_S, False, system.unknowns()))
    finally:
        system.inertia = inertia
    return tuple(made)


def midway(a: Frame, b: Frame) -> Frame:
    """Frame halfway between two."""
    half = Slerp([0.0, 1.0], Rotation.concatenate([a[1], b[1]]))(0.5)
    return 0.5 * (a[0] + b[0]), half


def step_times(start: float, end: float, dt: float) -> np.ndarray:
    """Instants of the steps, ``dt`` apart, from ``start`` to ``end`` [s]: ``(n,)``. The last two share what is left."""
    count = max(1, int(np.ceil((end - start) / dt - 1e-9)))
    times = np.append(start + dt * np.arange(count), end)
    if count > 1:
        times[-2] = 0.5 * (times[-3] + end)
    return times


def run(
    simulation: Simulation,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    on_step: Callable[[int, int], None] | None = None,
    on_reset: Callable[[], None] | None = None,
    *,
    keep_states: bool = False,
    keep_path: bool = False,
) -> Trace:
    """As :func:`sim_core.simulate.simulate`, with a simulation at hand, which is reset first; then ``on_reset`` is
    called. ``times`` [s] ``(n,)``: instants of the steps."""
    tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}

    commanded = [{name: frame_of(p[k], q[k]) for name, (p, q) in tracks.items()} for k in range(len(times))]
    frames = driven_frames(simulation.scene.rig, commanded, times)
    simulation.reset(frames[0])
    if on_reset is not None:
        on_reset()
    recorder = StateRecorder(simulation) if keep_states else None
    readings = [simulation.read()]
    path = [simulation.state.x]
    if recorder is not None:
        recorder.take()
    reports = []
    for k in range(1, len(times)):
        reports.append(simulation.step(frames[k], float(times[k] - times[k - 1])))
        readings.append(simulation.read())
        if keep_path:
            path.append(simulation.state.x)
        if recorder is not None:
            recorder.take()
        if on_step is not None:
            on_step(k, len(times) - 1)
    outputs = {c: np.stack([r[c] for r in readings]) for c in readings[0]}
    states = None if recorder is None else recorder.history()
    kept = NodePath(times, np.stack(path)) if keep_path else None
    left = simulation.permanent_state()
    least = tuple(simulation.least_volumes.values())
    observer = simulation.observer
    return Trace(times, outputs, observer.kinds, observer.ids, tuple(reports), states, kept, left, least)
