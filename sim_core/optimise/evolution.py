"""Covariance matrix adaptation (Hansen, The CMA evolution strategy: a tutorial, 2016), by the library ``cma``.

Only the order of fitness counts, so that rollouts that ended early are worse than all others, the later the better.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from sim_core.optimise.problem import Problem

SIGMA = 0.3
"""Standard deviation of the first generation, of a half of the range of an action."""

POPULATION_BASE = 8
"""Least number of actions of a generation."""


def population(size: int) -> int:
    """Actions of a generation: 4 + 3 ln n, at least :data:`POPULATION_BASE`, even."""
    count = max(POPULATION_BASE, 4 + int(3.0 * np.log(size)))
    return count + count % 2


@contextmanager
def strategy_from(start: np.ndarray, sigma: float, rng: np.random.Generator, options: dict[str, Any]) -> Iterator[Any]:
    """A strategy of the library ``cma`` with numbers drawn by ``rng``; it says nothing, nor does it warn of options."""
    import cma

    ours = {"seed": np.nan, "randn": lambda *shape: rng.standard_normal(shape), "verbose": -9}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield cma.CMAEvolutionStrategy(start, sigma, {**options, **ours})


def evolution(
    problem: Problem,
    start: np.ndarray,
    rng: np.random.Generator,
    *,
    sigma: float = SIGMA,
    proceed: Callable[[int], bool] = lambda _: True,
) -> None:
    """Search from ``start`` ``(size,)`` until the budget is spent, or ``proceed(generation)`` is False; begun anew from
    the best where the strategy has converged."""
    generation, centre = 0, start
    while True:
        options = {
            "bounds": [-1.0, 1.0],
            "popsize": population(problem.size),
            "CMA_diagonal": True if problem.size > 200 else 0,
        }
        with strategy_from(np.clip(centre, -0.95, 0.95), sigma, rng, options) as strategy:
            while not strategy.stop():
                if not proceed(generation):
                    return
                problem.phase = "CMA-ES"
                actions = strategy.ask()
                strategy.tell(actions, [-value for value in problem.values(actions)])
                generation += 1
        assert problem.best is not None
        centre = problem.best.action
