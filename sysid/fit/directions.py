"""The simulator's own error as known shapes of uncertain size, which fits carry as nuisance parameters.

A refinement of the mesh (or of the time step) shows the shape d(t) of the discretisation error of every
reading, but only estimates its size, and the estimate need not be equally good all the time: while a body
rolls over an element edge or starts to slip it is off by more than during a hold. The error is therefore
taken to be

    e(t) = d(t) (mean + sd (c_0 + sum_k c_k h_k(t))),    c_0, c_k ~ N(0, 1),

with h_k the hat functions of :data:`KNOTS` equidistant instants of the run, for each quantity of each
channel of each run apart. The coefficients are eliminated from the least-squares problem, so intervals and
evidence are those with the error integrated out (the discrepancy of Kennedy & O'Hagan 2001 with a basis
from the solver instead of a stationary kernel).

The expected size lies between that of a recording made by this very simulator (none of the error) and that
of reality (all of it).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sysid.fit.noise import column_groups
from sysid.fit.runs import Measured, Run

EXPECTED = 0.5
"""Expected size of a direction, in units of the extrapolated error."""

RIGHT_SD = 0.5
"""Standard deviation of the size of a direction about its expected value, and of its change in time."""

KNOTS = 6
"""Instants of a run between which the size of a direction is interpolated."""


@dataclass(frozen=True)
class Direction:
    """A known shape of error for each run and channel, with an uncertain size that may drift.

    ``shapes[run index][channel]``: ``(n, m)`` in measured units, as measured at the scaled parameters
    ``at`` ``(p,)``; ``slopes``: their derivatives by the parameters ``(n, m, p)``, where they are known.
    Size: normal with ``mean`` and ``sd``.
    """

    label: str
    shapes: tuple[dict[str, np.ndarray], ...]
    mean: float = EXPECTED
    sd: float = RIGHT_SD
    slopes: tuple[dict[str, np.ndarray], ...] = ()
    at: np.ndarray | None = None

    def of_runs(self, which: slice) -> Direction:
        """The same direction for some of the runs."""
        return replace(self, shapes=self.shapes[which], slopes=self.slopes[which])


@dataclass(frozen=True)
class Basis:
    """Directions of one channel of one run. ``expected`` ``(n, m)``: the error with the expected sizes, at
    the parameters ``at``; ``slopes`` ``(n, m, p)``: its derivatives by them (``p`` = 0: not known);
    ``columns`` ``(n, m, k)``: its changes for coefficients of unit variance; ``times`` ``(k,)`` [s]: to
    which instant a coefficient belongs."""

    expected: np.ndarray
    slopes: np.ndarray
    at: np.ndarray
    columns: np.ndarray
    times: np.ndarray


def basis_of(directions: list[Direction], index: int, run: Run, measured: Measured) -> Basis:
    """The basis of one channel of run number ``index``."""
    t = measured.t
    knots = np.linspace(0.0, max(run.end, 1e-9), KNOTS)
    hats = np.clip(1.0 - np.abs(t[:, None] - knots) / (knots[1] - knots[0]), 0.0, None)
    drift = np.column_stack([np.ones(len(t)), hats])
    expected = np.zeros(measured.values.shape)
    at = next((d.at for d in directions if d.at is not None), np.zeros(0))
    slopes = np.zeros((*expected.shape, len(at)))
    columns, times = [np.zeros((*expected.shape, 0))], [np.zeros(0)]
    for direction in directions:
        shape = direction.shapes[index].get(measured.channel)
        if shape is None:
            continue
        expected += direction.mean * shape
        if direction.slopes:
            slopes += direction.mean * direction.slopes[index][measured.channel]
        for group in column_groups(measured):
            part = np.zeros(shape.shape)
            part[:, group] = shape[:, group]
            if np.any(part):
                columns.append(direction.sd * part[:, :, None] * drift[:, None, :])
                times.append(np.concatenate([[0.5 * run.end], knots]))
    return Basis(expected, slopes, at, np.concatenate(columns, axis=2), np.concatenate(times))
