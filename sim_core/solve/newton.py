"""Minimise the incremental potential: a fast Newton that looks ahead, and a slow one that always descends.

The fast one (mixed-integration-point Newton: Magisano, Leonetti & Garcea, Int. J. Numer. Meth. Eng. 111,
2017) takes full steps. A thin sheet that turns by an angle stretches in a linearised step, and the stress of
that stretch, which is not real, would make the next tangent far too stiff; so the tangent's stress part uses
the stress that the linear step foresaw. Residual and convergence test are the true ones. Its first step
starts from the last equilibrium and answers the prescribed motion linearly. What it finds is accepted if
the true Hessian there is positive definite and the energy is not above that of the start. Otherwise the
search goes on from the lowest energy seen: a static system creeps to its next equilibrium (proximal
point: each small problem is solved by the fast Newton), and the slow Newton (true Hessian where definite,
projected elsewhere, backtracking on the energy) has the last word.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from sim_core.errors import ConvergenceError
from sim_core.solve.factor import NotPositiveDefinite
from sim_core.solve.system import System

PATIENCE = 5
"""Fast iterations without a new smallest update before the fast Newton gives up."""

CREEP_START_S, CREEP_END_S, CREEP_STEPS = 3e-3, 1.0, 40
"""First pseudo time of a static system out of balance, the one from which on balance is tried, and tries."""


class Result(str, Enum):
    """How a step ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit reached"
    LINE_SEARCH_FAILED = "line search found no lower energy"
    BLOCKED = "contact leaves no way"
    NOT_FINITE = "positions or forces are not finite"


@dataclass(frozen=True)
class NewtonSettings:
    """``step_tolerance_m``: converged when the largest nodal Newton update [m] is below it.
    ``force_tolerance``: and the largest free residual is below this share of the largest force.
    ``max_iterations``: of the slow Newton before the step counts as failed; ``fast_iterations``: of the
    fast one before the slow one takes over (0: slow only)."""

    step_tolerance_m: float = 1e-8
    force_tolerance: float = 1e-6
    max_iterations: int = 60
    fast_iterations: int = 20


@dataclass(frozen=True)
class StepReport:
    """What happened in a step. ``iterations``: of both Newtons; ``residual_n``: largest free force
    imbalance [N]; ``min_gap_m``: smallest contact gap; ``tightest``: contact term that has it; ``left_m``: part of
    the prescribed motion that was not made."""

    result: Result
    iterations: int
    line_searches: int
    residual_n: float
    update_m: float
    contacts: int
    min_gap_m: float
    tightest: str = ""
    left_m: float = 0.0

    @property
    def converged(self) -> bool:
        return self.result is Result.CONVERGED


def solve(
    system: System, x_start: np.ndarray, targets: np.ndarray, settings: NewtonSettings, guess: np.ndarray | None
) -> StepReport:
    """Find the minimum of the step that the system has begun.

    ``x_start``: the last equilibrium [m] ``(n, 3)``; ``targets``: where prescribed nodes go;
    ``guess``: where to begin instead of the linear answer to the prescribed motion.
    """
    deflection = system.deflections.copy()
    _place(system, x_start if guess is None else guess, targets, deflection)
    crude, energy = system.unknowns(), system.energy()
    spent = 0
    if settings.fast_iterations:
        if guess is None and not deflection.size:
            move = np.where(system.prescribed, system.x - x_start, 0.0)
            system.x[:] = x_start
        else:
            move = None
        report, definite = _fast(system, settings, targets, move)
        if report.converged and definite and system.energy() <= energy + _noise(energy):
            return report
        spent = report.iterations
        _place(system, system.x, targets, system.deflections.copy())
        reached = system.energy()
        if not (np.isfinite(reached) and reached < energy):
            system.set_unknowns(crude)
        if not system.inertia:
            report = _creep(system, settings, targets)
            if report.converged:
                return replace(report, iterations=report.iterations + spent)
            spent += report.iterations
    report = _slow(system, settings)
    return replace(report, iterations=report.iterations + spent)


def _creep(system: System, settings: NewtonSettings, targets: np.ndarray) -> StepReport:
    """Let a static system that has lost its balance (snap-through) move to the next one: minimise the
    potential plus M |x - x_k|^2 / (2 tau^2) again and again, with longer and longer tau."""
    tau, growth, spent = CREEP_START_S, 4.0, 0
    loose = replace(settings, step_tolerance_m=100.0 * settings.step_tolerance_m)
    report = _report(system, Result.ITERATION_LIMIT, 0, 0, np.inf, np.inf)
    for _ in range(CREEP_STEPS):
        kept = system.unknowns()
        with system.tethered(tau):
            report, definite = _fast(system, loose, targets, None)
        spent += report.iterations
        if not (report.converged and definite):
            system.set_unknowns(kept)
            tau, growth = tau / 4.0, 2.0
            continue
        tau *= growth
        if tau > CREEP_END_S:
            kept = system.unknowns()
            report, definite = _fast(system, settings, targets, None)
            spent += report.iterations
            if report.converged and definite:
                break
            system.set_unknowns(kept)
            report = replace(report, result=Result.ITERATION_LIMIT)
    return replace(report, iterations=spent)


def _place(system: System, x: np.ndarray, targets: np.ndarray, deflection: np.ndarray) -> None:
    system.x[:] = x
    values = system.unknowns()
    values[len(values) - deflection.size :] = deflection.ravel()
    system.set_targets(targets)
    system.set_unknowns(values)


def _noise(energy: float) -> float:
    return 1e-13 * abs(energy) + 1e-30


def _fast(
    system: System, settings: NewtonSettings, targets: np.ndarray, move: np.ndarray | None
) -> tuple[StepReport, bool]:
    """Full steps with the foreseen stress. ``move``: of what is prescribed, still to be made.

    Also returns whether the last matrix was the unprojected one.
    """
    result, update, residual, definite = Result.ITERATION_LIMIT, np.inf, np.inf, False
    best, best_at = np.inf, 0
    iteration = 0
    try:
        for iteration in range(1, settings.fast_iterations + 1):
            g = system.residual()
            residual = float(np.abs(g).max(initial=0.0))
            if not np.isfinite(residual):
                result = Result.NOT_FINITE
                break
            if _converged(system, settings, update, residual):
                result = Result.CONVERGED
                break
            if iteration > best_at + PATIENCE:
                break
            direction, definite = _direction(system, g, move)
            if direction is None:
                break
            step = system.spread(direction)
            system.foresee(step if move is None else step + move)
            unknowns = system.unknowns()
            if move is not None:
                system.set_targets(targets)
                move = None
            system.set_unknowns(unknowns + direction)
            update = float(np.abs(direction).max(initial=0.0))
            if update < best:
                best, best_at = update, iteration
    finally:
        system.foresee(None)
    return _report(system, result, iteration, 0, residual, update), definite


def _slow(system: System, settings: NewtonSettings) -> StepReport:
    """Newton with backtracking on the potential."""
    energy = system.energy()
    searches, update, residual = 0, np.inf, np.inf
    result = Result.ITERATION_LIMIT
    iteration = 0
    for iteration in range(1, settings.max_iterations + 1):  # noqa: B007  (reported)
        g = system.residual()
        residual = float(np.abs(g).max(initial=0.0))
        if not np.isfinite(residual) or not np.isfinite(energy):
            result = Result.NOT_FINITE
            break
        if _converged(system, settings, update, residual):
            result = Result.CONVERGED
            break
        direction, definite = _direction(system, g, None)
        if direction is None:
            raise ConvergenceError(
                "The stiffness matrix cannot be factorised.",
                "Check that every body is held by a clamp, a mount or contact, or switch inertia on.",
            )
        update = float(np.abs(direction).max(initial=0.0))
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
        while accepted and not definite and 1.0 <= fraction < 64.0:
            # The projected matrix is too stiff along what is unstable: go on while that pays.
            searches += 1
            system.set_unknowns(start + 2.0 * fraction * direction)
            further = system.energy()
            if not further < trial:
                system.set_unknowns(start + fraction * direction)
                break
            fraction, trial = 2.0 * fraction, further
        if not accepted:
            system.set_unknowns(start)
            result = Result.CONVERGED if update < settings.step_tolerance_m else Result.LINE_SEARCH_FAILED
            break
        energy = trial
        update *= fraction
        if update < 1e-3 * settings.step_tolerance_m:
            residual = float(np.abs(system.residual()).max(initial=0.0))
            result = Result.CONVERGED
            break
    return _report(system, result, iteration, searches, residual, update)


def _converged(system: System, settings: NewtonSettings, update: float, residual: float) -> bool:
    scale = max(system.force_scale(), 1e-9)
    return update < settings.step_tolerance_m and residual <= settings.force_tolerance * scale


def _report(
    system: System, result: Result, iteration: int, searches: int, residual: float, update: float
) -> StepReport:
    contacts, gap = system.contacts()
    return StepReport(result, iteration, searches, residual, update, contacts, gap, system.tightest())


def _direction(system: System, g: np.ndarray, move: np.ndarray | None) -> tuple[np.ndarray | None, bool]:
    """Newton direction from the true Hessian where it is positive definite, else from the positive
    semidefinite one, else from that with a diagonal shift; and whether it was the true one. None when
    nothing holds the system.

    ``move``: of what is prescribed [m] ``(n, 3)``, answered to first order.
    """

    def answer(data: np.ndarray) -> np.ndarray | None:
        rhs = g if move is None else g + system.follow(move)
        try:
            direction = -system.factor_data(data, definite=True).solve(rhs)
        except NotPositiveDefinite:
            return None
        return np.asarray(direction) if np.all(np.isfinite(direction)) else None

    direction = answer(system.hessian_data(exact=True))
    if direction is not None:
        return direction, True
    data = system.hessian_data()
    largest, shift = system.largest_stiffness(data), 0.0
    while largest > 0.0 and shift <= 1e3 * largest:
        direction = answer(data)
        if direction is not None:
            return direction, False
        shift = max(10.0 * shift, 1e-12 * largest)
        data = system.hessian_data(shift=shift)
    return None, False
