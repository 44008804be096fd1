"""The fast Newton: full steps that look ahead, and few tangents.

Mixed-integration-point Newton (Magisano, Leonetti & Garcea, Int. J. Numer. Meth. Eng. 111, 2017): a thin
sheet that turns by an angle stretches in a linearised step, and the stress of that stretch, which is not
real, would make the next tangent far too stiff; so the tangent's stress part uses the stress that the linear
step foresaw. Residual and convergence test are the true ones.

A tangent is kept while the updates that it answers shrink fast enough (:mod:`sim_core.solve.tangent`). A step
that runs into contact is made in part (:mod:`sim_core.solve.contact_step_limit`).
"""

from __future__ import annotations

import numpy as np

from sim_core.solve.contact_step_limit import contact_share
from sim_core.solve.report import ROUND_OFF, NewtonSettings, Result, StepReport, converged, report
from sim_core.solve.system import System
from sim_core.solve.tangent import Tangent, newton_direction

PATIENCE = 5
"""Tangents without a new smallest update before the fast Newton gives up."""

KEEP = 0.5
"""A kept tangent has to answer with an update smaller than this share of the last one."""

SLOWEST = 0.1
"""Rate at which kept tangents are taken to converge, at best, when what is left of the error is estimated."""

SURE = 0.02
"""Share of the tolerance that this estimate has to be below."""

LEAST = 0.3
"""Share of the prescribed motion that is made at once, at least."""


class FastNewton:
    """One search. ``move``: of what is prescribed [m] ``(n, 3)``, still to be made; the first step answers
    it to first order and goes to ``targets`` [m] ``(n, 3)``, in parts where contact asks for it. ``near``: it begins
    so near the solution that the tangent there tells whether that is stable, as long as it is good enough to be
    kept."""

    def __init__(
        self,
        system: System,
        settings: NewtonSettings,
        targets: np.ndarray,
        move: np.ndarray | None,
        near: bool = False,
    ) -> None:
        self._system = system
        self._settings = settings
        self._targets = targets
        self._move = move
        self._near = near
        self._tangent: Tangent | None = None
        self._tangents = 0
        self._old = False
        self._tries = 0
        self._best, self._best_at = np.inf, 0
        self._update, self._error = np.inf, np.inf
        self._full = self._step = np.empty(0)

    def run(self) -> tuple[StepReport, bool]:
        """Search from where the system is. Also returns whether the last tangent was the true Hessian, which a
        static search takes within the tolerance of the solution."""
        iteration, residual, result = 0, np.inf, None
        try:
            while result is None:
                iteration += 1
                g = self._system.residual()
                residual = float(np.abs(g).max(initial=0.0))
                result = self._verdict(residual)
                if result is None and not self._advance(g):
                    result = Result.ITERATION_LIMIT
        finally:
            self._system.foresee(None)
        counts = (iteration, self._tangents, self._tries)
        definite = self._tangent is not None and self._tangent.definite
        return report(self._system, result, counts, residual, self._update), definite

    def _verdict(self, residual: float) -> Result | None:
        if not np.isfinite(residual):
            return Result.NOT_FINITE
        if self._move is not None:
            return None
        floor = not self._old and self._error < ROUND_OFF * self._settings.step_tolerance_m
        if not floor and not converged(self._system, self._settings, self._error, residual):
            return None
        if self._old and not self._system.inertia and not (self._near and self._tangents == 1):
            self._tangent = None  # a static solution may be unstable: one step with its own tangent tells
            return None
        return Result.CONVERGED

    def _advance(self, g: np.ndarray) -> bool:
        """Make the next step; False when there is none."""
        direction = self._kept(g)
        self._old = direction is not None
        if direction is None:
            if self._tangents >= min(self._settings.fast_iterations, self._best_at + PATIENCE):
                return False
            self._tangent = None
            self._tangents += 1
            direction, self._tangent = newton_direction(self._system, g, self._move)
            if direction is None:
                return False
            self._error = float(np.abs(direction).max(initial=0.0))
            if self._error < self._best:
                self._best, self._best_at = self._error, self._tangents
        self._go(direction, g)
        return True

    def _kept(self, g: np.ndarray) -> np.ndarray | None:
        """Answer of the tangent of an earlier iterate, where that is good enough."""
        if self._tangent is None:
            return None
        direction = self._tangent.learn(self._full, self._step, g)
        length = float(np.abs(direction).max(initial=0.0))
        if not length < KEEP * self._update:
            return None
        # Linear convergence: what is left behind this step is a geometric series (Hairer & Wanner, IV.8).
        rate = max(length / self._update, SLOWEST)
        self._error = length * rate / (1.0 - rate) / SURE
        return direction

    def _go(self, direction: np.ndarray, g: np.ndarray) -> None:
        """Make the step, or the part of it that contact lets through; answers of kept tangents, which shrink, whole."""
        system, move = self._system, self._move
        start, placed = system.unknowns(), system.targets()
        step = system.spread(direction)

        def go(share: float) -> None:
            if move is not None:
                system.set_targets(self._targets if share == 1.0 else placed + share * move)
            system.set_unknowns(start + share * direction)

        def along(share: float) -> float:
            go(share)
            return float(system.contact_residual() @ direction)

        share = 1.0
        if system.touchable and not self._old:
            share, tries = contact_share(along, float(g @ direction))
            share = share if move is None else max(share, LEAST)
            self._tries += tries
        go(share)
        self._full, self._step = direction, share * direction
        self._update = share * float(np.abs(direction).max(initial=0.0))
        if share < 1.0:
            self._error = max(self._error, (1.0 - share) / share * self._update)
        system.foresee(share * (step if move is None else step + move))
        self._move = None if move is None or share == 1.0 else (1.0 - share) * move
        if self._move is not None:
            self._tangent = None
