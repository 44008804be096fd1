"""Generic motions and evolution to find a way, gradients to go it.

ThinShellLab runs CMA-ES over four fifths of the budget and gradient descent over the rest. Here

1. a few gradients from the start tell whether the reward can be followed from there. Often it cannot: what sticks, or
   is not touched, has a gradient of its stuck state, which says nothing about where it goes once it slides;
2. so each straight motion of the hands is tried, at about half of its bounds, and slower where its rollout ends early.
   The best of them is tried at its bounds too, unless it had to be slower: what is to be left behind by its inertia has
   to be left fast. The better one has broken contacts that stick, and L-BFGS-B climbs from there;
3. then each motion out and back, which begins and ends where the hands are: it acts by its speed, so it is tried at its
   bounds first. What is thrown, shaken or tapped moves by it where no straight motion of the hands moves it;
4. then CMA-ES for a few generations from the best so far, wide enough to reach other contacts, and L-BFGS-B from the
   best of those, again and again, with evolution the narrower the later.

L-BFGS-B climbs from the best motion of a kind where that is the best action so far. The start is drawn at random
(:func:`sim_core.optimise.run.optimise`), and so is how large each straight motion is.

A climb ends when it converges or gains little. Where rollouts end early, or the gradient is zero because nothing
touches, evolution goes on until it has found an action that has a gradient.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim_core.optimise.descent import lbfgsb
from sim_core.optimise.evolution import SIGMA, evolution
from sim_core.optimise.problem import Evaluation, Problem
from sim_core.tasks.actions import OUT_AND_BACK, STRAIGHT

PROBE = 5
"""Gradients from the start before other motions are tried."""

SHARES = {STRAIGHT: (0.5, 0.2, 0.08), OUT_AND_BACK: (1.0, 0.4, 0.16)}
"""Of the bounds, at which motions of a kind are tried: the next one where a rollout ends early."""

SPREAD = {STRAIGHT: 0.5, OUT_AND_BACK: 0.0}
"""Each motion of a kind is larger or smaller than that by up to this share, drawn evenly."""

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
    for kind, shares in SHARES.items():
        way = _tried(problem, rng, kind, shares)
        if way is not None and way is problem.best:
            lbfgsb(problem, way.action, most=CLIMB, enough=_Gains())
    sigma = SIGMA
    while True:
        centre = start if problem.best is None else problem.best.action
        evolution(problem, centre, rng, sigma=sigma, proceed=lambda generation: generation < GENERATIONS)
        assert problem.best is not None
        lbfgsb(problem, problem.best.action, most=CLIMB, enough=_Gains())
        sigma = max(NARROWER * sigma, 0.2 * SIGMA)


def _tried(problem: Problem, rng: np.random.Generator, kind: str, shares: Sequence[float]) -> Evaluation | None:
    """The best of the motions of a kind that come to an end, if there is one."""
    motions = problem.motions.get(kind, np.zeros((0, problem.size)))
    left, first = list(range(len(motions))), len(problem.history)
    sizes = 1.0 + SPREAD[kind] * rng.uniform(-1.0, 1.0, len(motions))
    for share in shares:
        problem.phase = kind
        at = len(problem.history)
        problem.values([np.clip(sizes[k] * share * motions[k], -1.0, 1.0) for k in left])
        tried = problem.history[at:]
        left = [k for k, evaluation in zip(left, tried, strict=True) if evaluation.outcomes[0].stopped]
    found = [e for e in problem.history[first:] if not any(o.stopped for o in e.outcomes)]
    best = max(found, key=lambda e: e.fitness, default=None)
    if best is not None and any(best is e for e in problem.history[first : first + len(motions)]):
        largest = float(np.abs(best.action).max())
        if 0.0 < largest < 1.0:
            problem.values([best.action / largest])
            best = max(best, problem.history[-1], key=lambda e: e.fitness)
    return best


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
