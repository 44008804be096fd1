"""What can be chosen about a fit."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args

from sim_core.errors import ConfigError
from sysid.model.nuisance_parameters import KINDS, checked_kinds

Intervals = Literal["quadratic", "checked", "profiled"]
"""Intervals from the covariance alone; with a simulation at each end that tells whether they hold; or those of the
profile likelihood in addition (:mod:`sysid.uncertainty.profiler`)."""


@dataclass(frozen=True)
class FitOptions:
    """Choices of a fit, checked. Raises ``ConfigError``.

    ``nuisance``: kinds of nuisances that are estimated with what is asked for
    (:func:`sysid.model.nuisance_parameters.checked_kinds`);
    ``per_bag``: parameters that each run has a value of its own of, named ``friction[run]``;
    ``bounds``: lowest and highest value of parameters by name, in their own units, within those that a fit has anyway;
    ``priors``: what is known of parameters before, by name: value and standard deviation in their own units, to which
    they are pulled;
    ``starts``: searches from different values, of which the rig's are the first (:mod:`sysid.fit.multistart`);
    ``max_evaluations``: of all searches together, after which nothing is searched or looked into any more and the
    result says that it did not converge;
    ``intervals``: how far those of the parameters are looked into;
    ``robust``: leave out readings that are mistakes (:mod:`sysid.solve.outliers`);
    ``seed``: of everything random.
    """

    nuisance: Collection[str] = KINDS
    per_bag: Collection[str] = ()
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    priors: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    starts: int = 1
    max_evaluations: int | None = None
    intervals: Intervals = "checked"
    robust: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("nuisance", "per_bag"):
            if isinstance(getattr(self, name), str):
                raise ConfigError(f"{name} is the text {getattr(self, name)!r}.", "Give a list of names.")
        checked_kinds(self.nuisance)
        if self.intervals not in get_args(Intervals):
            raise ConfigError(f"There are no intervals {self.intervals!r}.", f"Use {', '.join(get_args(Intervals))}.")
        numbers = {"max_evaluations": self.max_evaluations, "starts": self.starts, "seed": self.seed}
        for name, number in numbers.items():
            if number is not None and (isinstance(number, bool) or not isinstance(number, int)):
                raise ConfigError(f"{name} is {number!r}.", "Give a whole number.")
        if self.max_evaluations is not None and self.max_evaluations < 1:
            raise ConfigError(f"A fit cannot be made in {self.max_evaluations} evaluations.", "Allow at least one.")
        for name, (value, sd) in self.priors.items():
            if not (math.isfinite(value) and 0.0 < sd < math.inf):
                raise ConfigError(
                    f"What is known of {name}, {value:g} +- {sd:g}, is no value with a standard deviation.",
                    "Give finite numbers, the second above zero.",
                )
        if self.starts < 1:
            raise ConfigError(f"A fit cannot be made from {self.starts} starts.", "Start at least once.")
        if self.seed < 0:
            raise ConfigError(f"The seed is {self.seed}.", "Give a number that is not negative.")

    def to_json(self) -> dict[str, Any]:
        """What was chosen, as JSON, but for the seed; None: no bound on that side."""
        chosen = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "seed"}
        bounds = {name: [b if math.isfinite(b) else None for b in pair] for name, pair in self.bounds.items()}
        return {**chosen, "nuisance": sorted(self.kinds), "per_bag": list(self.per_bag), "bounds": bounds}

    @property
    def kinds(self) -> frozenset[str]:
        """The kinds of nuisances that are estimated."""
        return checked_kinds(self.nuisance)
