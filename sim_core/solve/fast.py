"""The fast Newton: full steps that look ahead, and few tangents.

Mixed-integration-point Newton (Magisano, Leonetti & Garcea, Int. J. Numer. Meth. Eng. 111, 2017): a thin
sheet that turns by an angle stretches in a linearised step, and the stress of that stretch, which is not
real, would make the next tangent far too stiff; so the tangent's stress part uses the stress that the linear
step foresaw. Residual and convergence test are the true ones.

A tangent is kept while the updates that it answers shrink fast enough (:mod:`sim_core.solve.tangent`). A step
that takes back the one before it is shortened (:mod:`sim_core.solve.shorten`): contact points that stick after
one full step and slip after the next would go on like that for ever.
"""

from __future__ import annotations

import numpy as np

from sim_core.solve.report import ROUND_OFF, NewtonSettings, Result, StepReport, converged, report
from sim_core.solve.shorten import shorten
from sim_core.solve.system import System
from sim_core.solve.tangent import Tangent, newton_direction

PATIENCE = 5
"""Tangents without a new smallest update before the fast Newton gives up."""

KEEP = 0.5
"""A kept tangent has to answer with an update smaller than this share of the last one."""

SURE = 0.01
"""Share of the tolerance that the update of a kept tangent has to be below: it converges linearly, not faster."""

REVERSED = 0.5
"""A step that takes back more than this share of the last one is shortened where it overshoots."""


class FastNewton:
    """One search. ``move``: of what is prescribed [m] ``(n, 3)``, still to be made; the first step answers
    it to first order and goes to ``targets`` [m] ``(n, 3)``."""

    def __init__(self, system: System, settings: NewtonSettings, targets: np.ndarray, move: np.ndarray | None) -> None:
        self._system = system
        self._settings = settings
        self._targets = targets
        self._move = move
        self._tangent: Tangent | None = None
        self._tangents = 0
        self._old = False
        self._shortened = 0
        self._best, self._best_at = np.inf, 0
        self._update, self._error = np.inf, np.inf
        self._start = self._full = self._step = self._before = np.empty(0)
        self._back = 0.0

    def run(self) -> tuple[StepReport, bool]:
        """Search from where the system is. Also returns whether the last tangent was the true Hessian, which a
        static search takes within the tolerance of the solution."""
        iteration, residual, result = 0, np.inf, None
        try:
            while result is None:
                iteration += 1
                g = self._system.residual()
                if iteration > 1:
                    g = self._shorten(g)
                residual = float(np.abs(g).max(initial=0.0))
                result = self._verdict(residual)
                if result is None and not self._advance(g):
                    result = Result.ITERATION_LIMIT
        finally:
            self._system.foresee(None)
        counts = (iteration, self._tangents, self._shortened)
        definite = self._tangent is not None and self._tangent.definite
        return report(self._system, result, counts, residual, self._update), definite

    def _verdict(self, residual: float) -> Result | None:
        if not np.isfinite(residual):
            return Result.NOT_FINITE
        floor = not self._old and self._error < ROUND_OFF * self._settings.step_tolerance_m
        if not floor and not converged(self._system, self._settings, self._error, residual):
            return None
        if self._old and not self._system.inertia:
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
        self._error = length / SURE
        return direction

    def _go(self, direction: np.ndarray, g: np.ndarray) -> None:
        system, move = self._system, self._move
        step = system.spread(direction)
        system.foresee(step if move is None else step + move)
        self._start, self._before = system.unknowns(), g.copy()
        last = self._step if self._step.size else direction
        self._back = -float(direction @ last) / max(float(last @ last), 1e-300)
        self._full = self._step = direction
        self._update = float(np.abs(direction).max(initial=0.0))
        if move is not None:
            system.set_targets(self._targets)
            self._move = None
        system.set_unknowns(self._start + direction)

    def _shorten(self, g: np.ndarray) -> np.ndarray:
        """Residual after the last step, which is shortened first where it took back the one before it or, in a
        search for contact that makes no headway, where it overshot: a tangent near the slip limit is too soft."""
        before, after = float(self._before @ self._full), float(g @ self._full)
        stalled = self._system.touchable and self._tangents > self._best_at
        if self._back < REVERSED and not (stalled and after > abs(before)):
            return g
        share, there, tries = shorten(self._system, self._start, self._full, before, after)
        if there is None:
            return g
        self._shortened += tries
        self._step = share * self._full
        self._update *= share
        self._error = max(self._error, (1.0 - share) / share * self._update)
        self._system.foresee(None)
        return there
