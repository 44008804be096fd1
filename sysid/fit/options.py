"""What can be chosen about a fit."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Literal

from sim_core.errors import ConfigError
from sysid.fit.nuisance import USUAL, checked_kinds

Intervals = Literal["quadratic", "checked", "profiled"]
"""Intervals from the covariance alone; with a simulation at each end that tells whether they hold; or those of the
profile likelihood beside them (:mod:`sysid.fit.profiler`)."""


@dataclass(frozen=True)
class FitOptions:
    """Choices of a fit, checked. Raises ``ConfigError``.

    ``nuisance``: kinds of nuisances that are estimated beside what is asked for
    (:func:`sysid.fit.nuisance.checked_kinds`);
    ``per_bag``: parameters that each run has a value of its own of, named ``friction[run]``;
    ``bounds``: lowest and highest value of parameters by name, in their own units, within those that a fit has anyway;
    ``starts``: searches from different values, of which the rig's are the first (:mod:`sysid.fit.starts`);
    ``max_evaluations``: of all searches together, after which nothing is searched or looked into any more and the
    result says that it did not converge;
    ``intervals``: how far those of the parameters are looked into;
    ``robust``: leave out marker readings that are mistakes (:mod:`sysid.fit.outliers`);
    ``seed``: of everything random.
    """

    nuisance: Collection[str] = USUAL
    per_bag: Collection[str] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    starts: int = 1
    max_evaluations: int | None = None
    intervals: Intervals = "checked"
    robust: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        checked_kinds(self.nuisance)
        if self.max_evaluations is not None and self.max_evaluations < 1:
            raise ConfigError(f"A fit cannot be made in {self.max_evaluations} evaluations.", "Allow at least one.")
        if self.starts < 1:
            raise ConfigError(f"A fit cannot be made from {self.starts} starts.", "Start at least once.")

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds of nuisances that are estimated."""
        return checked_kinds(self.nuisance)
