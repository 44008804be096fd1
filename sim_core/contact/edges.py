"""Contact and friction between the edges of two surfaces, or of one with itself.

Points held by faces need no more; but edges that cross, and the sharp edges of rigid bodies, meet between the
points. Two edges with the closest points p and q at the distance d = |p - q| have the energy

    E = A m psi(d - offset),    A = half the sum of the two edges' areas (a third of the triangles adjacent to each)

with the mollifier m against nearly parallel edges (:mod:`sim_core.contact.segments`). The range of this law is
half that of the points' (:class:`SurfaceContact`): edges bear only where points have let the surfaces come too
near, so that what a smooth contact carries depends on no mesh. Friction acts on the relative motion of the
points that were closest at the start of the step, less the turning of their common normal, with the mollifier
on its stiffness too. Laws:
:mod:`sim_core.contact.pressure_and_friction`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.contact.added_laws import AddedLaws
from sim_core.contact.measures import Measures, SharedAreas, SquaredLengths
from sim_core.contact.pressure_and_friction import LAW_OF, OFFSET, RANGE, coefficients, set_law
from sim_core.energies.term import Internals, counted

EDGE_RANGE = 0.5
"""Range of the edges' law as a share of the points'."""


@dataclass(frozen=True)
class EdgeSide:
    """Edges of one side: nodes int32 ``(n, 2)``, areas [m^2] ``(n,)`` (None: those of the other side count) and squared
    lengths at rest [m^2] ``(n,)``."""

    edges: np.ndarray
    areas: np.ndarray | None
    squares: np.ndarray


class EdgeContact:
    """Term for one pair of sets of edges.

    ``ours``, ``theirs``: int32 ``(n, 2)``, node indices, or ``theirs`` None: all pairs of ours. ``areas``: [m^2]
    of our edges, ``their_areas``: of theirs, None for rigid edges, which count as much as ours. ``rest``: [m]
    ``(n_nodes, 3)``. ``offset``: [m], half thicknesses of both surfaces together. ``margin_m``: how much wider
    than a step needs partners are looked for. ``shared``: of which triangles at rest the areas of our edges, and of
    theirs, are shares.
    """

    def __init__(
        self,
        name: str,
        ours: np.ndarray,
        areas: np.ndarray,
        theirs: np.ndarray | None,
        their_areas: np.ndarray | None,
        rest: np.ndarray,
        offset: float,
        margin_m: float,
        shared: Sequence[SharedAreas] = (),
        stops: bool = False,
    ) -> None:
        self.name, self.stops, self.margin_m = name, stops, margin_m
        self._shared = list(shared)
        first = _side(ours, areas, rest)
        self.sides = first, first if theirs is None else _side(theirs, their_areas, rest)
        """Our edges and theirs; twice the same where all pairs of ours meet."""
        self.law = coefficients(offset)
        """Numbers of the law, as :mod:`sim_core.contact.pressure_and_friction` lays them out ``(8,)``."""
        self.laws = AddedLaws(bears=False)

    @property
    def nodes(self) -> np.ndarray:
        """Nodes of all edges, int ``(k,)``."""
        return np.unique(np.concatenate([side.edges.ravel() for side in self.sides]))

    @property
    def measures(self) -> list[Measures]:
        """What is measured at rest: areas of our edges, then of theirs, then squared lengths of both."""
        ours, theirs = self.sides
        sides = [ours.edges] if theirs is ours else [ours.edges, theirs.edges]
        lengths = [SquaredLengths(side) for side in sides[: len(self._shared)]]
        return [*self._shared, *lengths]

    def law_by(self, quantity: str) -> dict[int, float]:
        """Derivatives of the numbers of :attr:`law` by one that it is given by name, by their places."""
        return {LAW_OF[quantity]: EDGE_RANGE if quantity == "range_m" else 1.0}

    @property
    def offset(self) -> float:
        """Distance [m] at which there is no gap."""
        return float(self.law[OFFSET])

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take the numbers of the law, and of those that effects add."""
        set_law(self.law, parameters)
        self.law[RANGE] *= EDGE_RANGE
        self.laws.configure(parameters)

    def initial_internals(self) -> Internals:
        """No pair is near."""
        return {"pair": np.empty(0), "anchor": np.empty((0, 3)), "load": np.empty(0), "slip_speed": np.empty(0)}


def _side(edges: np.ndarray, areas: np.ndarray | None, rest: np.ndarray) -> EdgeSide:
    squares = ((rest[edges[:, 1]] - rest[edges[:, 0]]) ** 2).sum(axis=1)
    return EdgeSide(np.ascontiguousarray(edges, dtype=np.int32), areas, squares)
