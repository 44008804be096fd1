"""Evolution to find a way, gradients to go it: CMA-ES and L-BFGS-B in turns.

The paper runs CMA-ES over four fifths of the budget and gradient descent over the rest. Here gradients come first, as
long as they help, because they tell at once whether a reward can be followed from the start; then

* a few generations of CMA-ES from the best so far, wide enough to reach other contacts,
* L-BFGS-B from the best of those, until it converges or gains little,

again and again, with evolution the narrower the later. Where rollouts end early, or the gradient is zero because
nothing touches, evolution goes on until it has found an action that has a gradient.
"""

from __future__ import annotations

import numpy as np

from sim_core.optimise.descent import lbfgsb
from sim_core.optimise.evolution import SIGMA, evolution
from sim_core.optimise.problem import Evaluation, Problem

PROBE = 12
"""Gradients from the start before evolution begins."""

GENERATIONS = 4
"""Of evolution between two climbs."""

CLIMB = 20
"""Gradients of one climb at most."""

PATIENCE = 5
"""A climb ends when so many gradients have gained less than :data:`LITTLE` of what it gained before."""

LITTLE = 0.02

NARROWER = 0.7
"""Factor on the width of evolution from one turn to the next, down to a fifth of the first one."""


def hybrid(problem: Problem, start: np.ndarray, rng: np.random.Generator) -> None:
    """Search from ``start`` ``(size,)`` until the budget is spent."""
    lbfgsb(problem, start, most=PROBE, enough=_Gains())
    sigma = SIGMA
    while True:
        centre = start if problem.best is None else problem.best.action
        evolution(problem, centre, rng, sigma=sigma, proceed=lambda generation: generation < GENERATIONS)
        assert problem.best is not None
        lbfgsb(problem, problem.best.action, most=CLIMB, enough=_Gains())
        sigma = max(NARROWER * sigma, 0.2 * SIGMA)


class _Gains:
    """Whether a climb gains so little that it is enough."""

    def __init__(self) -> None:
        self._fitness: list[float] = []

    def __call__(self, found: Evaluation) -> bool:
        self._fitness.append(max(found.fitness, self._fitness[-1] if self._fitness else -np.inf))
        if len(self._fitness) <= PATIENCE:
            return False
        first, before, now = self._fitness[0], self._fitness[-1 - PATIENCE], self._fitness[-1]
        return now - before <= LITTLE * (now - first)
