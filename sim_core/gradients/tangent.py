"""Forward sensitivities of a rollout with respect to parameters, through the implicit steps.

Each step is linearised where it ended (:mod:`sim_core.gradients.step`) and carries the derivative of the state along
every parameter: one factorisation a step, one back-substitution a parameter. The derivatives are those of the
discrete rollout, exact but for round-off and for the slopes of the parameters themselves. Offsets of end effectors
move what follows them, in every step and at the start (:mod:`sim_core.gradients.boundary_motion`).

Where the true derivative jumps (a contact made or lost within the step, the onset of yield, a point that has just
begun to press) it is that of the branch that the rollout took. A number of zero (friction, a share) is differentiated
to the side of more of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.core.covers import covers
from sim_core.gradients.boundary_motion import (
    Motions,
    driven,
    midway_motion,
    start_along,
)
from sim_core.gradients.camera_gradients import Imaging
from sim_core.gradients.directions import Direction, checked, command_motions, motions, slopes, together
from sim_core.gradients.initial_equilibrium import linearised
from sim_core.gradients.on_core import tangent_compiled
from sim_core.gradients.parameter_jacobian import Columns
from sim_core.gradients.step import LinearStep, Motion, Outcome, no_memory
from sim_core.permanent_state import PermanentState, permanent_state
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.carriage import carriers, start_state
from sim_core.scene.scene import Frame, Scene
from sim_core.sensing.observe import frame_of
from sim_core.simulate import NodePath, Simulation, Trace, run
from sim_core.solve.hessian_store import Keeper
from sim_core.solve.integrator import at_start
from sim_core.solve.reactions import passed_on
from sim_core.solve.step import NewtonSettings, State, StepReport


class TangentSimulation(Simulation):
    """A simulation that carries the derivative of its state along several parameters.

    ``mechanical``: derivatives of the readings now, by channel ``(..., n_parameters)``, but for what parameters change
    in cameras alone.
    """

    def __init__(
        self,
        scene: Scene,
        along: Sequence[Direction],
        settings: NewtonSettings | None = None,
        moving: Sequence[Motions] = (),
        left: PermanentState | None = None,
    ) -> None:
        """``moving``: motions of the mounts by the parameters at the start and after every step, beside those of
        offsets (:func:`sim_core.gradients.directions.command_motions`). ``left``: what an earlier rollout along the
        same parameters has left of the bodies."""
        self._along = list(along)
        keys, self._slopes = slopes(scene, along)
        self._columns = Columns(scene, scene.values(scene.rig), keys)
        self._offsets: Motions = motions(scene.rig, along)
        self._moving, self._made = list(moving), 0
        self._moved = self._moved_before = self._moved_at(0)
        self._halves: list[tuple[Mapping[str, Frame], Motions]] = []
        self._keeper = Keeper(scene.system)
        super().__init__(scene, settings, left=left)

    def reset(self, frames: Mapping[str, Frame] | None = None) -> None:
        super().reset(frames)
        count = len(self._along)
        self._made = 0
        self._moved = self._moved_now = self._moved_at(0)
        zero = np.zeros((*self.state.x.shape, count))
        self._motion = Motion(zero, zero, no_memory(self.state, count))
        self.mechanical = self._read_derivatives(None)
        if not self.settling:
            if self._moved or (self.left is not None and self.left.by_internals is not None):
                self._put()
            self._add_what_mounts_bear()
        elif self._depends:
            self._settle_along()

    @property
    def derivatives(self) -> dict[str, np.ndarray]:
        """Derivatives of the readings now, by channel ``(..., n_parameters)``."""
        imaging = Imaging(self._along)
        self.picture(imaging)
        stacked = {name: derivatives[None] for name, derivatives in self.mechanical.items()}
        return {name: found[0] for name, found in with_imaging(stacked, imaging).items()}

    def picture(self, imaging: Imaging) -> None:
        """Take the pictures of now."""
        imaging.take(self.observer, self.scene.rig, self.actual_frames())

    def read(self) -> dict[str, np.ndarray]:
        return self._reading

    @property
    def _depends(self) -> bool:
        """Whether the states depend on the parameters."""
        return bool(self._columns.keys or self._moved or self._moving)

    def _moved_at(self, made: int) -> Motions:
        """Motions of the mounts by the parameters after so many steps."""
        return together(self._offsets, self._moving[made]) if self._moving else self._offsets

    def _start(self) -> Motion:
        """Derivatives of where the mounts put the bodies."""
        scene, count = self.scene, len(self._along)
        start = start_state(scene, self.frames, self.left)
        x, v, rotations = start_along(scene, self.frames, self._moved, start, count)
        memory = no_memory(self.state, count)
        for name, rotation in rotations.items():
            memory[name][:9] = rotation
        return Motion(x, v, memory) if self.left is None else self._start_left(self.left, x, v, memory)

    def _start_left(self, left: PermanentState, x: np.ndarray, v: np.ndarray, memory: dict[str, np.ndarray]) -> Motion:
        """The same with derivatives of what an earlier rollout has left; the mounts moved alike at its end."""
        if left.by_x is not None:
            for name in left.shaped:
                along = carriers(self.scene, name, left)
                for carrier in along:
                    x[carrier.nodes] = 0.0
                for carrier in along:
                    turn = (self.frames[carrier.mount][1] * left.frames[carrier.mount][1].inv()).as_matrix()
                    by = np.einsum("ij,kjp->kip", turn, left.by_x[carrier.nodes])
                    x[carrier.nodes] += carrier.weights[:, None, None] * by
        return Motion(x, v, left.placed(memory, self.scene.system.initial_internals()))

    def permanent_state(self) -> PermanentState | None:
        return permanent_state(self.scene, self.state, self.frames, self._motion.memory, self._motion.x)

    def _settle_along(self) -> None:
        """Derivatives at the first equilibrium."""
        motion = self._start()
        for made, linear in linearised(self.scene, self._keeper, self.settling, self.frames, backwards=False):
            still = Motion(motion.x, np.zeros_like(motion.v), motion.memory)
            motion, outcome = self._pushed(linear, still, made.before, made.after)
        self._motion, self.mechanical = motion, self._read_derivatives(outcome)

    def _put(self) -> None:
        """Derivatives at a start at which nothing settled: bodies are where their mounts put them."""
        system = self.scene.system
        dt, count = self.scene.rig.solver.dt_s, len(self._along)
        self._motion = start = self._start()
        x, v = start.x, start.v
        system.hessian_data(exact=True)
        force = np.zeros_like(x)
        for k in range(count):
            move = np.ascontiguousarray(x[..., k])
            gradient = system.nodal_product(move)
            if system.inertia:
                gradient -= system.mass @ move / dt**2
            body = -(system.mass @ v[..., k]) / dt if system.inertia else np.zeros_like(gradient)
            force[..., k] = gradient + passed_on(system, gradient, body)
        self.mechanical = self._read_derivatives(Outcome(x, force, {}, np.zeros((system.n_unknowns, count))))

    def _add_what_mounts_bear(self) -> None:
        """Derivatives of the loads on mounts at a start that does not depend on the parameters itself."""
        scene, system = self.scene, self.scene.system
        step, frames = at_start(self.state.x, self.state.v, scene.rig.solver.dt_s), self.actual_frames()

        def read(rig: Rig) -> dict[str, np.ndarray]:
            scene.apply(scene.values(rig))
            system.begin_step(step, self.state.internals, search=False)
            return self.observer.read(scene.rig, frames)

        for k, direction in enumerate(self._along):
            high, low = read(direction.high), read(direction.low)
            for name in high:
                self.mechanical[name][..., k] += (high[name] - low[name]) / direction.width
        read(scene.rig)

    def step(self, frames: Mapping[str, Frame], dt: float) -> StepReport:
        self._halves.clear()
        self._made += 1
        self._begun, self._moved_before, self._moved = self.frames, self._moved, self._moved_at(self._made)
        return super().step(frames, dt)

    def _between(self, start: Mapping[str, Frame], end: Mapping[str, Frame]) -> dict[str, Frame]:
        middle = super()._between(start, end)
        ends = ((start, self._motion_at(start)), (end, self._motion_at(end)))
        self._halves.append((middle, midway_motion(middle, *ends)))
        return middle

    def _motion_at(self, frames: Mapping[str, Frame]) -> Motions:
        """Motions of the mounts by the parameters, at the ends of the whole step or halfway."""
        if frames is self._begun:
            return self._moved_before
        return next((moved for halfway, moved in self._halves if halfway is frames), self._moved)

    def _advance(self, end: Mapping[str, Frame], dt: float) -> StepReport:
        before = self.state
        report = super()._advance(end, dt)
        self.frames = {**self.frames, **end}
        self._moved_now = self._motion_at(end)
        if self._depends:
            self._propagate(before, dt)
        else:
            self.mechanical = self._read_derivatives(None)
        return report

    def _propagate(self, before: State, dt: float) -> None:
        """Carry the derivatives over the step of ``dt`` [s] from ``before`` that has just been solved."""
        linear = LinearStep(self.scene, self._keeper, before, self.state, dt)
        self._motion, outcome = self._pushed(linear, self._motion, before, self.state)
        self.mechanical = self._read_derivatives(outcome)

    def _pushed(self, linear: LinearStep, motion: Motion, before: State, after: State) -> tuple[Motion, Outcome]:
        """Derivatives at the end of a step, which the system holds."""
        columns = self._columns.of_step(linear.step, before.internals, after.internals, linear.terms)
        follow = driven(self.scene, self.frames, self._moved_now, len(self._along)) if self._moved else None
        return linear.push(motion, columns, self._slopes, follow)

    def _read_derivatives(self, outcome: Outcome | None) -> dict[str, np.ndarray]:
        """Of all channels, by the parameters, through the state."""
        frames, count = self.actual_frames(), len(self._along)
        self._reading = reading = self.observer.read(self.scene.rig, frames)
        out = {}
        for name, value in reading.items():
            out[name] = np.zeros((*value.shape, count))
        if outcome is not None:
            for name, sensed in self.observer.linearise(self.scene.rig, frames, reading).items():
                total = sensed.by_x @ outcome.x.reshape(-1, count)
                if sensed.by_force is not None:
                    total = total - sensed.by_force @ outcome.force.reshape(-1, count)
                for term, by_moment in sensed.by_moment.items():
                    if term in outcome.moment:
                        total = total + by_moment @ outcome.moment[term]
                total = total + sensed.by_frame @ self._frame_motion(sensed.mount, outcome)
                out[name] = total.reshape(out[name].shape)
        for name, value in reading.items():
            out[name][np.isnan(value)] = np.nan
        return out

    def _frame_motion(self, mount: str, outcome: Outcome) -> np.ndarray:
        """Motion of a mount in its own frame, ``(6, n_parameters)``: of its pose, and what it gives way."""
        count = len(self._along)
        out = np.array(self._moved_now.get(mount, np.zeros((6, count))))
        if mount in self.scene.compliant:
            group = self.scene.compliant.index(mount)
            deflections = outcome.unknowns[len(outcome.unknowns) - 3 * len(self.scene.compliant) :]
            rotation = self.frames[mount][1].as_matrix()
            out[:3] += rotation.T @ deflections.reshape(-1, 3, count)[group]
        return out


def simulate_tangent(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    along: Sequence[Direction],
    on_step: Callable[[int, int], None] | None = None,
    settings: NewtonSettings | None = None,
    *,
    keep_path: bool = False,
    beside: NodePath | None = None,
    left: PermanentState | None = None,
) -> tuple[Trace, dict[str, np.ndarray]]:
    """Trace of a rollout at ``times`` [s] and the derivatives of every channel, ``(n_times, ..., n_parameters)``, in
    the unit of the channel over that of the parameter. Raises ``ConfigError`` where ``along`` has something else than
    directions. ``keep_path``, ``beside``, ``left``: as of :func:`sim_core.simulate.simulate`; what was left has
    derivatives along the same directions."""
    along = checked(along)
    if along and covers(scene, left=left) is None:
        return tangent_compiled(scene, poses, times, along, on_step, settings, keep_path=keep_path, beside=beside)
    tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}
    commanded = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
    moving = command_motions(scene.rig, along, commanded, times)
    simulation = TangentSimulation(scene, along, settings, moving, left)
    simulation.beside = beside
    return recorded(simulation, poses, times, along, on_step, keep_path=keep_path)


def recorded(
    simulation: TangentSimulation,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    along: Sequence[Direction],
    on_step: Callable[[int, int], None] | None = None,
    *,
    keep_path: bool = False,
) -> tuple[Trace, dict[str, np.ndarray]]:
    """Trace of a simulation run at ``times`` [s], and its derivatives ``(n_times, ..., n_parameters)`` by channel."""
    stacked: list[dict[str, np.ndarray]] = []
    imaging = Imaging(along)

    def keep() -> None:
        stacked.append(simulation.mechanical)
        simulation.picture(imaging)

    def record(done: int, total: int) -> None:
        keep()
        if on_step is not None:
            on_step(done, total)

    trace = run(simulation, poses, times, record, on_reset=keep, keep_path=keep_path)
    return trace, with_imaging({c: np.stack([s[c] for s in stacked]) for c in trace.outputs}, imaging)


def with_imaging(mechanical: Mapping[str, np.ndarray], imaging: Imaging) -> dict[str, np.ndarray]:
    """Derivatives ``(n_times, ..., n_parameters)`` by channel with what parameters change in cameras alone."""
    found = {name: derivatives.copy() for name, derivatives in mechanical.items()}
    for name, derivatives in found.items():
        for k, slope in imaging.slopes(name).items():
            derivatives[..., k] += slope
    return found
