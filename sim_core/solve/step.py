"""One implicit Euler step: minimise the incremental potential by Newton with line search."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from sim_core.energies.term import Internals, StepContext
from sim_core.errors import ConvergenceError
from sim_core.solve.factor import NotPositiveDefinite
from sim_core.solve.system import System


class Result(str, Enum):
    """How a step ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit reached"
    LINE_SEARCH_FAILED = "line search found no lower energy"
    NOT_FINITE = "positions or forces are not finite"


@dataclass(frozen=True)
class NewtonSettings:
    """``step_tolerance_m``: converged when the largest nodal Newton update [m] is below it.
    ``force_tolerance``: and the largest free residual is below this share of the largest force.
    ``max_iterations``: before the step counts as failed."""

    step_tolerance_m: float = 1e-8
    force_tolerance: float = 1e-6
    max_iterations: int = 60


@dataclass(frozen=True)
class State:
    """A value: copy it, perturb it, replay from it. ``x`` [m], ``v`` [m/s] ``(n, 3)``; ``t`` [s]."""

    t: float
    x: np.ndarray
    v: np.ndarray
    internals: dict[str, Internals]


@dataclass(frozen=True)
class StepReport:
    """What happened in a step. ``residual_n``: largest free force imbalance [N]; ``min_gap_m``:
    smallest contact gap, negative = overlap."""

    result: Result
    iterations: int
    line_searches: int
    residual_n: float
    update_m: float
    contacts: int
    min_gap_m: float

    @property
    def converged(self) -> bool:
        return self.result is Result.CONVERGED


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
    step = StepContext(state.x, state.v, dt)
    x = system.x
    system.set_targets(targets)
    x[:] = state.x
    system.begin_step(step, state.internals)
    while True:
        x[:] = state.x if guess is None else guess
        system.set_targets(targets)
        report = _newton(system, settings)
        if not report.converged or not system.widen(step, state.internals):
            break
    if check and not report.converged:
        raise ConvergenceError(
            f"The step from t = {state.t:.4f} s (dt = {dt:g} s) did not converge: {report.result.value} "
            f"after {report.iterations} Newton iterations, residual {report.residual_n:.3g} N, last "
            f"update {report.update_m:.3g} m.",
            "Use a smaller solver.dt_s, a slower motion, or a finer mesh where the sheet folds.",
        )
    internals = system.end_step(step, state.internals)
    velocity = (x - state.x) / dt if system.inertia else np.zeros_like(x)
    return State(state.t + dt, x.copy(), velocity, internals), report


def _newton(system: System, settings: NewtonSettings) -> StepReport:
    energy = system.energy()
    searches, update, residual = 0, np.inf, np.inf
    result = Result.ITERATION_LIMIT
    iteration = 0
    for iteration in range(1, settings.max_iterations + 1):  # noqa: B007  (reported)
        g = system.residual()
        scale = system.force_scale()
        residual = float(np.max(np.abs(g), initial=0.0))
        if not np.isfinite(residual) or not np.isfinite(energy):
            result = Result.NOT_FINITE
            break
        if update < settings.step_tolerance_m and residual <= settings.force_tolerance * max(scale, 1e-9):
            result = Result.CONVERGED
            break
        direction = _direction(system, g)
        update = float(np.max(np.abs(direction), initial=0.0))
        descent = float(g @ direction)
        start = system.unknowns()
        fraction, accepted = 1.0, False
        noise = 1e-13 * (abs(energy) + abs(descent)) + 1e-30
        while fraction > 1e-8:
            searches += 1
            system.set_unknowns(start + fraction * direction)
            trial = system.energy()
            if trial <= energy + 1e-4 * fraction * descent + noise:
                accepted = True
                break
            fraction *= 0.5
        if not accepted:
            system.set_unknowns(start)
            if update < settings.step_tolerance_m:
                result = Result.CONVERGED
            else:
                result = Result.LINE_SEARCH_FAILED
            break
        energy = trial
        update *= fraction
        if update < 1e-3 * settings.step_tolerance_m:
            residual = float(np.max(np.abs(system.residual()), initial=0.0))
            result = Result.CONVERGED
            break
    contacts, gap = system.contacts()
    return StepReport(result, iteration, searches, residual, update, contacts, gap)


def _direction(system: System, g: np.ndarray) -> np.ndarray:
    """Newton direction from the true Hessian where it is positive definite, else from the
    positive semidefinite one, else from that with a diagonal shift."""
    try:
        direction = -system.factor_data(system.hessian_data(exact=True), definite=True).solve(g)
        if np.all(np.isfinite(direction)):
            return np.asarray(direction)
    except NotPositiveDefinite:
        pass
    data = system.hessian_data()
    largest = system.largest_stiffness(data)
    shift = 0.0
    while True:
        try:
            if shift:
                data = system.hessian_data(shift=shift)
            direction = -system.factor_data(data, definite=True).solve(g)
            if np.all(np.isfinite(direction)):
                return np.asarray(direction)
        except NotPositiveDefinite:
            pass
        shift = max(10.0 * shift, 1e-12 * largest)
        if shift > 1e3 * largest:
            raise ConvergenceError(
                "The stiffness matrix cannot be factorised.",
                "Check that every body is held by a clamp, a mount or contact, or switch inertia on.",
            )
