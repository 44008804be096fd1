"""One comparison of the simulator with a known answer."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """``reference`` and ``found`` in ``unit``; ``error``: relative; ``source``: where the answer is from;
    ``coarser``: what is found on cells twice as large, if that was tried."""

    name: str
    quantity: str
    unit: str
    reference: float
    found: float
    tolerance: float
    mesh: str
    source: str
    coarser: float | None = None

    @property
    def error(self) -> float:
        return abs(self.found / self.reference - 1.0)

    @property
    def order(self) -> float | None:
        """Observed order of convergence: log2 of the errors on cells twice as large and on these."""
        if self.coarser is None or self.error == 0.0:
            return None
        return math.log2(abs(self.coarser / self.reference - 1.0) / self.error)

    @property
    def passed(self) -> bool:
        return self.error <= self.tolerance
