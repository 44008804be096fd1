"""What is asked of a step, and what is said about it afterwards."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from sim_core.solve.system import System

ROUND_OFF = 1e-3
"""A Newton update this much below the tolerance ends a search whatever the residual: forces that are nothing
but round-off cannot be balanced any better."""


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
    term that has it; ``left_m``: part of the prescribed motion that was not made."""

    result: Result
    iterations: int
    factorisations: int
    line_searches: int
    residual_n: float
    update_m: float
    contacts: int
    min_gap_m: float
    tightest: str = ""
    left_m: float = 0.0

    @property
    def converged(self) -> bool:
        return self.result is Result.CONVERGED


def converged(system: System, settings: NewtonSettings, error: float, residual: float) -> bool:
    """Whether positions are good enough. ``error``: bound on what is wrong with them [m]; ``residual``: largest free
    force imbalance [N], from the gradient that was evaluated last, which may be as large as its round-off."""
    if not error < settings.step_tolerance_m:
        return False
    return residual <= max(settings.force_tolerance * max(system.force_scale(), 1e-9), system.force_noise())


def report(system: System, result: Result, counts: tuple[int, int, int], residual: float, update: float) -> StepReport:
    """``counts``: iterations, factorisations, energies or slopes tried in line searches."""
    contacts, gap = system.contacts()
    return StepReport(result, *counts, residual, update, contacts, gap, system.tightest())
