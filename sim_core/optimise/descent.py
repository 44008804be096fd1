"""Ascent of the fitness along exact gradients, within the bounds.

Rollouts that end early have no gradient. A line search that meets one is given a value that is worse than where it
began, and goes a shorter way.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from sim_core.optimise.problem import Evaluation, Problem

FIRST_STEP = 0.2
"""Largest change of an entry in the first step of L-BFGS-B."""

SHAKE = 0.15
"""Standard deviation of the action that a search begins with, and of what is added to the best one where it begins
anew."""

FIRST, SECOND = 0.8, 0.95
"""Decay of the means of gradients and of their squares in Adam: for few steps, faster than is usual for many."""


class Stalled(Exception):
    """A local search has done all that it is to do."""


def lbfgsb(
    problem: Problem,
    start: np.ndarray,
    *,
    most: int | None = None,
    enough: Callable[[Evaluation], bool] = lambda _: False,
) -> Evaluation | None:
    """L-BFGS-B (Byrd, Lu, Nocedal & Zhu 1995; scipy's) from ``start`` ``(size,)``, with at most ``most`` gradients.

    It ends when it converges, or ``enough`` of an evaluation is true. Gives the best evaluation with a gradient, if
    there is one.
    """
    scale: float | None = None
    best: Evaluation | None = None
    count = 0

    def value(action: np.ndarray) -> tuple[float, np.ndarray]:
        nonlocal scale, best, count
        if most is not None and count >= most:
            raise Stalled
        problem.phase = "L-BFGS-B"
        count += 1
        found = problem.gradients([action])[0]
        if found.gradient is None:
            if best is None or scale is None:
                raise Stalled
            return scale * (abs(best.fitness) + 1.0) - scale * best.fitness, np.zeros(problem.size)
        if best is None or found.fitness > best.fitness:
            best = found
        steepest = float(np.abs(found.gradient).max())
        if steepest == 0.0 or enough(found):
            raise Stalled
        if scale is None:
            scale = FIRST_STEP / steepest  # its first step is the gradient, or of length 1
        return -scale * found.fitness, -scale * found.gradient

    try:
        minimize(
            value, start, jac=True, method="L-BFGS-B", bounds=[(-1.0, 1.0)] * problem.size, options={"maxfun": 10**6}
        )
    except Stalled:
        pass
    return best


def gradient(problem: Problem, start: np.ndarray, rng: np.random.Generator) -> None:
    """L-BFGS-B from ``start``, again from near the best one whenever it converges, until the budget is spent."""
    lbfgsb(problem, start)
    while True:
        centre = start if problem.best is None else problem.best.action
        lbfgsb(problem, np.clip(centre + SHAKE * rng.standard_normal(problem.size), -1.0, 1.0))


def adam(
    problem: Problem,
    start: np.ndarray,
    rng: np.random.Generator,
    *,
    rate: float = 0.1,
    proceed: Callable[[int], bool] = lambda _: True,
) -> None:
    """Adam (Kingma & Ba 2015), projected on the bounds, from ``start``; with several workers one more from near it for
    each. Where a rollout ends early, its walker goes back to its best and on with half of the rate."""
    walkers = [start] + [
        np.clip(start + SHAKE * rng.standard_normal(problem.size), -1.0, 1.0) for _ in range(problem.workers - 1)
    ]
    count = len(walkers)
    mean, square = np.zeros((count, problem.size)), np.zeros((count, problem.size))
    rates, steps = np.full(count, rate), np.zeros(count)
    bests: list[Evaluation | None] = [None] * count
    turn = 0
    while proceed(turn):
        problem.phase = "Adam"
        turn += 1
        for k, found in enumerate(problem.gradients(walkers)):
            known = bests[k]
            if known is None or found.fitness > known.fitness:
                bests[k] = known = found if found.gradient is not None else known
            if found.gradient is None or not found.gradient.any():
                rates[k] *= 0.5
                mean[k], square[k], steps[k] = 0.0, 0.0, 0.0
                if known is None or rates[k] < 1e-3 * rate:
                    centre = start if problem.best is None else problem.best.action
                    walkers[k] = np.clip(centre + SHAKE * rng.standard_normal(problem.size), -1.0, 1.0)
                    rates[k], bests[k] = rate, None
                    continue
                walkers[k], slope = known.action, known.gradient
            else:
                slope = found.gradient
            assert slope is not None
            steps[k] += 1
            mean[k] = FIRST * mean[k] + (1.0 - FIRST) * slope
            square[k] = SECOND * square[k] + (1.0 - SECOND) * slope**2
            step = (mean[k] / (1.0 - FIRST ** steps[k])) / (np.sqrt(square[k] / (1.0 - SECOND ** steps[k])) + 1e-12)
            walkers[k] = np.clip(walkers[k] + rates[k] * step, -1.0, 1.0)
