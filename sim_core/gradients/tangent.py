"""Forward sensitivities of a rollout with respect to parameters, through the implicit steps.

A step solves R(x'; s, theta) = 0 for the new positions x', given the state s = (x, v, internal
variables) and the parameters, and then updates the internal variables xi' = G(x'; s, theta). Along a
parameter,

    dx' = -H^-1 [dR/ds ds + dR/dtheta],    dxi' = dG/dx' dx' + dG/ds ds + dG/dtheta

with H the true Hessian at the solution (contact, friction and geometric terms included) factorised once
a step. The brackets are directional derivatives along the carried tangent, taken as one-sided
differences of R and G themselves, so every law of every term takes part without code of its own, and
where a law switches the side is that of increasing parameter. One back-substitution and two residuals
a parameter and step, instead of a rollout.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from sim_core.energies.term import Internals, StepContext
from sim_core.rigs import Rig
from sim_core.rigs.trajectory import PoseTrajectory
from sim_core.scene.scene import Frame, Scene, Values
from sim_core.simulate import FOREVER_S, Simulation, Trace, run
from sim_core.solve.integrator import Past, step_context
from sim_core.solve.step import NewtonSettings, State, StepReport

LARGEST_REACH_M = 1e-7
"""Farthest that the neighbouring state of a difference may be from the state itself [m]."""


class TangentSimulation(Simulation):
    """A simulation that carries the derivative of its state along each of several rigs.

    ``neighbours``: rigs of the scene's geometry, each with one parameter changed a little;
    ``steps``: by how much, in the scale in which the derivative is wanted.
    """

    def __init__(
        self,
        scene: Scene,
        neighbours: Sequence[Rig],
        steps: Sequence[float],
        settings: NewtonSettings | None = None,
    ) -> None:
        self._neighbours = list(neighbours)
        self._steps = list(steps)
        self._nominal = scene.values(scene.rig)
        self._amended = [scene.values(rig) for rig in neighbours]
        self._mechanical = [k for k, values in enumerate(self._amended) if not _same(values, self._nominal)]
        super().__init__(scene, settings)

    def reset(self, frames: Mapping[str, Frame] | None = None) -> None:
        super().reset(frames)
        zero = np.zeros_like(self.state.x)
        self._dx = [zero.copy() for _ in self._neighbours]
        self._dv = [zero.copy() for _ in self._neighbours]
        self._dpast = [(zero.copy(), zero.copy()) for _ in self._neighbours]
        self._dxi: list[dict[str, Internals]] = [
            {t: {k: np.zeros_like(a) for k, a in v.items()} for t, v in self.state.internals.items()}
            for _ in self._neighbours
        ]
        self.reading = self.read()
        if self._settle and self.scene.all_held:
            inertia, self.scene.system.inertia = self.scene.system.inertia, False
            try:
                self._propagate(self.state, FOREVER_S, still=True)
            finally:
                self.scene.system.inertia = inertia
        else:
            self.derivatives = self._read_derivatives(self._at_once())

    def _at_once(self) -> dict[int, dict[str, np.ndarray]]:
        """Derivatives of the readings at a start that does not depend on the parameters: what joints bear does."""
        system, found = self.scene.system, {}
        step = step_context(self.state.x, self.state.v, self.scene.rig.solver.dt_s)
        for k in self._mechanical:
            self.scene.apply(self._amended[k])
            system.begin_step(step, self.state.internals, search=False)
            found[k] = self._difference(self._neighbours[k], self._steps[k])
        self.scene.apply(self._nominal)
        system.begin_step(step, self.state.internals, search=False)
        return found

    def _advance(self, end: Mapping[str, Frame], dt: float) -> StepReport:
        before = self.state
        report = super()._advance(end, dt)
        self.frames = {**self.frames, **end}
        self.reading = self.read()
        self._propagate(before, dt, still=False)
        return report

    def _propagate(self, before: State, dt: float, still: bool) -> None:
        """Carry all tangents over the step of ``dt`` [s] from ``before`` that has just been solved.

        ``still``: the step is the first equilibrium, which remembers nothing.
        """
        scene, system = self.scene, self.scene.system
        step = step_context(before.x, before.v, dt, before.past)
        solution, after = system.unknowns(), self.state
        derivatives: dict[int, dict[str, np.ndarray]] = {}
        if self._mechanical:
            base = system.residual().copy()
            factor = system.factor(system.hessian(exact=True), definite=False)
            columns = []
            for k in self._mechanical:
                self._enter(k, before, dt, still)
                system.set_unknowns(solution)
                columns.append((system.residual() - base) / self._steps[k])
            moved = -factor.solve(np.column_stack(columns))
            for column, k in enumerate(self._mechanical):
                h = self._steps[k]
                begun, begun_internals = self._enter(k, before, dt, still)
                system.set_unknowns(solution + h * moved[:, column])
                derivatives[k] = self._difference(self._neighbours[k], h)
                dx = system.spread(moved[:, column])
                if not still:
                    self._dxi[k] = {
                        t: {n: (a - after.internals[t][n]) / h for n, a in v.items()}
                        for t, v in system.end_step(begun, begun_internals).items()
                    }
                    # What velocities are measured from is linear in the states, so their derivatives go the same way.
                    past = Past(*self._dpast[k], before.past.dt) if before.past is not None else None
                    carried = step_context(self._dx[k], self._dv[k], dt, past)
                    self._dpast[k] = self._dx[k], self._dv[k]
                    self._dv[k] = (dx - carried.x_base) / step.tau if system.inertia else np.zeros_like(dx)
                self._dx[k] = dx
                self._bound(k)
            scene.apply(self._nominal)
            system.begin_step(step, before.internals, search=False)
            system.set_unknowns(solution)
        self.derivatives = self._read_derivatives(derivatives)

    def _bound(self, k: int) -> None:
        """Keep the neighbouring state within reach of a difference.

        At the verge of slipping or buckling the tangent can grow beyond what a difference resolves; it is
        then scaled back, so that such a moment blurs the derivative instead of destroying it.
        """
        reach = abs(self._steps[k]) * float(np.abs(self._dx[k]).max(initial=0.0))
        if reach <= LARGEST_REACH_M:
            return
        share = LARGEST_REACH_M / reach if np.isfinite(reach) else 0.0
        self._dx[k] = np.nan_to_num(self._dx[k] * share)
        self._dv[k] = np.nan_to_num(self._dv[k] * share)
        x, v = self._dpast[k]
        self._dpast[k] = np.nan_to_num(x * share), np.nan_to_num(v * share)
        self._dxi[k] = {t: {n: np.nan_to_num(a * share) for n, a in v.items()} for t, v in self._dxi[k].items()}

    def _enter(self, k: int, before: State, dt: float, still: bool) -> tuple[StepContext, dict[str, Internals]]:
        """Begin the step from the neighbouring state with the neighbouring parameters."""
        h = self._steps[k]
        self.scene.apply(self._amended[k])
        if still:
            begun, carried = step_context(before.x, before.v, dt), before.internals
        else:
            past, (dx, dv) = before.past, self._dpast[k]
            if past is not None:
                past = Past(past.x + h * dx, past.v + h * dv, past.dt)
            begun = step_context(before.x + h * self._dx[k], before.v + h * self._dv[k], dt, past)
            carried = {t: {n: a + h * self._dxi[k][t][n] for n, a in v.items()} for t, v in before.internals.items()}
        self.scene.system.begin_step(begun, carried, search=False)
        return begun, carried

    def _difference(self, rig: Rig, h: float) -> dict[str, np.ndarray]:
        """Derivative of the readings at the neighbouring state that the system now holds."""
        there = self.observer.read(rig, self.actual_frames())
        return {c: (there[c] - self.reading[c]) / h for c in there}

    def _read_derivatives(self, found: Mapping[int, dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
        """Stack the derivatives of all channels over parameters, last axis; ``found``: mechanical ones."""
        columns = [
            found[k] if k in found else self._difference(rig, h)
            for k, (rig, h) in enumerate(zip(self._neighbours, self._steps, strict=True))
        ]
        if not columns:
            return {c: np.zeros((*r.shape, 0)) for c, r in self.reading.items()}
        return {c: np.stack([column[c] for column in columns], axis=-1) for c in self.reading}


def _same(a: Values, b: Values) -> bool:
    return (
        a.terms == b.terms
        and a.density == b.density
        and bool(np.array_equal(a.gravity, b.gravity))
        and a.compliance.keys() == b.compliance.keys()
        and all(np.array_equal(a.compliance[k], b.compliance[k]) for k in a.compliance)
    )


def simulate_tangent(
    scene: Scene,
    poses: Mapping[str, PoseTrajectory],
    times: np.ndarray,
    neighbours: Sequence[Rig],
    steps: Sequence[float],
    on_step: Callable[[int, int], None] | None = None,
) -> tuple[Trace, dict[str, np.ndarray]]:
    """Trace of a rollout and the derivatives of every channel, ``(n_times, ..., n_parameters)``."""
    simulation = TangentSimulation(scene, neighbours, steps)
    stacked: list[dict[str, np.ndarray]] = []

    def record(done: int, total: int) -> None:
        stacked.append(simulation.derivatives)
        if on_step is not None:
            on_step(done, total)

    trace = run(simulation, poses, times, record, on_reset=lambda: stacked.append(simulation.derivatives))
    return trace, {c: np.stack([s[c] for s in stacked]) for c in trace.outputs}
