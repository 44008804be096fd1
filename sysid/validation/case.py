"""One comparison of the simulator with a known answer, and one that is not made."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

STATICS, FREQUENCIES, FORCES, THRESHOLDS = 0.01, 0.02, 0.03, 0.05
"""Errors allowed of static shapes, natural frequencies, contact forces and thresholds (buckling, slip, yield)."""


LEAST_ORDER = 0.95
"""Of convergence with the size of the cells or of the steps: one, seen on cells that are not infinitely small."""


@dataclass(frozen=True)
class Case:
    """``reference`` and ``found`` in ``unit``; ``source``: where the answer is from; ``coarser``: what is found on
    coarser meshes, the coarsest first, cells ``ratio`` times as large as on the next; ``scale``: the error is relative
    to it (none: to the reference); ``together``: the error of all quantities of this run, on all meshes; ``remark``:
    what a reader has to know; ``cpu_s``: processor time that it took [s], if it was measured."""

    name: str
    quantity: str
    unit: str
    reference: float
    found: float
    tolerance: float
    mesh: str
    source: str
    coarser: tuple[float, ...] = ()
    scale: float | None = None
    remark: str = ""
    ratio: float = 2.0
    together: tuple[float, ...] = ()
    cpu_s: float | None = None

    def _error(self, found: float) -> float:
        return float(abs(found - self.reference) / abs(self.reference if self.scale is None else self.scale))

    @property
    def error(self) -> float:
        return self._error(self.found)

    @property
    def errors(self) -> list[float]:
        """On all meshes, the coarsest first."""
        return [self._error(found) for found in (*self.coarser, self.found)]

    @property
    def order(self) -> float | None:
        """Observed order of convergence: the slope from the coarsest mesh to the finest of the logarithm of the error
        over that of the cells. The error is that of the whole run, as one quantity may be right by accident on one
        mesh."""
        errors = list(self.together) or self.errors
        if len(errors) < 2 or min(errors[0], errors[-1]) == 0.0:
            return None
        return math.log(errors[0] / errors[-1]) / math.log(self.ratio) / (len(errors) - 1)

    @property
    def passed(self) -> bool:
        return bool(self.error <= self.tolerance) and (self.order is None or self.order >= LEAST_ORDER)


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
    runs: Sequence[Sequence[float]],
    tolerance: float,
    mesh: str,
    source: str,
    unit: str = "1",
    scale: float | None = None,
    remark: str = "",
) -> Iterator[Case]:
    """A case for each of several quantities; ``runs``: what is found on one mesh after another, each with cells half
    as large as the one before."""
    cases = []
    for k, (quantity, reference) in enumerate(zip(quantities, references, strict=True)):
        *coarser, found = (float(run[k]) for run in runs)
        cases.append(
            Case(
                name, quantity, unit, float(reference), found, tolerance, mesh, source, tuple(coarser), scale, remark,
            )
        )  # fmt: skip
    together = tuple(math.hypot(*errors) for errors in zip(*(case.errors for case in cases), strict=True))
    yield from (replace(case, together=together) for case in cases)
