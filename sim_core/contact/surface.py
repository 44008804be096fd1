"""Contact and friction between the samples of one deformable surface and the triangles of another.

A sample p = sum_i w_i x_i is tested against the nearest of its candidate triangles, closest point
c = sum_j b_j y_j. Between faces the gap is the height over the face; over edges and corners it is the
distance, so nothing is felt beyond the border of a sheet by more than the offset:

    g = s n . (p - c) - offset   (closest point inside the face)
    g = s' |p - c| - offset      (on an edge or a corner)

n is the face normal. On a closed surface s = 1. A sheet has two sides and s = +-1 is the side that the
sample came from, remembered for as long as it is near; s' is s times the sign against the averaged
normal, and +1 on free borders. With r = p - c, d = |r| and 1/2 d^2 = min over b of 1/2 |p - sum b y|^2
the derivatives of d follow from the Schur complement of that small problem:

    grad d = r/d . dr,    hess(1/2 d^2) = E_zz - E_zb E_bb^-1 E_bz,
    hess d = (hess(1/2 d^2) - grad d grad d^T) / d

Where triangles meet at a concave crease the smallest distance has a kink on which a sample may come to rest
without any balance of forces. The distances of neighbouring triangles are therefore blended over a width e,
d = min over shares w of sum w_k d_k + e/2 (sum w_k^2 - 1), which is smooth and at most e/2 too small.

Friction acts on the relative motion of the sample and the point of the triangle below it at the start
of the step. Laws: :mod:`sim_core.contact.law`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from sim_core.contact.candidates import Candidates
from sim_core.contact.samples import Samples
from sim_core.contact.surface_kernels import (
    BLEND,
    EXCESS,
    FAR,
    MOST,
    MU,
    OFFSET,
    SLIP_SCALE,
    STIFFNESS,
    WIDTH,
    add_energy,
    add_gradient,
    add_hessian,
    measure,
)
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.kernels import BoundKernel

CREASE_ROUNDING = 0.1
"""Width over which the distances to several triangles are blended, as a share of the pressure's rounding."""


class SurfaceContact:
    """Term for one ordered pair: samples of one surface against the triangles of another.

    ``triangles``: int32 ``(m, 3)``, node indices. ``two_sided``: the triangles are a sheet.
    ``offset``: [m], samples' and sheet's half thickness together. ``reach_m``: how far beyond the
    offset partners are looked for at least, and within which a sample remembers its side of a sheet.
    """

    mirrored = True

    def __init__(
        self,
        name: str,
        samples: Samples,
        triangles: np.ndarray,
        two_sided: bool,
        offset: float,
        reach_m: float,
    ) -> None:
        self.name = name
        self._samples = samples
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self._two_sided = two_sided
        self._reach = reach_m
        self._candidates = Candidates(samples, self._triangles, offset)
        self._border = _free_features(self._triangles, two_sided)
        count = len(samples.areas)
        self._own = np.ascontiguousarray(samples.nodes, dtype=np.int32)
        self._weights = np.ascontiguousarray(samples.weights)
        self._areas = np.ascontiguousarray(samples.areas)
        self._c = np.zeros(7)
        self._c[OFFSET] = offset
        self._limit, self._load = np.zeros(count), np.zeros(count)
        self._anchor, self._force = np.zeros((count, 3)), np.zeros((count, 3))
        self._side = np.ones(count)
        self._now, self._lag = _Closest(count), _Closest(count)
        self._exact = np.zeros(1, dtype=np.int32)

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
        self._buffers = buffers
        self._x = buffers.x
        self._x_start = np.zeros_like(buffers.x)
        self._normals = np.zeros_like(buffers.x)
        second = np.zeros((16, 3, 3))
        slopes = np.zeros((MOST + 2, self._own.shape[1] + 3 * MOST, 3))
        self._seen = np.full_like(buffers.x, np.nan)
        now, lag, table = self._now, self._lag, buffers.pairs
        laws = (
            *(buffers.x, self._x_start, self._own, self._weights, self._triangles, self._areas, self._c),
            *(self._limit, lag.triangles, lag.weights, lag.directions, self._anchor, now.gap),
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
        found = self._candidates
        surface = (
            *(self._own, self._weights, self._triangles, self._border, found.first, found.near),
            *(self._normals, self._side, self._c),
        )
        self._measure = BoundKernel(measure, self._x, *surface, *self._now.arrays())
        self._start = BoundKernel(measure, self._x_start, *surface, *self._lag.arrays())

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._c[STIFFNESS] = parameters["stiffness_pa_per_m"]
        self._c[WIDTH] = parameters["rounding_m"]
        self._c[BLEND] = CREASE_ROUNDING * parameters["rounding_m"]
        self._c[MU] = parameters["friction"]
        self._c[EXCESS] = parameters.get("static_excess", 0.0)
        self._c[SLIP_SCALE] = parameters.get("slip_speed_scale_m_s", 1.0)

    def prepare(self, step: StepContext, motion: float) -> bool:
        """Look for candidates around the start of a step; True when the coupled nodes changed."""
        reach = max(self._reach, motion)
        changed, grown = self._candidates.search(step.x_start, reach, self._reach)
        if grown:
            self._bind_search()
        return changed

    def outran(self) -> bool:
        """True when something may have come into contact that was not looked at."""
        return self._candidates.outran(self._x)

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        self._x_start[:] = step.x_start
        self._anchor[:] = internals["anchor"]
        self._seen[:] = np.nan
        if not self._candidates.any:
            self._limit[:], self._load[:], self._force[:] = 0.0, 0.0, 0.0
            self._now.gap[:] = FAR
            return
        self._normals[:] = 0.0
        corners = step.x_start[self._triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        for k in range(3):
            np.add.at(self._normals, self._triangles[:, k], normal)
        known = internals["side"] if self._two_sided else np.ones(len(self._areas))
        self._side[:] = np.where(known == 0.0, 1.0, known)
        self._start()
        fresh = (known == 0.0) & (self._lag.height < 0.0)
        if fresh.any():
            self._side[fresh] = -1.0
            self._start()
        mu = self._c[MU] * np.ones(len(self._areas))
        if self._c[EXCESS] > 0.0:
            mu *= 1.0 + self._c[EXCESS] * np.exp(-((internals["slip_speed"] / self._c[SLIP_SCALE]) ** 2))
        self._limit[:] = np.where(self._lag.number > 0, mu * internals["load"], 0.0)

    def _look(self) -> bool:
        """Bring the gaps up to date with the positions; False when there is nothing to touch."""
        if not self._candidates.any:
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

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Carry elastic slip, load, slip speed and side; zero where nothing touches or is near."""
        if not self._look():
            return self.initial_internals()
        nodes = self._triangles[self._lag.triangles[:, 0]]
        move = self._x - self._x_start
        relative = self._samples.positions(move) - np.einsum("sk,skj->sj", self._lag.weights[:, :3], move[nodes])
        slip = self._anchor + relative
        normal = self._lag.directions[:, :3]
        slip -= normal * np.einsum("sj,sj->s", slip, normal)[:, None]
        length = np.linalg.norm(slip, axis=1)
        longest = self._limit / (self._c[STIFFNESS] * self._areas)
        beyond = length > longest
        shrink = np.where(beyond, longest / np.where(length > 0.0, length, 1.0), 1.0)
        touching = self._load > 0.0
        return {
            "anchor": np.where(touching[:, None], slip * shrink[:, None], 0.0),
            "load": self._load.copy(),
            "slip_speed": np.where(touching & beyond, (length - longest) / step.dt, 0.0),
            "side": np.where(self._now.gap < self._reach, self._side, 0.0),
        }

    def initial_internals(self) -> Internals:
        count = len(self._areas)
        return {
            "anchor": np.zeros((count, 3)),
            "load": np.zeros(count),
            "slip_speed": np.zeros(count),
            "side": np.zeros(count),
        }

    def sample_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Sample positions [m] and the force on each sample [N] at the last gradient, ``(n, 3)`` each."""
        return self._samples.positions(self._x), self._force.copy()

    def contacts(self) -> tuple[int, float]:
        """Number of loaded samples and smallest gap [m] at the last gradient."""
        return int(np.count_nonzero(self._load)), float(self._now.gap.min(initial=np.inf))


class _Closest:
    """Where samples are nearest to the triangles: arrays that the kernel ``measure`` writes."""

    def __init__(self, count: int) -> None:
        self.number = np.zeros(count, dtype=np.int32)
        self.triangles = np.zeros((count, MOST), dtype=np.int32)
        self.weights, self.directions = np.zeros((count, 3 * MOST)), np.zeros((count, 3 * MOST))
        self.share, self.distance = np.zeros((count, MOST)), np.zeros((count, MOST))
        self.kind = np.zeros((count, MOST), dtype=np.int32)
        self.sign, self.gap, self.height = np.ones(count), np.full(count, FAR), np.zeros(count)

    def arrays(self) -> tuple[np.ndarray, ...]:
        """In the order of the kernel's arguments."""
        shares = (self.number, self.triangles, self.weights, self.directions, self.share, self.kind)
        return *shares, self.distance, self.sign, self.gap, self.height


def _free_features(triangles: np.ndarray, two_sided: bool) -> np.ndarray:
    """For each triangle: corners 0..2 and edges 3..5 (01, 12, 20) on a free border, int32 ``(m, 6)``."""
    border = np.zeros((len(triangles), 6), dtype=np.int32)
    if not two_sided:
        return border
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
    unique, inverse, counts = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    border[:, 3:] = (counts == 1)[inverse.reshape(-1)].reshape(-1, 3)
    border[:, :3] = np.isin(triangles, np.unique(unique[counts == 1]))
    return border
