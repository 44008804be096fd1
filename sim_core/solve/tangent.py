"""Directions of descent: from a factorised tangent, and from one kept over several iterates.

Assembling and factorising the Hessian costs about ten times as much as a residual and a back-substitution.
A :class:`Tangent` therefore also gives directions at later iterates. What the residual did over each step
since corrects it: with H the inverse so far, s the step and y the change of the residual (Broyden, Math.
Comput. 19, 1965, the update that changes least of the Jacobian and satisfies H y = s),

    H <- H + (s - H y) s^T H / (s^T H y)
"""

from __future__ import annotations

import numpy as np

from sim_core.solve.factor import Factor, NotPositiveDefinite
from sim_core.solve.system import System


class Tangent:
    """A factorised Hessian and what has been learned since. ``definite``: it is the true one."""

    def __init__(self, factor: Factor, definite: bool) -> None:
        self.definite = definite
        self._factor = factor
        self._corrections: list[tuple[np.ndarray, np.ndarray]] = []

    def answer(self, residual: np.ndarray) -> np.ndarray:
        """Change of the unknowns [m] that brings ``residual`` [N] to zero, to first order."""
        moved = self._factor.solve(residual)
        for change, step in self._corrections:
            moved = moved + change * float(step @ moved)
        return -moved

    def learn(self, full: np.ndarray, step: np.ndarray, residual: np.ndarray) -> np.ndarray:
        """Take in the residual [N] after a ``step`` [m], part of the ``full`` answer given before it, and
        answer it."""
        answered = self.answer(residual)
        change = full - answered  # H y
        along = float(step @ change)
        if along > 1e-12 * float(step @ step):
            correction = (step - change) / along
            self._corrections.append((correction, step))
            answered = answered + correction * float(step @ answered)
        return answered


def newton_direction(
    system: System, g: np.ndarray, move: np.ndarray | None
) -> tuple[np.ndarray, Tangent] | tuple[None, None]:
    """Newton direction from the true Hessian where it is positive definite, else from the positive
    semidefinite one, else from that with a diagonal shift; and the tangent it came from. None when nothing
    holds the system.

    ``move``: of what is prescribed [m] ``(n, 3)``, answered to first order.
    """

    def attempt(data: np.ndarray, definite: bool) -> tuple[np.ndarray, Tangent] | None:
        rhs = g if move is None else g + system.follow(move)
        try:
            tangent = Tangent(system.factor_data(data, definite=True), definite)
        except NotPositiveDefinite:
            return None
        direction = tangent.answer(rhs)
        return (direction, tangent) if np.all(np.isfinite(direction)) else None

    found = attempt(system.hessian_data(exact=True), True)
    if found is not None:
        return found
    data = system.hessian_data()
    largest, shift = system.largest_stiffness(data), 0.0
    while largest > 0.0 and shift <= 1e3 * largest:
        found = attempt(data, False)
        if found is not None:
            return found
        shift = max(10.0 * shift, 1e-12 * largest)
        data = system.hessian_data(shift=shift)
    return None, None
