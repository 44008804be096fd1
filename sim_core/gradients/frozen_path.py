"""Responses of a rollout to amendments of finite size, along its frozen path.

A law with a threshold (yield, static friction, pull-off) has no derivative where it vanishes, and a rollout for each
law and each size costs too much to look at a library of them. The amended law is therefore evaluated at its finite size
on the path x_n that the baseline has taken, with its own internal variables carried along that path,

    dF_n = F'(x_n; x_{n-1}, z'_{n-1}) - F(x_n; x_{n-1}, z_{n-1}),

and dF_n is propagated by the linearised steps of the baseline (:mod:`sim_core.gradients.step`), whose factors are there
already: one evaluation of the law and one back-substitution a step, instead of a rollout. The result is exact to first
order in dF and of any order in the size of the law on the given path (a secant, not a derivative). What the law would
change by taking another path, a contact made or lost for one, is left out.

A parameter may also change in time: a modulus E (1 + a f(t)), a hand that is off by a f(t). What that does is the
parameter's derivative of each step, weighed by the course f at its end.

An end effector that gives way moves by its compliance times the load that the baseline puts on it, which is propagated
like any motion of a mount.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sim_core.energies.term import DynamicTerm, Internals, StepContext, Term
from sim_core.gradients.boundary_motion import Motions, driven
from sim_core.gradients.directions import Direction, command_motions
from sim_core.gradients.parameter_jacobian import Column, moment_on_body
from sim_core.gradients.step import LinearStep, Motion, Outcome
from sim_core.gradients.tangent import TangentSimulation, recorded
from sim_core.permanent_state import PermanentState, lasting
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame, Scene, Values
from sim_core.sensing.observe import frame_of
from sim_core.simulate import NodePath, Simulation, Trace
from sim_core.solve.integrator import step_context
from sim_core.solve.reactions import reactions
from sim_core.solve.report import StepReport
from sim_core.solve.step import State


@dataclass
class Amendment:
    """A rig with laws that the baseline lacks. ``scene``: built with these laws, of the same nodes; several amendments
    of different size may share it."""

    name: str
    rig: Rig
    scene: Scene
    values: Values = field(init=False)
    internals: dict[str, Internals] = field(init=False, default_factory=dict)
    affected: tuple[str, ...] = field(init=False, default=())
    compliance: Mapping[str, np.ndarray] = field(init=False, default_factory=dict)
    kept: Mapping[str, Internals] = field(init=False, default_factory=dict)
    _searches: bool = field(init=False, default=False)

    @property
    def lasting(self) -> Mapping[str, tuple[str, ...]]:
        """Names of internal variables that last, of terms that differ from the baseline's or not."""
        return lasting(self.scene)

    def keep(self) -> None:
        """Begin the next rollout with the internal variables that last as they are now."""
        self.kept = {
            t: {n: self.internals[t][n] for n in own} for t, own in self.lasting.items() if t in self.internals
        }

    def begin(self, baseline: Scene, left: PermanentState | None) -> None:
        """Find what differs from the baseline, and forget what was remembered but for what an earlier rollout of the
        baseline has ``left``, and what was kept."""
        self.scene.use(self.rig)
        self.values = self.scene.values(self.rig)
        own = baseline.values(baseline.rig)
        terms = {t.name: t for t in self.scene.system.terms}
        self.affected = tuple(n for n in terms if n not in own.terms or self.values.terms.get(n) != own.terms[n])
        self.compliance = {m: c for m, c in self.values.compliance.items() if m not in own.compliance}
        virgin = {n: terms[n].initial_internals() for n in self.affected}
        begun = virgin if left is None else left.restored(virgin)
        self.internals = {n: {**own, **self.kept.get(n, {})} for n, own in begun.items()}
        self._searches = any(isinstance(terms[n], DynamicTerm) for n in self.affected)

    def enter(self, scene: Scene, step: StepContext, before: State, after: State, targets: np.ndarray) -> list[Term]:
        """Let the amended terms, which are returned, be at the end of a step that the baseline's ``scene`` has made,
        with what they remembered at its start. ``targets``: of prescribed nodes at its end [m] ``(n, 3)``."""
        if not self.affected:
            return []
        system = self.scene.system
        terms = {t.name: t for t in system.terms}
        wanted = [terms[n] for n in self.affected]
        for term in wanted:
            term.configure(self.values.terms[term.name])
        for name, body in scene.bodies.items():
            self.scene.bodies[name].rotation[:] = body.rotation
        if self._searches:
            internals = {n: self.internals.get(n, before.internals.get(n, {})) for n in terms}
            system.guard(True)
            system.x[:] = before.x
            system.set_targets(targets)
            system.begin_step(replace(step, v_start=(after.x - before.x) / step.dt), internals)
            system.x[:] = after.x
            system.cover()
        else:
            system.x[:] = after.x
            for term in wanted:
                term.begin_step(step, self.internals[term.name])
        return wanted

    def remember(self, term: Term, step: StepContext) -> None:
        """Let the internal variables of an amended term be those at the end of a step that it has entered."""
        self.internals[term.name] = term.end_step(step, self.internals[term.name])


@dataclass(frozen=True)
class Modulation:
    """A parameter that changes in time: number ``direction`` of those that a rollout is differentiated along, by a
    ``course`` of the time [s]."""

    direction: int
    course: Callable[[float], float]


class FrozenPathSimulation(TangentSimulation):
    """A simulation that carries, beside the derivatives by parameters ``along``, the responses to ``amendments`` and to
    ``modulations``, in this order along the last axis of ``derivatives``."""

    def __init__(
        self,
        scene: Scene,
        along: Sequence[Direction],
        amendments: Sequence[Amendment],
        moving: Sequence[dict[str, np.ndarray]] = (),
        modulations: Sequence[Modulation] = (),
        left: PermanentState | None = None,
    ) -> None:
        self._amendments, self._modulations = list(amendments), list(modulations)
        self._first = len(along)
        self._moved_plain: Motions = {}
        self._moved_with: Motions | None = None
        whole = [*along, *_idle(scene.rig, len(self._amendments) + len(self._modulations))]
        for amendment in self._amendments:
            amendment.begin(scene, left)
        super().__init__(scene, whole, None, moving, left)

    def reset(self, frames: Mapping[str, Frame] | None = None) -> None:
        for amendment in self._amendments:
            amendment.begin(self.scene, self.left)
        super().reset(frames)

    @property
    def _depends(self) -> bool:
        return True

    def _pushed(self, linear: LinearStep, motion: Motion, before: State, after: State) -> tuple[Motion, Outcome]:
        count, mine, weights = len(self._along), len(self._amendments), self._weights(after.t if self._made else 0.0)
        columns = self._columns.of_step(linear.step, before.internals, after.internals, linear.terms)
        columns = [*columns, *self._secants(linear.step, before, after)]
        own = np.eye(count)[self._first : self._first + mine]
        slopes = np.vstack([self._slopes @ weights, own])
        if self._moved_now is not self._moved_with:
            self._moved_plain = self._moved_now
        moved = self._yielded(weights)
        follow = driven(self.scene, self.frames, moved, count) if moved else None
        self._moved_now = self._moved_with = moved
        return linear.push(motion, columns, slopes, follow)

    def _weights(self, t: float) -> np.ndarray:
        """From slopes along the directions to those with the modulations ``(count, count)`` at a time [s]."""
        found = np.eye(len(self._along))
        first = self._first + len(self._amendments)
        for k, modulation in enumerate(self._modulations):
            found[modulation.direction, first + k] = modulation.course(t)
        return found

    def _yielded(self, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Motions of the mounts, with what compliant ones give way under the baseline's load."""
        moved = {mount: motion @ weights for mount, motion in self._moved_plain.items()}
        loads: np.ndarray | None = None
        for k, amendment in enumerate(self._amendments):
            for mount, compliance in amendment.compliance.items():
                if loads is None:
                    loads = reactions(self.scene.system)
                load = loads[self.scene.carried(mount)].sum(axis=0)
                motion = np.array(moved.get(mount, np.zeros((6, len(self._along)))))
                motion[:3, self._first + k] += self.frames[mount][1].inv().apply(compliance * load)
                moved[mount] = motion
        return moved

    def _secants(self, step: StepContext, before: State, after: State) -> list[Column]:
        """What each amendment adds to the forces of the step, on the baseline's path."""
        system = self.scene.system
        own = {t.name: t for t in system.terms}
        known: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        targets, found = self.scene.targets(self.frames), []
        for amendment in self._amendments:
            force, moment = np.zeros_like(system.x), {}
            for name, exerted, turned in self._exerted(amendment, step, before, after, targets):
                force += exerted
                if name in own:
                    if name not in known:
                        known[name] = system.gradient_of(own[name]), moment_on_body(own[name])
                    force -= known[name][0]
                    turned = turned - known[name][1]
                    if turned.any():
                        moment[name] = turned
            found.append(Column(force=force, moment=moment))
        return found

    def _exerted(
        self, amendment: Amendment, step: StepContext, before: State, after: State, targets: np.ndarray
    ) -> list[tuple[str, np.ndarray, np.ndarray]]:
        """Force [N] ``(n, 3)`` and moment on its rigid body [N m] of each amended term; what they remember goes on."""
        out = []
        for term in amendment.enter(self.scene, step, before, after, targets):
            out.append((term.name, amendment.scene.system.gradient_of(term), moment_on_body(term)))
            amendment.remember(term, step)
        return out


class RememberingSimulation(Simulation):
    """A simulation along the path of which ``amendments`` remember, without a response to them."""

    def __init__(self, scene: Scene, amendments: Sequence[Amendment], left: PermanentState | None = None) -> None:
        self._amendments = list(amendments)
        super().__init__(scene, left=left)

    def reset(self, frames: Mapping[str, Frame] | None = None) -> None:
        for amendment in self._amendments:
            amendment.begin(self.scene, self.left)
        super().reset(frames)
        for settled in self.settling:
            self._remember(settled.before, settled.after, settled.dt, self.frames)

    def _advance(self, end: Mapping[str, Frame], dt: float) -> StepReport:
        before = self.state
        report = super()._advance(end, dt)
        self._remember(before, self.state, dt, {**self.frames, **end})
        return report

    def _remember(self, before: State, after: State, dt: float, frames: Mapping[str, Frame]) -> None:
        step, targets = step_context(before.x, before.v, dt, before.past, before.t), self.scene.targets(frames)
        for amendment in self._amendments:
            for term in amendment.enter(self.scene, step, before, after, targets):
                amendment.remember(term, step)


def _idle(rig: Rig, count: int) -> list[Direction]:
    """Directions along which no number of the rig changes."""
    return [Direction(f"response {k}", rig, rig, 1.0) for k in range(count)]


def simulate_responses(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    along: Sequence[Direction],
    amendments: Sequence[Amendment],
    modulations: Sequence[Modulation] = (),
    on_step: Callable[[int, int], None] | None = None,
    *,
    keep_path: bool = False,
    beside: NodePath | None = None,
    left: PermanentState | None = None,
) -> tuple[Trace, dict[str, np.ndarray]]:
    """Trace of a rollout, and for every channel ``(n_times, ..., n_along + n_amendments + n_modulations)``: its
    derivatives by the directions, then its responses to the amendments, then to the modulations.

    A direction may also be of finite width, from the baseline to a rig with other numbers or commands; its derivative
    is then the secant in these numbers, and to first order in what they do. Times [s] ``(n_times,)``. ``keep_path``,
    ``beside``, ``left``: as of :func:`sim_core.gradients.tangent.simulate_tangent`, without derivatives by what comes
    after ``along``.
    """
    tracks = {name: trajectory.sample(times) for name, trajectory in poses.items()}
    commanded = [{n: frame_of(p[k], q[k]) for n, (p, q) in tracks.items()} for k in range(len(times))]
    whole = [*along, *_idle(scene.rig, len(amendments) + len(modulations))]
    moving = command_motions(scene.rig, whole, commanded, times)
    if left is not None:
        left = left.along(np.arange(len(along)), len(whole))
    simulation = FrozenPathSimulation(scene, along, amendments, moving, modulations, left)
    simulation.beside = beside
    return recorded(simulation, poses, times, whole, on_step, keep_path=keep_path)
