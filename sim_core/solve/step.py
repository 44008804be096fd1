"""One implicit step: from a state and where the prescribed nodes go to the next state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.energies.term import Internals
from sim_core.errors import ConvergenceError
from sim_core.solve import contact_newton as guarded
from sim_core.solve import newton
from sim_core.solve.integrator import Past, step_context
from sim_core.solve.report import NewtonSettings, Result, StepReport
from sim_core.solve.system import System

__all__ = ["NewtonSettings", "Result", "State", "StepReport", "advance"]


@dataclass(frozen=True)
class State:
    """A value: copy it, perturb it, replay from it. ``x`` [m], ``v`` [m/s] ``(n, 3)``; ``t`` [s]; ``past``:
    the state before, where the integrator looks back."""

    t: float
    x: np.ndarray
    v: np.ndarray
    internals: dict[str, Internals]
    past: Past | None = None


def advance(
    system: System,
    state: State,
    targets: np.ndarray,
    dt: float,
    settings: NewtonSettings | None = None,
    guess: np.ndarray | None = None,
    check: bool = True,
) -> tuple[State, StepReport]:
    """Advance by ``dt`` [s].

    ``targets``: positions [m] ``(n, 3)``, read on prescribed components only. ``guess``: start of the
    iteration. Raises :class:`ConvergenceError` when the step does not converge, unless ``check`` is
    off; the returned state is then the last iterate.
    """
    settings = settings or NewtonSettings()
    step = step_context(state.x, state.v, dt, state.past, state.t)
    x = system.x
    system.set_targets(targets)
    x[:] = state.x
    system.begin_step(step, state.internals)
    drift = dt * state.v if system.inertia else np.zeros_like(x)
    if state.past is not None:  # The acceleration of the last step leads to within the third power of the step.
        drift = drift + 0.5 * dt**2 * (state.v - state.past.v) / state.past.dt
    solve = guarded.solve if system.touchable else newton.solve
    report = solve(system, state.x, drift, targets, settings, guess)
    if check and report.result is Result.BLOCKED:
        raise guarded.blocked(report, state.t)
    if check and not report.converged:
        raise ConvergenceError(
            f"The step from t = {state.t:.4f} s (dt = {dt:g} s) did not converge: {report.result.value} "
            f"after {report.iterations} Newton iterations, residual {report.residual_n:.3g} N, last "
            f"update {report.update_m:.3g} m.",
            "Use a smaller solver.dt_s, a slower motion, or a finer mesh where the sheet folds.",
        )
    internals = system.end_step(step, state.internals)
    velocity = (x - step.x_base) / step.tau if system.inertia else np.zeros_like(x)
    past = Past(state.x, state.v, dt) if system.inertia and system.second_order else None
    return State(state.t + dt, x.copy(), velocity, internals, past), report
