"""The methods by name. Each searches from a start until its budget is spent, which the problem says by an exception."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sim_core.errors import ConfigError, nearest_match
from sim_core.optimise.cross_entropy import cross_entropy
from sim_core.optimise.descent import adam, gradient
from sim_core.optimise.evolution import evolution
from sim_core.optimise.hybrid import hybrid
from sim_core.optimise.problem import Problem

Search = Callable[[Problem, np.ndarray, np.random.Generator], None]


@dataclass(frozen=True)
class Method:
    """A method. ``words``: what it does and when to choose it."""

    name: str
    words: str
    search: Search


METHODS = {
    m.name: m
    for m in (
        Method("hybrid", "L-BFGS-B and CMA-ES in turns: the one to begin with", hybrid),
        Method("gradient", "L-BFGS-B on the exact gradient, restarted where it converges", gradient),
        Method("adam", "Adam on the exact gradient: for rewards that jump where contact changes", adam),
        Method("cma", "CMA-ES: needs no gradient, and many rollouts", evolution),
        Method("cem", "cross-entropy method: needs no gradient", cross_entropy),
    )
}
"""By name."""


def method(name: str) -> Method:
    """A method by its name. Raises ``ConfigError`` for one that there is not."""
    if name not in METHODS:
        raise ConfigError(f"There is no method {name!r}.", nearest_match(name, METHODS))
    return METHODS[name]
