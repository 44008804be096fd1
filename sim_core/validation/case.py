"""One comparison of the simulator with a known answer."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Case:
    """``reference`` and ``found`` in ``unit``; ``error``: relative; ``source``: where the answer is from."""

    name: str
    quantity: str
    unit: str
    reference: float
    found: float
    tolerance: float
    mesh: str
    source: str

    @property
    def error(self) -> float:
        return abs(self.found / self.reference - 1.0)

    @property
    def passed(self) -> bool:
        return self.error <= self.tolerance
