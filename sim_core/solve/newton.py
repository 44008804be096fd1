"""Minimise the incremental potential: a fast Newton first, and a slow one that always descends.

A step with inertia begins where the velocities lead and answers linearly what the prescribed motion does
beyond that; a static one begins at the last equilibrium and answers all of the prescribed motion. What the fast
Newton (:mod:`sim_core.solve.mixed_integration_point_newton`) finds is accepted if the last tangent was the true
Hessian, positive definite, and the energy is not above that of the start. Otherwise, with inertia, it tries again from
where the step starts, and then the search goes on from the lower energy: a static system creeps to its next equilibrium
(proximal point: each small problem is solved by the fast Newton), and the slow Newton (true Hessian where definite,
projected elsewhere, backtracking on the energy) has the last word.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_core.errors import ConvergenceError
from sim_core.solve.line_search import shorten
from sim_core.solve.mixed_integration_point_newton import FastNewton
from sim_core.solve.report import ROUND_OFF, NewtonSettings, Result, StepReport, converged, report
from sim_core.solve.system import System
from sim_core.solve.tangent import newton_direction

CREEP_START_S, CREEP_END_S, CREEP_STEPS = 3e-3, 1.0, 40
"""First pseudo time of a static system out of balance, the one from which on balance is tried, and tries."""


def solve(
    system: System,
    x_start: np.ndarray,
    drift: np.ndarray,
    targets: np.ndarray,
    settings: NewtonSettings,
    guess: np.ndarray | None,
) -> StepReport:
    """Find the minimum of the step that the system has begun.

    ``x_start``: where the step starts [m] ``(n, 3)``; ``drift``: how far velocities lead from there [m]
    ``(n, 3)``; ``targets``: where prescribed nodes go; ``guess``: where to begin first, near the solution.
    """
    deflection = system.deflections.copy()
    spent = (0, 0)
    if guess is not None and settings.fast_iterations:
        place(system, guess, targets, deflection)
        energy = system.energy()
        found, definite = FastNewton(system, settings, targets, None, near=True).run()
        if found.converged and definite and system.energy() <= energy + noise_of(energy):
            return found
        spent = found.iterations, found.factorisations
    place(system, x_start, targets, deflection)
    crude, energy = system.unknowns(), system.energy()
    if settings.fast_iterations:
        for lead in [drift, 0.0] if drift.any() else [0.0]:
            move = begin(system, x_start + lead, targets, deflection, settings)
            found, definite = FastNewton(system, settings, targets, move).run()
            if found.converged and definite and system.energy() <= energy + noise_of(energy):
                return after(found, spent)
            spent = spent[0] + found.iterations, spent[1] + found.factorisations
        place(system, system.x, targets, system.deflections.copy())
        reached = system.energy()
        if not (np.isfinite(reached) and reached < energy):
            system.set_unknowns(crude)
        if not system.inertia:
            found = creep(system, settings, targets)
            if found.converged:
                return after(found, spent)
            spent = spent[0] + found.iterations, spent[1] + found.factorisations
    return after(_slow(system, settings), spent)


def after(found: StepReport, spent: tuple[int, int]) -> StepReport:
    """The report with the iterations and factorisations ``spent`` before."""
    return replace(found, iterations=found.iterations + spent[0], factorisations=found.factorisations + spent[1])


def begin(
    system: System, x: np.ndarray, targets: np.ndarray, deflection: np.ndarray, settings: NewtonSettings
) -> np.ndarray | None:
    """Place the system at ``x`` [m]; what is prescribed still has to move by what is returned, if anything."""
    move = system.prescribed_move(x, targets)
    if deflection.size or np.abs(move).max(initial=0.0) < settings.step_tolerance_m:
        place(system, x, targets, deflection)
        return None
    system.set_targets(x)
    system.x[:] = x
    return move


def creep(system: System, settings: NewtonSettings, targets: np.ndarray) -> StepReport:
    """Let a static system that has lost its balance (snap-through) move to the next one: minimise the
    potential plus M |x - x_k|^2 / (2 tau^2) again and again, with longer and longer tau."""
    tau, growth, spent = CREEP_START_S, 4.0, (0, 0)
    loose = replace(settings, step_tolerance_m=100.0 * settings.step_tolerance_m)
    found = report(system, Result.ITERATION_LIMIT, (0, 0, 0), np.inf, np.inf)
    for _ in range(CREEP_STEPS):
        kept = system.unknowns()
        with system.tethered(tau):
            found, definite = FastNewton(system, loose, targets, None).run()
        spent = spent[0] + found.iterations, spent[1] + found.factorisations
        if not (found.converged and definite):
            system.set_unknowns(kept)
            tau, growth = tau / 4.0, 2.0
            continue
        tau *= growth
        if tau > CREEP_END_S:
            kept = system.unknowns()
            found, definite = FastNewton(system, settings, targets, None).run()
            spent = spent[0] + found.iterations, spent[1] + found.factorisations
            if found.converged and definite:
                break
            system.set_unknowns(kept)
            found = replace(found, result=Result.ITERATION_LIMIT)
    return replace(found, iterations=spent[0], factorisations=spent[1])


def place(system: System, x: np.ndarray, targets: np.ndarray, deflection: np.ndarray) -> None:
    """Put free nodes at ``x`` [m], prescribed ones at their targets, and compliant mounts where they were."""
    system.x[:] = x
    values = system.unknowns()
    values[len(values) - deflection.size :] = deflection.ravel()
    system.set_targets(targets)
    system.set_unknowns(values)


def noise_of(energy: float) -> float:
    """Change of an energy [J] that round-off may make."""
    return 1e-13 * abs(energy) + 1e-30


def _slow(system: System, settings: NewtonSettings) -> StepReport:
    """Newton with backtracking on the potential."""
    energy = system.energy()
    searches, factorisations, update, residual = 0, 0, np.inf, np.inf
    result = Result.ITERATION_LIMIT
    iteration = 0
    for iteration in range(1, settings.max_iterations + 1):  # noqa: B007  (reported)
        g = system.residual()
        residual = float(np.abs(g).max(initial=0.0))
        if not np.isfinite(residual) or not np.isfinite(energy):
            result = Result.NOT_FINITE
            break
        if converged(system, settings, update, residual):
            result = Result.CONVERGED
            break
        direction, tangent = newton_direction(system, g, None)
        factorisations += 1
        if direction is None or tangent is None:
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
        while accepted and not tangent.definite and 1.0 <= fraction < 64.0:
            # The projected matrix is too stiff along what is unstable: go on while that pays.
            searches += 1
            system.set_unknowns(start + 2.0 * fraction * direction)
            further = system.energy()
            if not further < trial:
                system.set_unknowns(start + fraction * direction)
                break
            fraction, trial = 2.0 * fraction, further
        if accepted and fraction <= 1.0:
            # The energy may go down and up again: contact that opens and closes in turn.
            step = fraction * direction
            share, there, tries = shorten(system, start, step, fraction * descent, float(system.residual() @ step))
            searches += tries
            shorter = trial if there is None else system.energy()
            if shorter < trial:
                fraction, trial = share * fraction, shorter
            elif there is not None:
                system.set_unknowns(start + step)
        if not accepted:
            system.set_unknowns(start)
            result = Result.CONVERGED if update < settings.step_tolerance_m else Result.LINE_SEARCH_FAILED
            break
        energy = trial
        update *= fraction
        if update < ROUND_OFF * settings.step_tolerance_m:
            residual = float(np.abs(system.residual()).max(initial=0.0))
            result = Result.CONVERGED
            break
    return report(system, result, (iteration, factorisations, searches), residual, update)
