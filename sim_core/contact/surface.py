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
import scipy.sparse as sp

from sim_core.contact.added_laws import AddedLaws, Bound
from sim_core.contact.broad_phase import Candidates
from sim_core.contact.local_frame_derivatives import AtRest, Loads, Pairs, exerted, framed_derivatives, memory_places
from sim_core.contact.local_frame_kernels import Frames
from sim_core.contact.measures import Measures
from sim_core.contact.pair_distance import PairDistance
from sim_core.contact.pressure_and_friction import (
    BLEND,
    LAW_OF,
    OFFSET,
    RANGE,
    REACH,
    STIFFNESS,
    by_range,
    coefficients,
    normal_law,
    set_guard,
    set_law,
    slide,
)
from sim_core.contact.primitives import Primitives
from sim_core.contact.samples import Samples
from sim_core.contact.surface_geometry import distances, frames, free_way, sides
from sim_core.contact.surface_kernels import FAR, MOST, add_energy, add_gradient, add_hessian, measure
from sim_core.energies.linearised import Linearised, places
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.kernels import BoundKernel

CREASE_ROUNDING = 0.05
"""Width over which the distances to several triangles are blended, as a share of the pressure's range."""

SPARE = 16
"""Places for candidates a sample at the start; doubled whenever they do not suffice."""


class SurfaceContact:
    """Term for one ordered pair: samples of one surface against the triangles of another (or of the same).

    ``triangles``: int32 ``(m, 3)``, node indices. ``offset``: [m], half thicknesses of both surfaces
    together. ``margin_m``: how much wider than a step needs partners are looked for. ``bearing``: share of the
    law's range, less than one for samples that are to bear only where others fail. ``stops``: whether it keeps a
    surface out of a rigid shape where no point of the surface would, and so stands at its place whatever bears.
    """

    mirrored = True
    measured_at_rest = True

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
        self.samples = samples
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self.margin_m = margin_m
        self._own = np.ascontiguousarray(samples.nodes, dtype=np.int32)
        self._weights = np.ascontiguousarray(samples.weights)
        self._used = np.count_nonzero(self._weights, axis=1).astype(np.int32)
        self._candidates = Candidates(
            Primitives(self._own, self._weights),
            Primitives(self._triangles),
            offset,
            PairDistance(distances, self._own, self._used, self._weights, self._triangles),
        )
        self._border = _free_features(self._triangles)
        count = len(samples.areas)
        self._areas = np.ascontiguousarray(samples.areas)
        self._c = coefficients(offset)
        self.laws = AddedLaws(bears=bearing == 1.0)
        self._added = np.zeros((count, 3))
        self._limit, self._load = np.zeros(count), np.zeros(count)
        self._anchor, self._force = np.zeros((count, 3)), np.zeros((count, 3))
        self._frame = np.zeros((count, 27))
        self._first = np.zeros(count + 1, dtype=np.int32)
        self._near, self._side = np.zeros(SPARE * count, dtype=np.int32), np.ones(SPARE * count)
        self._now, self._lag = _Closest(count), _Closest(count)
        self._exact = np.zeros(1, dtype=np.int32)
        self._keep, self._way = np.zeros(1), np.ones(1)
        self._frames_by = Frames()

    def blocks(self) -> np.ndarray:
        """Pairs of the samples' nodes and of the corners of all triangles in the wider search, and of the
        corners of triangles around one node, which may share in a gap."""
        sample, triangle = self._candidates.coupled
        if not len(sample):
            return np.empty((0, 2), dtype=np.int32)
        own, corner = self._own[sample], self._triangles[triangle]
        mixed = np.stack([np.repeat(own, 3, axis=1), np.tile(corner, (1, own.shape[1]))], axis=-1)
        members = self._own[np.unique(sample)]
        i, j = np.triu_indices(own.shape[1])
        inner = np.stack([members[:, i], members[:, j]], axis=-1)
        near = self._triangles[np.unique(triangle)]
        incidence = sp.csr_matrix(
            (np.ones(near.size), (near.ravel(), np.repeat(np.arange(len(near)), 3))),
            shape=(int(near.max()) + 1, len(near)),
        )
        # Nodes of triangles that share a node: two steps over triangles.
        around = sp.triu((incidence @ incidence.T) @ (incidence @ incidence.T)).tocoo()
        star = np.column_stack([around.row, around.col])
        return np.concatenate([mixed.reshape(-1, 2), inner.reshape(-1, 2), star])

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        del slots
        assert buffers.pairs is not None
        self._buffers, self._x = buffers, buffers.x
        self._x_start, self._move = np.zeros_like(buffers.x), np.zeros_like(buffers.x)
        self._normals = np.zeros_like(buffers.x)
        second = np.zeros((16, 3, 3))
        slopes = np.zeros((MOST + 2, self._own.shape[1] + 3 * MOST, 3))
        self._seen = np.full_like(buffers.x, np.nan)
        now, lag, table = self._now, self._lag, buffers.pairs
        laws = (
            *(buffers.x, self._x_start, self._own, self._used, self._weights, self._triangles, self._areas, self._c),
            *(self._limit, lag.triangles, self._frame, lag.directions, self._anchor, now.gap, self._added),
        )
        here = (now.number, now.triangles, now.weights, now.directions, now.share)
        self._energy = BoundKernel(add_energy, *laws, buffers.energy)
        self._gradient = BoundKernel(add_gradient, *laws, *here, self._force, self._load, buffers.gradient)
        self._hessian = BoundKernel(
            add_hessian,
            *(*laws, *here, now.kind, now.sign, self._exact),
            *(table.start, table.column, table.place, slopes, second, buffers.hessian),
        )
        self._bind_search()

    def _bind_search(self) -> None:
        points = (self._own, self._used, self._weights, self._triangles)
        found = (self._first, self._near)
        surface = (*points, self._border, *found, self._normals, self._side, self._c)
        self._measure = BoundKernel(measure, self._x, *surface, *self._now.arrays())
        self._start = BoundKernel(measure, self._x_start, *surface, *self._lag.arrays())
        self._frames = BoundKernel(frames, self._x_start, *points, self._lag.number, self._lag.triangles, self._frame)
        self._sides = BoundKernel(sides, self._x_start, *points, *found, self._normals, self._side)
        self._from = np.zeros_like(self._x)
        self._free = BoundKernel(
            free_way, self._from, self._move, *points, *found, self._c, self._keep, self._way
        )  # fmt: skip

    @property
    def measures(self) -> list[Measures]:
        """What is measured at rest: areas of the samples."""
        return [] if self.samples.shared is None else [self.samples.shared]

    @property
    def law(self) -> np.ndarray:
        """Numbers of the law, as :mod:`sim_core.contact.pressure_and_friction` lays them out ``(8,)``."""
        return self._c

    def law_by(self, quantity: str) -> dict[int, float]:
        """Derivatives of the numbers of :attr:`law` by one that it is given by name, by their places."""
        if quantity != "range_m":
            return {LAW_OF[quantity]: 1.0}
        return {RANGE: self.bearing, BLEND: CREASE_ROUNDING * self.bearing}

    @property
    def triangles(self) -> np.ndarray:
        """Nodes of the triangles, int32 ``(m, 3)``."""
        return self._triangles

    @property
    def border(self) -> np.ndarray:
        """Which corners 0..2 and edges 01, 12, 20 of the triangles are on a free border, int32 ``(m, 6)``."""
        return self._border

    @property
    def areas(self) -> np.ndarray:
        """Areas of the samples [m^2] ``(n,)``."""
        return self._areas

    @property
    def offset(self) -> float:
        """Distance [m] at which there is no gap."""
        return float(self._c[OFFSET])

    def configure(self, parameters: Mapping[str, float]) -> None:
        set_law(self._c, parameters)
        self._c[RANGE] *= self.bearing
        self._c[BLEND] = CREASE_ROUNDING * self._c[RANGE]
        self.laws.configure(parameters)
        self._c[REACH] = max(self._c[RANGE], self.laws.reach())
        self._seen_nothing()

    def guard(self, on: bool) -> None:
        """Distances without sign and the law itself, or with sign and a law that bears overlap."""
        set_guard(self._c, on)
        self._seen_nothing()

    def _seen_nothing(self) -> None:
        if hasattr(self, "_seen"):
            self._seen[:] = np.nan

    def prepare(self, step: StepContext, towards: np.ndarray, more: bool = False) -> bool:
        """Look for candidates from the start of a step on; True when the coupled nodes changed."""
        inner, outer = self._candidates.search(step.x_start, towards, self._c[REACH], self.margin_m, more)
        if inner:
            sample, triangle = self._candidates.pairs
            if len(triangle) > len(self._near):
                self._near, self._side = np.zeros(2 * len(triangle), dtype=np.int32), np.ones(2 * len(triangle))
                self._bind_search()
            self._near[: len(triangle)] = triangle
            self._first[:] = np.searchsorted(sample, np.arange(len(self._first)))
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
        self._anchor[:] = internals["anchor"]
        self._seen_nothing()
        if not self._candidates.any:
            self._limit[:], self._load[:], self._force[:] = 0.0, 0.0, 0.0
            self._now.gap[:] = FAR
            return
        self._sides()
        self._start()
        self._frames()
        bound = self._bound(internals["load"], internals["slip_speed"])
        self._limit[:] = np.where(self._lag.number > 0, bound.value, 0.0)

    def _bound(self, load: np.ndarray, speed: np.ndarray, some: np.ndarray | None = None) -> Bound:
        """Friction bounds of all samples or of ``some``."""
        return self.laws.bound(self._c, load, self._areas if some is None else self._areas[some], speed)

    def _look(self) -> bool:
        """Bring the gaps up to date with the positions; False when there is nothing to touch."""
        if not self._candidates.any:
            return False
        if not np.array_equal(self._seen, self._x):
            self._measure()
            self._seen[:] = self._x
            if self.laws.presses:
                self.laws.write_normal(self._now.gap, self._added)
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
        if not self._candidates.any:
            return 1.0
        self._from[:], self._move[:], self._keep[0], self._way[0] = start, move, keep, 1.0
        self._free()
        return float(self._way[0])

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Carry elastic slip, load and slip speed; zero where nothing touches."""
        if not self._look():
            return self.initial_internals()
        stiffness = self._c[STIFFNESS] * self._areas
        normal = self._lag.directions[:, :3]
        slip = self._anchor + self._past(self._x - self._x_start)
        anchor, speed = slide(slip, normal, self._limit, stiffness, step.dt)
        touching = self._load > 0.0
        return {
            "anchor": np.where(touching[:, None], anchor, 0.0),
            "load": self._load.copy(),
            "slip_speed": np.where(touching, speed, 0.0),
        }

    def _past(self, move: np.ndarray) -> np.ndarray:
        """How far samples go past the triangles that they are over, for a move of all nodes [m] ``(n, 3)``."""
        nodes = self._triangles[self._lag.triangles[:, 0]]
        below = np.einsum("skij,skj->si", self._frame.reshape(-1, 3, 3, 3), move[nodes])
        return np.asarray(self.samples.positions(move) - below)

    def carried(self, internals: Internals, move: np.ndarray) -> Internals:
        """Internal variables with the springs of friction stretched by a move of the start."""
        touching = internals["load"] > 0.0
        return {**internals, "anchor": internals["anchor"] + np.where(touching[:, None], self._past(move), 0.0)}

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised:
        """Derivatives by the start of the step and the memory."""
        if not self._look():
            return Linearised()
        now, lag = self._now, self._lag
        some = np.flatnonzero((self._limit > 0.0) | (now.gap < self._c[REACH]))
        if not len(some):
            return Linearised()
        count, own = len(some), self._own.shape[1]
        nodes = np.hstack([self._own[some], self._triangles[lag.triangles[some, 0]]])
        point, weights = np.repeat([0, 1, 2, 3], [own, 1, 1, 1]), np.ones((count, own + 3))
        weights[:, :own] = self._weights[some]
        start, now_at = (self._points(some, nodes, x) for x in (step.x_start, self._x))
        old, new = places(internals), places(after)
        _, push, steep = normal_law(self._c, now.gap[some])
        bound = self._bound(internals["load"][some], internals["slip_speed"][some], some)
        pairs = Pairs(
            nodes, point, weights, now_at - start, self._limit[some], self._c[STIFFNESS] * self._areas[some],
            memory_places(old, some), memory_places(new, some), internals["anchor"][some], bound,
            self._areas[some] * push,
        )  # fmt: skip
        self._frames_by.of_triangles(start, lag.kind[some, 0], lag.weights[some, :3], lag.directions[some, :3])
        sizes = (len(self._x), sum(a.size for a in internals.values()), sum(a.size for a in after.values()))
        loads, opening = self._load_derivatives(some, steep)
        whole = push + self._added[some, 1]
        at_rest = AtRest(
            self._c[STIFFNESS] * np.ones((count, 1)), bound.by_area[:, None], push[:, None],
            -whole[:, None, None, None] * opening[..., None], some[:, None], len(self._areas),
        )  # fmt: skip
        total = exerted(self.add_gradient, self._buffers)
        return framed_derivatives(pairs, self._frames_by, loads, at_rest, total, self._c, step.dt, sizes)

    def _points(self, some: np.ndarray, nodes: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Some samples and the corners of the triangles that they are over [m], ``(n, 4, 3)``."""
        own = self._own.shape[1]
        sample = np.einsum("nk,nkj->nj", self._weights[some], x[nodes[:, :own]])
        return np.concatenate([sample[:, None], x[nodes[:, own:]]], axis=1)

    def _load_derivatives(self, some: np.ndarray, steep: np.ndarray) -> tuple[Loads, np.ndarray]:
        """Derivatives of the loads of some samples, and of their gaps by the same nodes."""
        now = self._now
        most = max(int(now.number[some].max()), 1)
        share = np.where(np.arange(most) < now.number[some, None], now.share[some, :most], 0.0)
        towards = share[..., None] * now.directions[some, : 3 * most].reshape(-1, most, 3)
        own = self._weights[some][..., None] * towards.sum(axis=1)[:, None]
        at = now.weights[some, : 3 * most].reshape(-1, most, 3)
        corners = -(at[..., None] * towards[:, :, None]).reshape(len(some), 3 * most, 3)
        nodes = np.hstack([self._own[some], self._triangles[now.triangles[some, :most]].reshape(len(some), -1)])
        opening = np.hstack([own, corners])

        def closing(per_area: np.ndarray) -> np.ndarray:
            """Forces dE/dx of the nodes for pressures or slopes of the samples."""
            return np.asarray(-(self._areas[some] * per_area)[:, None, None] * opening)

        added = self._added[some]
        by = {name: closing(change) for name, change in self.laws.normal_by(now.gap[some]).items()}
        wider = self.bearing * by_range(self._c, now.gap[some])[1]
        areas = self._areas[some]
        by_law = (areas * steep, closing(steep + added[:, 2]), areas * wider, closing(wider))
        loads = Loads(closing(steep), nodes, *by_law, closing(added[:, 1]), by)
        return loads, opening

    def initial_internals(self) -> Internals:
        count = len(self._areas)
        return {"anchor": np.zeros((count, 3)), "load": np.zeros(count), "slip_speed": np.zeros(count)}

    def sample_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Sample positions [m] and the force on each sample [N] at the last gradient, ``(n, 3)`` each."""
        return self.samples.positions(self._x), self._force.copy()

    def contacts(self) -> tuple[int, float]:
        """Number of loaded samples and smallest gap [m] at the last gradient."""
        smallest = float(self._now.gap.min(initial=np.inf))
        return int(np.count_nonzero(self._load)), smallest if smallest < FAR else np.inf


class _Closest:
    """Where samples are nearest to the triangles: arrays that the kernel ``measure`` writes."""

    def __init__(self, count: int) -> None:
        self.number = np.zeros(count, dtype=np.int32)
        self.triangles = np.zeros((count, MOST), dtype=np.int32)
        self.weights, self.directions = np.zeros((count, 3 * MOST)), np.zeros((count, 3 * MOST))
        self.share, self.distance = np.zeros((count, MOST)), np.zeros((count, MOST))
        self.kind = np.zeros((count, MOST), dtype=np.int32)
        self.sign, self.gap = np.ones(count), np.full(count, FAR)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """In the order of the kernel's arguments."""
        shares = (self.number, self.triangles, self.weights, self.directions, self.share, self.kind)
        return *shares, self.distance, self.sign, self.gap


def _free_features(triangles: np.ndarray) -> np.ndarray:
    """For each triangle: corners 0..2 and edges 3..5 (01, 12, 20) on a free border, int32 ``(m, 6)``."""
    border = np.zeros((len(triangles), 6), dtype=np.int32)
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
    unique, inverse, counts = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    border[:, 3:] = (counts == 1)[inverse.reshape(-1)].reshape(-1, 3)
    border[:, :3] = np.isin(triangles, np.unique(unique[counts == 1]))
    return border
