"""The step of a system with contact: nothing ever crosses.

The fast Newton of :mod:`sim_core.solve.newton` may overlap on its way. What it finds is accepted if the
straight path to it from the last equilibrium is free of touch, and if it balances the forces of the contact law
itself. Otherwise a guarded Newton goes on from there, or starts at the last equilibrium again: every move
ends short of the first touch (:mod:`sim_core.contact.continuous_collision`), and then goes down in energy. It also
makes the motion of what is prescribed in parts: the free nodes answer the rest of that motion to first order, and both
go as far as contact lets them. A motion that nothing can give way to ends as ``BLOCKED``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim_core.errors import ConvergenceError
from sim_core.solve.mixed_integration_point_newton import FastNewton
from sim_core.solve.newton import after, begin, creep, noise_of, place
from sim_core.solve.report import NewtonSettings, Result, StepReport, converged, report
from sim_core.solve.system import System
from sim_core.solve.tangent import newton_direction

KEEP = 0.1
"""Share of its gap that a pair keeps in one move."""

ANY = 1e-6
"""The same on the path to a solution, where any gap will do."""

HARDER = 3.0
"""How many times as large contact forces may become where a search begins."""

FARTHEST_M = 5e-3
"""Longest move of a node at once."""

SHORTEST = 1e-4
"""Share of the prescribed motion below which a part of it does not count as progress."""

RELAXATIONS = 6
"""Most moves between two parts of the prescribed motion."""

PATIENCE = 3
"""Parts of the prescribed motion without progress before it is given up."""

NO_MOTION_M = 1e-15
"""Prescribed motion that is nothing but round-off."""

DOUBLINGS = 6
"""Most times that a move is doubled."""

ITERATIONS = 4
"""Moves of the guarded Newton, as a multiple of ``max_iterations``."""


def solve(
    system: System,
    x_start: np.ndarray,
    drift: np.ndarray,
    targets: np.ndarray,
    settings: NewtonSettings,
    guess: np.ndarray | None,
) -> StepReport:
    """As :func:`sim_core.solve.newton.solve`."""
    deflection = system.deflections.copy()
    spent, start = (0, 0), x_start
    if guess is not None and settings.fast_iterations:
        found, _ = _try(system, x_start, None, targets, deflection, settings, guess)
        if found.converged:
            return found
        spent = found.iterations, found.factorisations
    if settings.fast_iterations:
        leads: list[np.ndarray | float] = [0.0]
        if drift.any() and not _runs_into(system, x_start, drift, targets, deflection):
            leads = [drift, 0.0]
        for lead in leads:
            found, sound = _try(system, x_start, lead, targets, deflection, settings)
            if found.converged:
                return after(found, spent)
            spent = spent[0] + found.iterations, spent[1] + found.factorisations
            if sound:
                start = system.x.copy()
                break
    found = _guarded(system, settings, x_start, start, targets, deflection)
    if not (found.converged or found.left_m or system.inertia):
        spent = spent[0] + found.iterations, spent[1] + found.factorisations
        kept = system.x.copy()
        system.guard(False)
        found = creep(system, settings, targets)
        sound = found.converged and _holds(system, kept, settings)[1]
        counts = (found.iterations, found.factorisations, found.line_searches)
        result = Result.CONVERGED if sound else Result.ITERATION_LIMIT
        found = report(system, result, counts, found.residual_n, found.update_m)
    return after(found, spent)


def blocked(found: StepReport, t: float) -> ConvergenceError:
    """What to say when prescribed motion runs into something that cannot give way."""
    bodies = found.tightest.removeprefix("contact.").split(".")[0].replace("-", " and ")
    return ConvergenceError(
        f"From t = {t:.4f} s on, {bodies} cannot give way any further to the motion that is prescribed: their gap is "
        f"{max(found.min_gap_m, 0.0):.1g} m and must stay above 0.",
        "End the motion there, or leave more room between what is held and what moves.",
    )


def _runs_into(
    system: System, x_start: np.ndarray, drift: np.ndarray, targets: np.ndarray, deflection: np.ndarray
) -> bool:
    """Whether contact would be loaded far more where velocities lead than it is: no place to search from."""
    system.guard(False)
    place(system, x_start + drift, targets, deflection)
    load = system.contact_load()
    if load <= HARDER * system.largest_load():
        return False
    system.x[:] = x_start
    return load > HARDER * system.contact_load()


def _try(
    system: System,
    x_start: np.ndarray,
    lead: np.ndarray | float | None,
    targets: np.ndarray,
    deflection: np.ndarray,
    settings: NewtonSettings,
    guess: np.ndarray | None = None,
) -> tuple[StepReport, bool]:
    """The fast Newton; also whether what it found can be reached freely. ``lead``: from where the step starts to
    where the search does [m], None with a guess."""
    system.guard(False)
    place(system, x_start if guess is None else guess, targets, deflection)
    energy = system.energy()
    move = None if lead is None else begin(system, x_start + lead, targets, deflection, settings)
    found, definite = FastNewton(system, settings, targets, move, near=lead is None).run()
    if not (found.converged and definite and system.energy() <= energy + noise_of(energy)):
        return replace(found, result=Result.ITERATION_LIMIT), False
    reached, balanced = _holds(system, x_start, settings)
    if not (reached and balanced):
        return replace(found, result=Result.ITERATION_LIMIT), reached
    counts = (found.iterations, found.factorisations, found.line_searches)
    return report(system, Result.CONVERGED, counts, found.residual_n, found.update_m), True


def _holds(system: System, start: np.ndarray, settings: NewtonSettings) -> tuple[bool, bool]:
    """Whether the straight path from ``start`` to where the system is is free, and whether it is in balance."""
    system.cover()
    system.guard(True)
    if system.free_way(start, system.x - start, ANY, (0.0, 1.0))[0] < 1.0:
        return False, False
    residual = float(np.abs(system.residual()).max(initial=0.0))
    return True, converged(system, settings, 0.0, residual)


def _guarded(
    system: System,
    settings: NewtonSettings,
    x_start: np.ndarray,
    start: np.ndarray,
    targets: np.ndarray,
    deflection: np.ndarray,
) -> StepReport:
    """Newton of which every move is free of touch. ``start``: ``x_start``, where the prescribed motion has yet
    to be made, or a state that has it behind it."""
    held = np.concatenate([np.zeros(system.n_unknowns - deflection.size), deflection.ravel()])
    base = x_start - system.spread(held)
    whole = system.prescribed_move(base, targets)
    left = 0.0
    if start is x_start:
        left = 1.0 if np.abs(whole).max(initial=0.0) > NO_MOTION_M or system.turns else 0.0
        place(system, x_start, base, deflection)
    system.guard(True)
    system.turn(1.0 - left)
    searches, factorisations, update, residual, result = 0, 0, np.inf, np.inf, Result.ITERATION_LIMIT
    moving, relaxed, stuck, iteration, blocker = True, 0, 0, 0, ""
    length = float(np.abs(whole).max(initial=0.0))
    for iteration in range(1, ITERATIONS * settings.max_iterations + 1):  # noqa: B007  (reported)
        g = system.residual()
        residual = float(np.abs(g).max(initial=0.0))
        if not np.isfinite(residual):
            result = Result.NOT_FINITE
            break
        if left == 0.0 and converged(system, settings, update, residual):
            result = Result.CONVERGED
            break
        move = left * whole if left and moving else None
        direction, tangent = newton_direction(system, g, move)
        factorisations += 1
        if direction is None or tangent is None:
            raise ConvergenceError(
                "The stiffness matrix cannot be factorised.",
                "Check that every body is held by a clamp, a mount or contact, or switch inertia on.",
            )
        update = float(np.abs(direction).max(initial=0.0))
        step = system.spread(direction)
        if move is not None:
            step = step + move
        fraction, by = _way(system, direction, step, left, base, whole, move is not None)
        unknowns = system.unknowns()
        if move is not None:
            stuck = stuck + 1 if by and left * fraction < SHORTEST else 0
            blocker = by
            if stuck == PATIENCE:
                break
            left = 0.0 if fraction == 1.0 else left * (1.0 - fraction)
            _advance(system, unknowns + fraction * direction, left, base, whole)
            moving, relaxed = fraction > 0.5, 0
            continue
        accepted, tried = _descend(system, unknowns, direction, fraction, float(g @ direction), 1.0 - left)
        searches += tried
        if accepted and fraction == 1.0 and tried == 1 and not tangent.definite:
            searches += _further(system, unknowns, left, base, whole)
        if not accepted:
            result = (
                Result.CONVERGED if update < settings.step_tolerance_m and left == 0.0 else Result.LINE_SEARCH_FAILED
            )
            break
        if left == 0.0 and update < 1e-3 * settings.step_tolerance_m:
            residual = float(np.abs(system.residual()).max(initial=0.0))
            result = Result.CONVERGED
            break
        relaxed += 1
        moving = moving or relaxed == RELAXATIONS or update < 1e-2 * left * length
    counts = (iteration, factorisations, searches)
    if not (left and blocker and result is not Result.NOT_FINITE):
        return replace(report(system, result, counts, residual, update), left_m=left * length)
    found = report(system, Result.BLOCKED, counts, residual, update)
    return replace(found, left_m=left * length, tightest=blocker, min_gap_m=system.gap_of(blocker))


def _way(
    system: System,
    direction: np.ndarray,
    step: np.ndarray,
    left: float,
    base: np.ndarray,
    whole: np.ndarray,
    moving: bool,
) -> tuple[float, str]:
    """Share of a move that is free, and the contact that ends it (empty: none). The system stays where it is."""
    here, unknowns = system.x.copy(), system.unknowns()
    fraction = min(1.0, FARTHEST_M / max(float(np.abs(step).max(initial=0.0)), 1e-300))
    then = left * (1.0 - fraction) if moving else left
    _advance(system, unknowns + fraction * direction, then, base, whole)
    system.cover()
    _advance(system, unknowns, left, base, whole)
    free, by = system.free_way(here, fraction * step, KEEP, (1.0 - left, 1.0 - then))
    return fraction * free, by if free < 1.0 else ""


def _advance(system: System, unknowns: np.ndarray, left: float, base: np.ndarray, whole: np.ndarray) -> None:
    """Go to where the unknowns are, and what is prescribed is but for the part ``left`` of its motion."""
    system.turn(1.0 - left)
    system.set_targets(base + (1.0 - left) * whole)
    system.set_unknowns(unknowns)


def _descend(
    system: System, unknowns: np.ndarray, direction: np.ndarray, fraction: float, descent: float, made: float
) -> tuple[bool, int]:
    """Halve the move until the energy falls; whether it did, and after how many trials. ``made``: share of the
    prescribed motion that is made."""
    energy, here = system.energy(), system.x.copy()
    noise = 1e-13 * (abs(energy) + abs(descent)) + 1e-30
    for tried in range(1, 40):
        enough = energy + 1e-4 * fraction * descent + noise
        system.set_unknowns(unknowns + fraction * direction)
        if system.straighten(here):
            if system.energy() <= enough and _is_free(system, here, made) and system.energy() <= enough:
                return True, tried
            system.set_unknowns(unknowns + fraction * direction)
        if system.energy() <= enough:
            return True, tried
        fraction *= 0.5
    system.set_unknowns(unknowns)
    return False, 40


def _further(system: System, start: np.ndarray, left: float, base: np.ndarray, whole: np.ndarray) -> int:
    """Double the move from the unknowns ``start`` [m] while nothing touches and the energy falls: the projected matrix
    is too stiff along what is unstable, and lets a sheet that buckles creep. Returns how often it was tried."""
    energy = system.energy()
    for tried in range(1, DOUBLINGS + 1):
        there = system.unknowns()
        onward = there - start
        if _way(system, onward, system.spread(onward), left, base, whole, False)[0] < 1.0:
            return tried
        system.set_unknowns(there + onward)
        further = system.energy()
        if not further < energy:
            system.set_unknowns(there)
            return tried
        energy = further
    return DOUBLINGS


def _is_free(system: System, here: np.ndarray, made: float) -> bool:
    """Whether the straight way from ``here`` [m] ``(n, 3)`` to where the system is is free of touch."""
    system.cover()
    return system.free_way(here, system.x - here, KEEP, (made, made))[0] == 1.0
