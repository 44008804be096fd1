"""What is asked of a step, and what is said about it afterwards."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Result(str, Enum):
    """How a step ended."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit reached"
    LINE_SEARCH_FAILED = "line search found no lower energy"
    BLOCKED = "contact leaves no way"
    NOT_FINITE = "positions or forces are not finite"


@dataclass(frozen=True)
class NewtonSettings:
    """``step_tolerance_m``: converged when the largest nodal Newton update [m] is below it.
    ``force_tolerance``: and the largest free residual is below this share of the largest force.
    ``max_iterations``: of the slow Newton before the step counts as failed; ``fast_iterations``: factorised
    tangents of the fast one before the slow one takes over (0: slow only)."""

    step_tolerance_m: float = 1e-8
    force_tolerance: float = 1e-6
    max_iterations: int = 60
    fast_iterations: int = 20


@dataclass(frozen=True)
class StepReport:
    """What happened in a step. ``iterations``: of both Newtons; ``factorisations``: tangents that they took;
    ``residual_n``: largest free force imbalance [N]; ``min_gap_m``: smallest contact gap; ``tightest``: contact
    term that has it; ``parts``: in how many parts the step
    was made, of which the others are of the last one."""

    result: Result
    iterations: int
    factorisations: int
    line_searches: int
    residual_n: float
    update_m: float
    contacts: int
    min_gap_m: float
    tightest: str = ""
    parts: int = 1

    @property
    def converged(self) -> bool:
        return self.result is Result.CONVERGED
