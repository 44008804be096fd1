"""Contact and friction between the edges of two surfaces, or of one with itself.

Points held by faces need no more; but edges that cross, and the sharp edges of rigid bodies, meet between the
points. Two edges with the closest points p and q at the distance d = |p - q| have the energy

    E = A m psi(d - offset),    A = half the sum of the two edges' areas (a third of the triangles beside each)

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
from sim_core.contact.broad_phase import Candidates
from sim_core.contact.edge_kernels import (
    add_energy,
    add_gradient,
    add_hessian,
    distances,
    frames,
    free_way,
    measure,
    sides,
)
from sim_core.contact.local_frame_derivatives import AtRest, Loads, Pairs, exerted, framed_derivatives, memory_places
from sim_core.contact.local_frame_kernels import Frames
from sim_core.contact.measures import Measures, SharedAreas, SquaredLengths
from sim_core.contact.pair_distance import PairDistance
from sim_core.contact.pressure_and_friction import (
    LAW_OF,
    OFFSET,
    RANGE,
    STIFFNESS,
    by_range,
    coefficients,
    normal_law,
    set_guard,
    set_law,
    slide,
)
from sim_core.contact.primitives import Primitives
from sim_core.contact.segments import PARALLEL
from sim_core.energies.linearised import Linearised, cross, places
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.kernels import BoundKernel

EDGE_RANGE = 0.5
"""Range of the edges' law as a share of the points'."""

SPARE = 1024
"""Places for pairs at the start; doubled whenever they do not suffice."""


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

    mirrored = True
    measured_at_rest = True

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
        self.name, self.stops = name, stops
        self._shared = list(shared)
        self._ours = np.ascontiguousarray(ours, dtype=np.int32)
        self._theirs = self._ours if theirs is None else np.ascontiguousarray(theirs, dtype=np.int32)
        self._areas = areas
        self._their_areas = areas if theirs is None else their_areas
        self._squares = [((rest[e[:, 1]] - rest[e[:, 0]]) ** 2).sum(axis=1) for e in (self._ours, self._theirs)]
        self.margin_m = margin_m
        distance = PairDistance(distances, self._ours, self._theirs)
        sides = Primitives(self._ours), Primitives(self._theirs)
        self._candidates = Candidates(*sides, offset, distance, once=theirs is None)
        self._keys = np.empty(0, dtype=np.int64)
        self._c = coefficients(offset)
        self.laws = AddedLaws(bears=False)
        self._count = np.zeros(1, dtype=np.int32)
        self._exact = np.zeros(1, dtype=np.int32)
        self._keep, self._way = np.zeros(1), np.ones(1)
        self._frames_by = Frames()
        self._allocate(SPARE)

    def _allocate(self, capacity: int) -> None:
        self._ends = np.zeros((capacity, 4), dtype=np.int32)
        self._area, self._parallel, self._side = np.zeros(capacity), np.zeros(capacity), np.ones(capacity)
        self._limit, self._load, self._spring = (np.zeros(capacity) for _ in range(3))
        self._anchor, self._frame = np.zeros((capacity, 3)), np.zeros((capacity, 36))
        self._now, self._lag = _Closest(capacity), _Closest(capacity)

    def blocks(self) -> np.ndarray:
        """Pairs of the ends of all pairs of edges in the wider search."""
        first, second = self._candidates.coupled
        ends = np.hstack([self._ours[first], self._theirs[second]])
        a, b = np.triu_indices(4)
        return np.stack([ends[:, a], ends[:, b]], axis=-1).reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        del slots
        assert buffers.pairs is not None
        self._buffers = buffers
        self._x = buffers.x
        self._x_start, self._from, self._move = (np.zeros_like(buffers.x) for _ in range(3))
        self._seen = np.full_like(buffers.x, np.nan)
        self._bind_pairs()

    def _bind_pairs(self) -> None:
        buffers, now, lag = self._buffers, self._now, self._lag
        table = buffers.pairs
        assert table is not None
        first, second, curved = np.zeros((4, 3)), np.zeros((16, 3, 3)), np.zeros((16, 3, 3))
        pairs = (self._count, self._ends)
        rubbing = (self._limit, self._spring, self._frame, lag.direction, self._anchor)
        laws = (self._x, self._x_start, *pairs, self._area, self._c, *rubbing)
        here = (now.fade, now.gap)
        self._energy = BoundKernel(add_energy, *laws, *here, buffers.energy)
        self._gradient = BoundKernel(
            add_gradient, *laws, *here, now.at, now.direction, self._load, first, second, buffers.gradient
        )
        self._hessian = BoundKernel(
            add_hessian,
            *(*laws, *here, now.at, now.direction, now.sign, self._parallel, self._exact),
            *(table.start, table.column, table.place, first, second, curved, buffers.hessian),
        )
        shape = (*pairs, self._parallel, self._side, self._c)
        self._measure = BoundKernel(measure, self._x, *shape, *now.arrays())
        self._start = BoundKernel(measure, self._x_start, *shape, *lag.arrays())
        self._frames = BoundKernel(frames, self._x_start, *pairs, lag.at, self._frame)
        self._sides = BoundKernel(sides, self._x_start, *pairs, self._side)
        self._free = BoundKernel(free_way, self._from, self._move, *pairs, self._c, self._keep, self._way)

    @property
    def measures(self) -> list[Measures]:
        """What is measured at rest: areas of our edges, then of theirs, then squared lengths of both."""
        sides = [self._ours] if self._theirs is self._ours else [self._ours, self._theirs]
        lengths = [SquaredLengths(side) for side in sides[: len(self._shared)]]
        return [*self._shared, *lengths]

    @property
    def law(self) -> np.ndarray:
        """Numbers of the law, as :mod:`sim_core.contact.pressure_and_friction` lays them out ``(8,)``."""
        return self._c

    def law_by(self, quantity: str) -> dict[int, float]:
        """Derivatives of the numbers of :attr:`law` by one that it is given by name, by their places."""
        return {LAW_OF[quantity]: EDGE_RANGE if quantity == "range_m" else 1.0}

    @property
    def sides(self) -> tuple[EdgeSide, EdgeSide]:
        """Our edges and theirs; twice the same where all pairs of ours meet."""
        ours = EdgeSide(self._ours, self._areas, self._squares[0])
        if self._theirs is self._ours:
            return ours, ours
        return ours, EdgeSide(self._theirs, self._their_areas, self._squares[1])

    @property
    def offset(self) -> float:
        """Distance [m] at which there is no gap."""
        return float(self._c[OFFSET])

    def configure(self, parameters: Mapping[str, float]) -> None:
        set_law(self._c, parameters)
        self._c[RANGE] *= EDGE_RANGE
        self.laws.configure(parameters)

    def guard(self, on: bool) -> None:
        """Distances without sign and the law itself, or with sign and a law that bears overlap."""
        set_guard(self._c, on)
        self._seen[:] = np.nan

    def prepare(self, step: StepContext, towards: np.ndarray, more: bool = False) -> bool:
        """Look for candidates from the start of a step on; True when the coupled nodes changed."""
        inner, outer = self._candidates.search(step.x_start, towards, self._c[RANGE], self.margin_m, more)
        if inner:
            first, second = self._candidates.pairs
            count = len(first)
            if count > len(self._area):
                self._allocate(2 * count)
                self._bind_pairs()
            self._count[0] = count
            self._keys = self._candidates.keys
            self._ends[:count] = np.hstack([self._ours[first], self._theirs[second]])
            areas = self._areas[first]
            if self._their_areas is not None:
                areas = 0.5 * (areas + self._their_areas[second])
            self._area[:count] = areas
            self._members = first, second
            self._parallel[:count] = PARALLEL * self._squares[0][first] * self._squares[1][second]
        return outer

    def recouple(self, step: StepContext, towards: np.ndarray) -> None:
        """Renew the coupled nodes, because those of another contact changed."""
        self._candidates.recouple(step.x_start, towards)

    def forget(self) -> None:
        """Look for candidates afresh next time."""
        self._candidates.forget()

    def outran(self) -> bool:
        """True when something may have come into contact that was not looked at."""
        return self._candidates.outran(self._x)

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        self._x_start[:] = step.x_start
        self._seen[:] = np.nan
        count = self._count[0]
        self._anchor[:count], load, speed = self._remembered(internals)
        self._sides()
        self._start()
        self._frames()
        self._limit[:count] = self.laws.bound(self._c, load, self._area[:count], speed).value
        self._spring[:count] = self._c[STIFFNESS] * self._area[:count] * self._lag.fade[:count, 0]

    def _remembered(self, internals: Internals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Elastic slip, load and slip speed of the candidates that were candidates before, else zero."""
        known = np.rint(internals["pair"]).astype(np.int64)
        anchor, load, speed = np.zeros((len(self._keys), 3)), np.zeros(len(self._keys)), np.zeros(len(self._keys))
        _, old, new = np.intersect1d(known, self._keys, assume_unique=True, return_indices=True)
        anchor[new], load[new], speed[new] = (internals[n][old] for n in ("anchor", "load", "slip_speed"))
        return anchor, load, speed

    def _look(self) -> bool:
        """Bring the gaps up to date with the positions; False when there is nothing to touch."""
        if not self._count[0]:
            return False
        if not np.array_equal(self._seen, self._x):
            self._measure()
            self._seen[:] = self._x
        return True

    def add_energy(self) -> None:
        if self._look():
            self._energy()

    def add_gradient(self) -> None:
        if self._look():
            self._gradient()

    def add_hessian(self, exact: bool) -> None:
        if self._look():
            self._exact[0] = exact
            self._hessian()

    def free_way(self, start: np.ndarray, move: np.ndarray, keep: float, turn: tuple[float, float]) -> float:
        """Share of ``move`` from ``start`` on (both [m] ``(n, 3)``) on which gaps keep the share ``keep``."""
        del turn
        if not self._count[0]:
            return 1.0
        self._from[:], self._move[:], self._keep[0], self._way[0] = start, move, keep, 1.0
        self._free()
        return float(self._way[0])

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Carry elastic slip, load and slip speed of every candidate; zero where nothing touches."""
        del internals
        count = self._count[0]
        if not self._look():
            return self.initial_internals()
        slip = self._anchor[:count] + self._past(self._x - self._x_start)
        anchor, speed = slide(slip, self._lag.direction[:count], self._limit[:count], self._spring[:count], step.dt)
        load = self._load[:count].copy()
        touching = load > 0.0
        return {
            "pair": self._keys.astype(float),
            "anchor": np.where(touching[:, None], anchor, 0.0),
            "load": load,
            "slip_speed": np.where(touching, speed, 0.0),
        }

    def _past(self, move: np.ndarray) -> np.ndarray:
        """How far the edges of pairs go past each other, for a move of all nodes [m] ``(n, 3)``."""
        count = self._count[0]
        frames = self._frame[:count].reshape(-1, 4, 3, 3)
        return np.asarray(np.einsum("skij,skj->si", frames, move[self._ends[:count]]))

    def carried(self, internals: Internals, move: np.ndarray) -> Internals:
        """Internal variables with the springs of friction stretched by a move of the start."""
        known, anchor = np.rint(internals["pair"]).astype(np.int64), internals["anchor"].copy()
        _, old, new = np.intersect1d(known, self._keys, assume_unique=True, return_indices=True)
        anchor[old] += np.where(internals["load"][old, None] > 0.0, self._past(move)[new], 0.0)
        return {**internals, "anchor": anchor}

    @staticmethod
    def aligned(internals: Internals, like: Internals) -> Internals:
        """Internal variables of the pairs of ``like`` in their order, zero where a pair is none of these."""
        if np.array_equal(internals["pair"], like["pair"]):
            return internals
        out = {name: np.zeros_like(a) for name, a in like.items()}
        _, new, old = np.intersect1d(like["pair"], internals["pair"], return_indices=True)
        for name, a in out.items():
            a[new] = internals[name][old]
        return {**out, "pair": like["pair"]}

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised:
        """Derivatives by the start of the step and the memory."""
        if not self._look():
            return Linearised()
        count = self._count[0]
        some = np.flatnonzero((self._limit[:count] > 0.0) | (self._now.gap[:count] < self._c[RANGE]))
        if not len(some):
            return Linearised()
        nodes, area = self._ends[some], self._area[some]
        start, end = step.x_start[nodes], self._x[nodes]
        memory, then = (_places_of(known, self._keys[some]) for known in (internals, after))
        _, load, speed = (old[some] for old in self._remembered(internals))
        _, push, steep = normal_law(self._c, self._now.gap[some])
        bound = self.laws.bound(self._c, load, area, speed)
        fade, by_fade = self._now.fade[some].T
        pairs = Pairs(
            nodes, np.arange(4), np.ones((len(some), 4)), end - start, self._limit[some],
            self._spring[some], memory, then, self._anchor[some], bound, area * fade * push,
        )  # fmt: skip
        turned = (self._c[STIFFNESS] * area * self._lag.fade[some, 1])[:, None, None] * _parallel_derivative(start)
        self._frames_by.of_edges(start, self._lag.at[some], self._lag.direction[some], turned)
        s, t = self._now.at[some].T
        shares = np.column_stack([1.0 - s, s, t - 1.0, -t])
        loads = -(area * fade * steep)[:, None, None] * shares[..., None] * self._now.direction[some][:, None]
        loads += (area * by_fade * push)[:, None, None] * _parallel_derivative(end)
        sizes = (len(self._x), sum(a.size for a in internals.values()), sum(a.size for a in after.values()))
        stored, wider = (EDGE_RANGE * area * found for found in by_range(self._c, self._now.gap[some]))
        widened = -(fade * wider)[:, None, None] * shares[..., None] * self._now.direction[some][:, None]
        widened += (by_fade * stored)[:, None, None] * _parallel_derivative(end)
        by = Loads(loads, nodes, area * fade * steep, loads, fade * wider, widened)
        total = exerted(self.add_gradient, self._buffers)
        opening = shares[..., None] * self._now.direction[some][:, None], _parallel_derivative(end)
        at_rest = self._at_rest(some, push, bound.by_area, *opening)
        return framed_derivatives(pairs, self._frames_by, by, at_rest, total, self._c, step.dt, sizes)

    def _at_rest(
        self, some: np.ndarray, push: np.ndarray, by_area: np.ndarray, opening: np.ndarray, spread: np.ndarray
    ) -> AtRest:
        """Derivatives of some pairs by what is measured at rest: of A m psi by A, and by e of the mollifier, with
        y = c/e, dm/de = -y dm/dc and d2m/dcde = (4 y - 2) / e^2. ``push``: pressures [Pa]; ``by_area``: derivatives of
        the friction bounds; ``opening``, ``spread``: derivatives of gaps and of c = |u x v|^2 by the ends ``(n, 4,
        3)``."""
        e, area = self._parallel[some], self._area[some]
        stored = normal_law(self._c, self._now.gap[some])[0]
        spring, load, pressing = [], [], []
        now, lag = self._now.fade[some], self._lag.fade[some]
        limit = [by_area, np.zeros_like(by_area)]
        wide = [1.0 - 0.5 * fade[:, 1] * e for fade in (now, lag)]
        mixed = np.where(now[:, 1] > 0.0, (4.0 * wide[0] - 2.0) / e**2, 0.0)
        for scale, fade, slope, before in (
            (np.ones(len(e)), now[:, 0], now[:, 1], lag[:, 0]),
            (area, -wide[0] * now[:, 1], mixed, -wide[1] * lag[:, 1]),
        ):
            spring.append(self._c[STIFFNESS] * scale * before)
            load.append(scale * fade * push)
            bend = scale * slope * stored
            pressing.append(bend[:, None, None] * spread - load[-1][:, None, None] * opening)
        return self._by_measures(some, [np.stack(a, axis=-1) for a in (spring, limit, load, pressing)])

    def _by_measures(self, some: np.ndarray, by: list[np.ndarray]) -> AtRest:
        """From derivatives by A and e, last axis, to those by the measures of both edges of a pair."""
        first, second = (member[some] for member in self._members)
        ours, theirs = len(self._ours), len(self._theirs)
        e = self._parallel[some]
        lengths = [e / self._squares[0][first], e / self._squares[1][second]]
        one = np.ones(len(some))
        if self._theirs is self._ours:
            count, parts = 2 * ours, [(0, first, 0.5 * one), (0, second, 0.5 * one)]
            parts += [(1, ours + first, lengths[0]), (1, ours + second, lengths[1])]
        elif self._their_areas is None:
            count, parts = 2 * ours, [(0, first, one), (1, ours + first, lengths[0])]
        else:
            count, parts = 2 * (ours + theirs), [(0, first, 0.5 * one), (0, ours + second, 0.5 * one)]
            parts += [(1, ours + theirs + first, lengths[0]), (1, 2 * ours + theirs + second, lengths[1])]
        which = [k for k, _, _ in parts]
        share = np.column_stack([s for _, _, s in parts])
        spring, bound, load, pressing = (
            b[..., which] * share.reshape(len(share), *([1] * (b.ndim - 2)), -1) for b in by
        )
        return AtRest(spring, bound, load, pressing, np.column_stack([column for _, column, _ in parts]), count)

    def initial_internals(self) -> Internals:
        return {"pair": np.empty(0), "anchor": np.empty((0, 3)), "load": np.empty(0), "slip_speed": np.empty(0)}

    def contacts(self) -> tuple[int, float]:
        """Number of loaded pairs and smallest gap [m] at the last gradient."""
        count = self._count[0]
        return int(np.count_nonzero(self._load[:count])), float(self._now.gap[:count].min(initial=np.inf))


def _places_of(known: Internals, keys: np.ndarray) -> np.ndarray:
    """Places of (anchor, load, slip speed) of pairs in flattened internal variables, or -1, ``(n, 5)``."""
    out = np.full((len(keys), 5), -1)
    _, old, new = np.intersect1d(np.rint(known["pair"]).astype(np.int64), keys, return_indices=True)
    out[new] = memory_places(places(known), old)
    return out


def _parallel_derivative(ends: np.ndarray) -> np.ndarray:
    """Derivative of |u x v|^2 by the ends of two edges [m^3], ``(n, 4, 3)``."""
    u, v = ends[:, 1] - ends[:, 0], ends[:, 3] - ends[:, 2]
    normal = 2.0 * cross(u, v)
    du, dv = cross(v, normal), cross(normal, u)
    return np.stack([-du, du, -dv, dv], axis=1)


class _Closest:
    """Where edges are nearest to each other: arrays that the kernel ``measure`` writes."""

    def __init__(self, capacity: int) -> None:
        self.at, self.direction = np.zeros((capacity, 2)), np.zeros((capacity, 3))
        self.sign, self.fade, self.gap = np.ones(capacity), np.zeros((capacity, 2)), np.zeros(capacity)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """In the order of the kernel's arguments."""
        return self.at, self.direction, self.sign, self.fade, self.gap
