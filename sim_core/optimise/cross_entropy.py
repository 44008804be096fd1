"""The cross-entropy method (Rubinstein & Kroese 2004): draw actions from a normal distribution with independent
entries, and fit it to the best of them.

    mu <- (1 - a) mu + a mean(elite),    sigma <- (1 - a) sigma + a std(elite)

with the smoothing a; the fittest of all stays among the elite (as in the i-CEM of Pinneri et al., CoRL 2020).
"""

from __future__ import annotations

import numpy as np

from sim_core.optimise.problem import Problem

POPULATION = 24
ELITE = 0.25
SMOOTHING = 0.6
SIGMA = 0.4
LEAST_SIGMA = 0.01


def cross_entropy(problem: Problem, start: np.ndarray, rng: np.random.Generator) -> None:
    """Search from ``start`` ``(size,)`` until the budget is spent."""
    mean, sigma = start.copy(), np.full(problem.size, SIGMA)
    kept: list[tuple[float, np.ndarray]] = []
    while True:
        problem.phase = "cross-entropy"
        drawn = [np.clip(mean + sigma * rng.standard_normal(problem.size), -1.0, 1.0) for _ in range(POPULATION)]
        scored = [*kept, *zip(problem.values(drawn), drawn, strict=True)]
        scored.sort(key=lambda item: -item[0])
        elite = np.array([action for _, action in scored[: max(2, round(ELITE * POPULATION))]])
        kept = scored[:1]
        mean = (1.0 - SMOOTHING) * mean + SMOOTHING * elite.mean(axis=0)
        sigma = np.maximum((1.0 - SMOOTHING) * sigma + SMOOTHING * elite.std(axis=0), LEAST_SIGMA)
