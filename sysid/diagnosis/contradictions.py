"""Where the fitted baseline stands far from what the rig says of its parameters and nuisances."""

from __future__ import annotations

from dataclasses import dataclass

from sysid.model.parameters import start_of
from sysid.settings.diagnosis import DIAGNOSIS
from sysid.solve.optimum import Fitted


@dataclass(frozen=True)
class Contradiction:
    """``value``, ``nominal``: in ``unit``, as fitted and as the rig says; ``deviations``: their distance, in standard
    deviations of what was known before."""

    name: str
    unit: str
    value: float
    nominal: float
    deviations: float

    @property
    def fitted(self) -> str:
        """The fitted value with its unit."""
        return f"{self.value:.4g} {self.unit}".rstrip()


def contradictions(fitted: Fitted) -> tuple[Contradiction, ...]:
    """Parameters whose fitted values are ``DIAGNOSIS.far_from_known_sd`` standard deviations or more from what was
    known of them, farthest first."""
    found = []
    start = start_of(fitted.centre, fitted.parameters)
    for p, scaled, first in zip(fitted.parameters, fitted.scaled, start, strict=True):
        away = abs(float(scaled - first)) / (p.known_sd or p.prior_sd)
        if away > DIAGNOSIS.far_from_known_sd:
            found.append(Contradiction(p.name, p.unit, p.physical(scaled), p.physical(first), away))
    return tuple(sorted(found, key=lambda c: -c.deviations))
