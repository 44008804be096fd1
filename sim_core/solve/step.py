"""One implicit step of a system on the compiled core: from a state and where prescribed nodes go to the next state."""

from __future__ import annotations

import numpy as np

from sim_core.core.system import Potential, on_core
from sim_core.errors import ConvergenceError
from sim_core.solve.report import NewtonSettings, Result, StepReport
from sim_core.solve.state import State
from sim_core.solve.system import System

__all__ = [
    "NewtonSettings",
    "Result",
    "State",
    "StepReport",
    "advance",
    "contact_force",
    "deflections",
    "ended",
    "energy",
    "exerted",
    "potential",
]


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
    after, report = on_core(system, settings or NewtonSettings()).advance(state, targets, dt, guess)
    if check and not report.converged:
        raise ConvergenceError(
            f"The step from t = {state.t:.4f} s (dt = {dt:g} s) did not converge: {report.result.value} "
            f"after {report.iterations} Newton iterations, residual {report.residual_n:.3g} N, last "
            f"update {report.update_m:.3g} m.",
            "Use a smaller solver.dt_s, a slower motion, or a finer mesh where the sheet folds.",
        )
    return after, report


def potential(
    system: System,
    state: State,
    x: np.ndarray | None = None,
    targets: np.ndarray | None = None,
    dt: float = 1.0,
    inertia: bool = False,
    exact: bool = True,
) -> Potential:
    """What a step of ``dt`` [s] from a state would make least, with ``inertia`` or as one between equilibria, at
    positions ``x`` [m] ``(n, 3)`` (None: where it starts), and its derivatives.

    ``targets``: of prescribed nodes [m] ``(n, 3)``, which compliant ones have given way from (None: they have not).
    ``exact``: the true Hessian and not the semidefinite one.
    """
    there = state.x if x is None else x
    return on_core(system).potential(state, there, there if targets is None else targets, dt, inertia, exact)


def ended(system: System, state: State, x: np.ndarray, dt: float = 1.0, inertia: bool = False) -> State:
    """The state after a step of ``dt`` [s] that ends with all nodes at ``x`` [m] ``(n, 3)``, in balance or not."""
    return on_core(system).ended(state, x, x, dt, inertia)


def energy(system: System) -> float:
    """The potential that the last step has made least [J]."""
    return on_core(system).energy


def exerted(system: System) -> np.ndarray:
    """What the terms exert at the end of the last step, dE/dx [N] ``(n, 3)``, without gravity, loads and inertia."""
    return np.array(on_core(system).exerted)


def deflections(system: System) -> np.ndarray:
    """How far each compliant group has given way [m], ``(n_groups, 3)``."""
    return np.array(on_core(system).deflections)


def contact_force(system: System, name: str) -> np.ndarray:
    """What one contact exerts on the nodes at the end of the last step [N] ``(n, 3)``."""
    return on_core(system).pair_forces()[name]
