"""Contact and friction between the samples of one deformable surface and the triangles of another, or its own.

A sample p = sum_i w_i x_i is tested against the nearest of its candidate triangles, closest point
c = sum_j b_j y_j, at the distance d = |p - c| and with the gap

    g = d - offset

The distance has no sign: surfaces have two sides and no need of an orientation, because the solver never lets
them cross. (While an iteration may overlap on its way, d carries a sign: negative on the other side of the
triangle than at the start of the step.) With r = p - c and 1/2 d^2 = min over b of 1/2 |p - sum b y|^2 the
derivatives of d follow from the Schur complement of that small problem:

    grad d = r/d . dr,    hess(1/2 d^2) = E_zz - E_zb E_bb^-1 E_bz,
    hess d = (hess(1/2 d^2) - grad d grad d^T) / d

Where a sample is as near to two triangles (a concave crease, or between two layers) the smallest distance has a
kink on which it may come to rest without any balance of forces. The distances are therefore blended over a
width e, d = min over shares w of sum w_k d_k + e/2 (sum w_k^2 - 1), which is smooth and at most e/2 too small.

Friction acts on the motion of the sample relative to the frame of the nearest triangle at the start of the
step: to the point in that frame where the sample then was, so that the forces on both sides have no moment
although the surfaces are half their thicknesses apart. Laws: :mod:`sim_core.contact.pressure_and_friction`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.contact.added_laws import AddedLaws
from sim_core.contact.measures import Measures
from sim_core.contact.pressure_and_friction import (
    BLEND,
    LAW_OF,
    OFFSET,
    RANGE,
    REACH,
    coefficients,
    set_law,
)
from sim_core.contact.samples import Samples
from sim_core.energies.term import Internals, counted

CREASE_ROUNDING = 0.05
"""Width over which the distances to several triangles are blended, as a share of the pressure's range."""


class SurfaceContact:
    """Term for one ordered pair: samples of one surface against the triangles of another (or of the same).

    ``triangles``: int32 ``(m, 3)``, node indices. ``offset``: [m], half thicknesses of both surfaces
    together. ``margin_m``: how much wider than a step needs partners are looked for. ``bearing``: share of the
    law's range, less than one for samples that are to bear only where others fail. ``stops``: whether it keeps a
    surface out of a rigid shape where no point of the surface would, and so stands at its place whatever bears.
    """

    def __init__(
        self,
        name: str,
        samples: Samples,
        triangles: np.ndarray,
        offset: float,
        margin_m: float,
        bearing: float = 1.0,
        stops: bool = False,
    ) -> None:
        self.name = name
        self.bearing, self.stops = bearing, stops
        self.samples, self.margin_m = samples, margin_m
        self.triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        """Nodes of the triangles, int32 ``(m, 3)``."""
        self.border = _free_features(self.triangles)
        """Which corners 0..2 and edges 01, 12, 20 of the triangles are on a free border, int32 ``(m, 6)``."""
        self.areas = np.ascontiguousarray(samples.areas)
        """Areas of the samples [m^2] ``(n,)``."""
        self.law = coefficients(offset)
        """Numbers of the law, as :mod:`sim_core.contact.pressure_and_friction` lays them out ``(8,)``."""
        self.laws = AddedLaws(bears=bearing == 1.0)

    @property
    def nodes(self) -> np.ndarray:
        """Nodes of both surfaces, int ``(k,)``."""
        return np.unique(np.concatenate([self.samples.nodes.ravel(), self.triangles.ravel()]))

    @property
    def measures(self) -> list[Measures]:
        """What is measured at rest: areas of the samples."""
        return [] if self.samples.shared is None else [self.samples.shared]

    def law_by(self, quantity: str) -> dict[int, float]:
        """Derivatives of the numbers of :attr:`law` by one that it is given by name, by their places."""
        if quantity != "range_m":
            return {LAW_OF[quantity]: 1.0}
        return {RANGE: self.bearing, BLEND: CREASE_ROUNDING * self.bearing}

    @property
    def offset(self) -> float:
        """Distance [m] at which there is no gap."""
        return float(self.law[OFFSET])

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take the numbers of the law, and of those that effects add."""
        set_law(self.law, parameters)
        self.law[RANGE] *= self.bearing
        self.law[BLEND] = CREASE_ROUNDING * self.law[RANGE]
        self.laws.configure(parameters)
        self.law[REACH] = max(self.law[RANGE], self.laws.reach())

    def initial_internals(self) -> Internals:
        """No spring is stretched, and nothing bears."""
        count = len(self.areas)
        return {"anchor": np.zeros((count, 3)), "load": np.zeros(count), "slip_speed": np.zeros(count)}


def _free_features(triangles: np.ndarray) -> np.ndarray:
    """For each triangle: corners 0..2 and edges 3..5 (01, 12, 20) on a free border, int32 ``(m, 6)``."""
    border = np.zeros((len(triangles), 6), dtype=np.int32)
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
    unique, inverse, counts = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    border[:, 3:] = (counts == 1)[inverse.reshape(-1)].reshape(-1, 3)
    border[:, :3] = np.isin(triangles, np.unique(unique[counts == 1]))
    return border
