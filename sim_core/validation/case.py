"""One comparison of the simulator with a known answer, and one that is not made."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

STATICS, FREQUENCIES, FORCES, THRESHOLDS = 0.01, 0.02, 0.03, 0.05
"""Errors allowed of static shapes, natural frequencies, contact forces and thresholds (buckling, slip, yield)."""


@dataclass(frozen=True)
class Case:
    """``reference`` and ``found`` in ``unit``; ``source``: where the answer is from; ``coarser``: what is found on
    cells twice as large, if that was tried; ``scale``: the error is relative to it (none: to the reference);
    ``remark``: what a reader has to know."""

    name: str
    quantity: str
    unit: str
    reference: float
    found: float
    tolerance: float
    mesh: str
    source: str
    coarser: float | None = None
    scale: float | None = None
    remark: str = ""

    def _error(self, found: float) -> float:
        return float(abs(found - self.reference) / abs(self.reference if self.scale is None else self.scale))

    @property
    def error(self) -> float:
        return self._error(self.found)

    @property
    def order(self) -> float | None:
        """Observed order of convergence: log2 of the errors on cells twice as large and on these."""
        if self.coarser is None or self.error == 0.0 or self._error(self.coarser) == 0.0:
            return None
        return math.log2(self._error(self.coarser) / self.error)

    @property
    def passed(self) -> bool:
        return bool(self.error <= self.tolerance)


@dataclass(frozen=True)
class NotCovered:
    """A known answer that the simulator does not claim to give, and why."""

    name: str
    reason: str
    source: str


def compare(
    name: str,
    quantities: Sequence[str],
    references: Sequence[float],
    found: Sequence[float],
    tolerance: float,
    mesh: str,
    source: str,
    coarser: Sequence[float] | None = None,
    unit: str = "1",
    scale: float | None = None,
    remark: str = "",
) -> Iterator[Case]:
    """A case for each of several quantities of one run."""
    others: Sequence[float | None] = [None] * len(found) if coarser is None else coarser
    for quantity, reference, value, other in zip(quantities, references, found, others, strict=True):
        yield Case(name, quantity, unit, reference, value, tolerance, mesh, source, other, scale, remark)
