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

    grad d = r/d . dr,    hess(1/2 d^2) = E_zz - E_zb E_bb^-1 E_bz,    hess d = (hess(1/2 d^2) - grad d grad d^T)/d

Friction acts on the relative motion of the sample and the point of the triangle below it at the start
of the step. Laws: :mod:`sim_core.contact.law`.
"""

from collections.abc import Mapping

import numpy as np
import taichi as ti
from scipy.spatial import cKDTree

from sim_core.contact.closest import closest_point, distance_second_derivative
from sim_core.contact.law import (
    friction_force,
    friction_potential,
    friction_stiffness,
    potential,
    pressure,
    slope,
    tangent_projector,
)
from sim_core.contact.samples import Samples
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.kernels import F1, F2, F3, I1, I2, BoundKernel, vec3

STIFFNESS, WIDTH, MU, EXCESS, SLIP_SCALE, OFFSET = range(6)


@ti.func
def _corner(x: ti.template(), i: ti.i32):
    return vec3(x[i, 0], x[i, 1], x[i, 2])


@ti.func
def _sample(x: ti.template(), local: ti.template(), weights: ti.template(), s: ti.i32):
    p = vec3(0.0, 0.0, 0.0)
    for a in range(weights.shape[1]):
        p += weights[s, a] * _corner(x, local[s, a])
    return p


@ti.func
def _gap(
    x: ti.template(), local: ti.template(), weights: ti.template(), candidates: ti.template(),
    free_edge: ti.template(), normals: ti.template(), side: ti.template(), offset: ti.f64, s: ti.i32
):
    """Gap [m], its gradient in p, barycentric weights, chosen candidate, sign, feature (3: face)."""
    p = _sample(x, local, weights, s)
    best = 1e30
    gap = 1e30
    direction = vec3(0.0, 0.0, 0.0)
    barycentric = vec3(0.0, 0.0, 0.0)
    chosen = -1
    sign = 1.0
    kind = 3
    for k in range(candidates.shape[1]):
        if candidates[s, k, 0] >= 0:
            y0 = _corner(x, local[s, candidates[s, k, 0]])
            y1 = _corner(x, local[s, candidates[s, k, 1]])
            y2 = _corner(x, local[s, candidates[s, k, 2]])
            b, feature = closest_point(p, y0, y1, y2)
            r = p - (b[0] * y0 + b[1] * y1 + b[2] * y2)
            d = r.norm()
            if d < best - 1e-15:
                best = d
                chosen = k
                barycentric = b
                face = (y1 - y0).cross(y2 - y0).normalized()
                if feature == 6:
                    sign = side[s]
                    kind = 3
                    direction = sign * face
                    gap = sign * face.dot(r) - offset
                else:
                    kind = 2
                    if feature < 3:
                        kind = 1
                    sign = 1.0
                    if free_edge[s, k, feature] == 0:
                        m = vec3(0.0, 0.0, 0.0)
                        for j in ti.static(range(3)):
                            i = local[s, candidates[s, k, j]]
                            m += b[j] * _corner(normals, i)
                        if side[s] * m.dot(r) < 0.0:
                            sign = -1.0
                    direction = sign * face * side[s]
                    if d > 1e-12:
                        direction = sign * r / d
                    gap = sign * d - offset
    return gap, direction, barycentric, chosen, sign, kind


@ti.func
def _elastic_slip(
    x: ti.template(), x_start: ti.template(), local: ti.template(), weights: ti.template(),
    candidates: ti.template(), lag: ti.template(), lag_b: ti.template(), lag_n: ti.template(),
    anchor: ti.template(), s: ti.i32
):
    """Elastic slip [m] and projector, against the triangle under the sample at the start."""
    move = _sample(x, local, weights, s) - _sample(x_start, local, weights, s)
    for j in ti.static(range(3)):
        i = local[s, candidates[s, lag[s], j]]
        move -= lag_b[s, j] * (_corner(x, i) - _corner(x_start, i))
    n = vec3(lag_n[s, 0], lag_n[s, 1], lag_n[s, 2])
    t = tangent_projector(n)
    return t @ (vec3(anchor[s, 0], anchor[s, 1], anchor[s, 2]) + move), t


@ti.kernel
def _start(
    x: F2, local: I2, weights: F2, candidates: ti.types.ndarray(dtype=ti.i32, ndim=3),
    free_edge: ti.types.ndarray(dtype=ti.i32, ndim=3), normals: F2, side: F1, c: F1,
    lag: I1, lag_b: F2, lag_n: F2
):
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        gap, direction, b, chosen, sign, kind = _gap(
            x, local, weights, candidates, free_edge, normals, side, c[OFFSET], s
        )
        lag[s] = ti.max(chosen, 0)
        for j in ti.static(range(3)):
            lag_b[s, j] = b[j]
            lag_n[s, j] = direction[j]


@ti.kernel
def _energy(
    x: F2, x_start: F2, local: I2, weights: F2, candidates: ti.types.ndarray(dtype=ti.i32, ndim=3),
    free_edge: ti.types.ndarray(dtype=ti.i32, ndim=3), normals: F2, side: F1, areas: F1, c: F1,
    limit: F1, lag: I1, lag_b: F2, lag_n: F2, anchor: F2, out: F1
):
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        if candidates[s, 0, 0] >= 0:
            gap, direction, b, chosen, sign, kind = _gap(
                x, local, weights, candidates, free_edge, normals, side, c[OFFSET], s
            )
            e = areas[s] * potential(gap, c[STIFFNESS], c[WIDTH])
            if limit[s] > 0.0:
                u, t = _elastic_slip(x, x_start, local, weights, candidates, lag, lag_b, lag_n, anchor, s)
                e += friction_potential(u, limit[s], c[STIFFNESS] * areas[s])
            out[0] = out[0] + e


@ti.kernel
def _gradient(
    x: F2, x_start: F2, local: I2, weights: F2, candidates: ti.types.ndarray(dtype=ti.i32, ndim=3),
    free_edge: ti.types.ndarray(dtype=ti.i32, ndim=3), normals: F2, side: F1, areas: F1, c: F1,
    limit: F1, lag: I1, lag_b: F2, lag_n: F2, anchor: F2, force: F2, load: F1, gaps: F1, out: F2
):
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        load[s] = 0.0
        gaps[s] = 1e30
        for j in ti.static(range(3)):
            force[s, j] = 0.0
        if candidates[s, 0, 0] >= 0:
            gap, direction, b, chosen, sign, kind = _gap(
                x, local, weights, candidates, free_edge, normals, side, c[OFFSET], s
            )
            gaps[s] = gap
            load[s] = areas[s] * pressure(gap, c[STIFFNESS], c[WIDTH])
            normal = load[s] * direction
            rub = vec3(0.0, 0.0, 0.0)
            if limit[s] > 0.0:
                u, t = _elastic_slip(x, x_start, local, weights, candidates, lag, lag_b, lag_n, anchor, s)
                rub = -friction_force(u, limit[s], c[STIFFNESS] * areas[s])
            for j in ti.static(range(3)):
                force[s, j] = normal[j] + rub[j]
            for a in range(weights.shape[1]):
                i = local[s, a]
                for j in ti.static(range(3)):
                    out[i, j] = out[i, j] - weights[s, a] * force[s, j]
            for k in ti.static(range(3)):
                i = local[s, candidates[s, chosen, k]]
                m = local[s, candidates[s, lag[s], k]]
                for j in ti.static(range(3)):
                    out[i, j] = out[i, j] + b[k] * normal[j]
                    out[m, j] = out[m, j] + lag_b[s, k] * rub[j]


@ti.func
def _add(slots: ti.template(), out: ti.template(), block: ti.i32, same: ti.i32, m):
    for i in ti.static(range(3)):
        for j in ti.static(range(3)):
            if same == 0 or i <= j:
                at = slots[block, 3 * i + j]
                out[at] = out[at] + m[i, j]


@ti.func
def _upper(a: ti.i32, b: ti.i32, count: ti.i32):
    """Place of pair (a, b), a <= b, in the row-wise upper triangle of ``count``."""
    return a * count - a * (a - 1) // 2 + b - a


@ti.kernel
def _hessian(
    x: F2, x_start: F2, local: I2, weights: F2, candidates: ti.types.ndarray(dtype=ti.i32, ndim=3),
    free_edge: ti.types.ndarray(dtype=ti.i32, ndim=3), normals: F2, side: F1, areas: F1, c: F1,
    limit: F1, lag: I1, lag_b: F2, lag_n: F2, anchor: F2, exact: I1, slots: I2, second: F3, out: F1
):
    """``second``: scratch, (4, 4) blocks of the second derivative of the gap in (p, y0, y1, y2)."""
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        if candidates[s, 0, 0] >= 0:
            gap, direction, b, chosen, sign, kind = _gap(
                x, local, weights, candidates, free_edge, normals, side, c[OFFSET], s
            )
            own = weights.shape[1]
            count = local.shape[1]
            base = s * (count * (count + 1) // 2)
            if gap < c[WIDTH]:
                k = areas[s] * slope(gap, c[STIFFNESS], c[WIDTH])
                bend = 0.0
                if exact[0] == 1:
                    bend = -areas[s] * pressure(gap, c[STIFFNESS], c[WIDTH])
                    p = _sample(x, local, weights, s)
                    y0 = _corner(x, local[s, candidates[s, chosen, 0]])
                    y1 = _corner(x, local[s, candidates[s, chosen, 1]])
                    y2 = _corner(x, local[s, candidates[s, chosen, 2]])
                    distance_second_derivative(p, y0, y1, y2, b, kind, sign, second)
                nn = direction.outer_product(direction)
                for a in range(own + 3):
                    la = a
                    qa = 0
                    wa = 1.0
                    if a < own:
                        wa = weights[s, a]
                    else:
                        la = candidates[s, chosen, a - own]
                        qa = a - own + 1
                    ca = wa
                    if a >= own:
                        ca = -b[a - own]
                    for d in range(own + 3):
                        ld = d
                        qd = 0
                        wd = 1.0
                        if d < own:
                            wd = weights[s, d]
                        else:
                            ld = candidates[s, chosen, d - own]
                            qd = d - own + 1
                        cd = wd
                        if d >= own:
                            cd = -b[d - own]
                        if la <= ld:
                            m = (k * ca * cd) * nn
                            if exact[0] == 1:
                                for i in ti.static(range(3)):
                                    for j in ti.static(range(3)):
                                        m[i, j] += bend * wa * wd * second[4 * qa + qd, i, j]
                            _add(slots, out, base + _upper(la, ld, count), la == ld, m)
            if limit[s] > 0.0:
                u, t = _elastic_slip(x, x_start, local, weights, candidates, lag, lag_b, lag_n, anchor, s)
                stiff = t @ friction_stiffness(u, limit[s], c[STIFFNESS] * areas[s], t) @ t
                for a in range(own + 3):
                    la = a
                    ca = 0.0
                    if a < own:
                        ca = weights[s, a]
                    else:
                        la = candidates[s, lag[s], a - own]
                        ca = -lag_b[s, a - own]
                    for d in range(own + 3):
                        ld = d
                        cd = 0.0
                        if d < own:
                            cd = weights[s, d]
                        else:
                            ld = candidates[s, lag[s], d - own]
                            cd = -lag_b[s, d - own]
                        if la <= ld:
                            _add(slots, out, base + _upper(la, ld, count), la == ld, (ca * cd) * stiff)


class SurfaceContact:
    """Term for one ordered pair: samples of one surface against the triangles of another.

    ``triangles``: int32 ``(m, 3)``, node indices. ``two_sided``: the triangles are a sheet.
    ``offset``: [m], samples' and sheet's half thickness together. ``reach_m``: how far beyond the
    offset candidates are looked for; they are looked for again when anything has moved by a third of it.
    """

    mirrored = True

    def __init__(
        self, name: str, samples: Samples, triangles: np.ndarray, two_sided: bool, offset: float, reach_m: float
    ) -> None:
        self.name = name
        self._samples = samples
        self._triangles = np.asarray(triangles, dtype=np.int32)
        self._two_sided = two_sided
        self._reach = reach_m
        count = len(samples.areas)
        self._areas = np.ascontiguousarray(samples.areas)
        self._c = np.zeros(6)
        self._c[OFFSET] = offset
        self._limit, self._load, self._gaps = np.zeros(count), np.zeros(count), np.full(count, 1e30)
        self._side = np.ones(count)
        self._anchor, self._force = np.zeros((count, 3)), np.zeros((count, 3))
        self._lag_b, self._lag_n = np.zeros((count, 3)), np.zeros((count, 3))
        self._lag = np.zeros(count, dtype=np.int32)
        self._exact = np.zeros(1, dtype=np.int32)
        self._second = np.zeros((16, 3, 3))
        self._weights = np.ascontiguousarray(samples.weights)
        self._border = self._free_features()
        self._searched_at: np.ndarray | None = None
        self._set_candidates([np.empty(0, dtype=int)] * count)

    def _free_features(self) -> np.ndarray:
        """For each triangle: corners 0..2 and edges 3..5 (01, 12, 20) on a free border, int32 ``(m, 6)``."""
        border = np.zeros((len(self._triangles), 6), dtype=np.int32)
        if not self._two_sided:
            return border
        edges = np.sort(self._triangles[:, [[0, 1], [1, 2], [2, 0]]], axis=-1)
        unique, inverse, counts = np.unique(
            edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True
        )
        lonely = (counts == 1)[inverse.reshape(-1)].reshape(-1, 3)
        border[:, 3:] = lonely
        on_border = np.unique(unique[counts == 1])
        border[:, :3] = np.isin(self._triangles, on_border)
        return border

    def _set_candidates(self, found: list[np.ndarray]) -> None:
        """Lay out, for every sample, its own nodes, then the distinct nodes of its candidates."""
        count, own = self._samples.nodes.shape
        most = max((len(f) for f in found), default=0) or 1
        candidates = np.full((count, most, 3), -1, dtype=np.int32)
        free_edge = np.zeros((count, most, 6), dtype=np.int32)
        nodes = [np.unique(self._triangles[f]) if len(f) else np.empty(0, dtype=np.int32) for f in found]
        width = own + max((len(n) for n in nodes), default=0)
        local = np.zeros((count, width), dtype=np.int32)
        local[:, :own] = self._samples.nodes
        for s, (near, other) in enumerate(zip(found, nodes, strict=True)):
            if len(near):
                local[s, own : own + len(other)] = other
                local[s, own + len(other) :] = other[-1]
                candidates[s, : len(near)] = own + np.searchsorted(other, self._triangles[near])
                free_edge[s, : len(near)] = self._border[near]
        self._local, self._candidates, self._free_edge = local, candidates, free_edge
        self._near = np.array([len(f) > 0 for f in found])

    def _search(self, x: np.ndarray) -> bool:
        """Renew the candidates when something has moved too far; True when they were renewed."""
        if self._searched_at is not None:
            moved = x - self._searched_at
            if max(self._span(moved, self._samples.nodes), self._span(moved, self._triangles)) < self._reach / 3:
                return False
        self._searched_at = x.copy()
        corners = x[self._triangles]
        centres = corners.mean(axis=1)
        radius = float(np.linalg.norm(corners - centres[:, None], axis=2).max())
        points = self._samples.positions(x)
        near = cKDTree(centres).query_ball_point(points, radius + self._c[OFFSET] + self._reach)
        found = [np.sort(np.asarray(n, dtype=int)) for n in near]
        self._set_candidates(found)
        return True

    @staticmethod
    def _span(moved: np.ndarray, nodes: np.ndarray) -> float:
        return float(np.abs(moved[np.unique(nodes)]).max(initial=0.0))

    def blocks(self) -> np.ndarray:
        a, b = np.triu_indices(self._local.shape[1])
        blocks = np.stack([self._local[:, a], self._local[:, b]], axis=-1)
        blocks[~self._near] = self._local[~self._near][:, :1, None]
        return blocks.reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._x = buffers.x
        self._x_start = np.zeros_like(buffers.x)
        self._normals = np.zeros_like(buffers.x)
        places = (self._local, self._weights, self._candidates, self._free_edge, self._normals, self._side)
        friction = (self._limit, self._lag, self._lag_b, self._lag_n, self._anchor)
        laws = (buffers.x, self._x_start, *places, self._areas, self._c, *friction)
        self._start = BoundKernel(
            _start, self._x_start, *places, self._c, self._lag, self._lag_b, self._lag_n
        )
        self.add_energy = BoundKernel(_energy, *laws, buffers.energy)
        self.add_gradient = BoundKernel(
            _gradient, *laws, self._force, self._load, self._gaps, buffers.gradient
        )
        self._hessian = BoundKernel(_hessian, *laws, self._exact, slots, self._second, buffers.hessian)

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._c[STIFFNESS] = parameters["stiffness_pa_per_m"]
        self._c[WIDTH] = parameters["rounding_m"]
        self._c[MU] = parameters["friction"]
        self._c[EXCESS] = parameters.get("static_excess", 0.0)
        self._c[SLIP_SCALE] = parameters.get("slip_speed_scale_m_s", 1.0)

    def prepare(self, x: np.ndarray) -> bool:
        """Look for candidates around positions ``x``; True when the coupled nodes changed."""
        return self._search(x)

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        self._x_start[:] = step.x_start
        self._normals[:] = 0.0
        corners = step.x_start[self._triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        for k in range(3):
            np.add.at(self._normals, self._triangles[:, k], normal)
        self._side[:] = internals["side"] if self._two_sided else 1.0
        fresh = self._near & (self._side == 0.0)
        self._side[self._side == 0.0] = 1.0
        self._start()
        if fresh.any():
            below = fresh & (self._height() < 0.0)
            self._side[below] = -1.0
            self._start()
        self._anchor[:] = internals["anchor"]
        mu = self._c[MU] * np.ones(len(self._areas))
        if self._c[EXCESS] > 0.0:
            mu *= 1.0 + self._c[EXCESS] * np.exp(-((internals["slip_speed"] / self._c[SLIP_SCALE]) ** 2))
        self._limit[:] = np.where(self._near, mu * internals["load"], 0.0)

    def _height(self) -> np.ndarray:
        """Signed height over the nearest face at the start of the step [m], ``(n,)``."""
        lag = self._candidates[np.arange(len(self._lag)), self._lag]
        nodes = np.take_along_axis(self._local, np.maximum(lag, 0), axis=1)
        foot = np.einsum("sk,skj->sj", self._lag_b, self._x_start[nodes])
        corners = self._x_start[nodes]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return np.asarray(np.einsum("sj,sj->s", self._samples.positions(self._x_start) - foot, normal))

    def add_hessian(self, exact: bool) -> None:
        self._exact[0] = exact
        self._hessian()

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Carry elastic slip, load, slip speed and side; zero where nothing touches or is near."""
        nodes = np.take_along_axis(
            self._local, np.maximum(self._candidates[np.arange(len(self._lag)), self._lag], 0), axis=1
        )
        move = self._x - self._x_start
        relative = self._samples.positions(move) - np.einsum("sk,skj->sj", self._lag_b, move[nodes])
        slip = self._anchor + relative
        slip -= self._lag_n * np.einsum("sj,sj->s", slip, self._lag_n)[:, None]
        length = np.linalg.norm(slip, axis=1)
        longest = self._limit / (self._c[STIFFNESS] * self._areas)
        beyond = length > longest
        shrink = np.where(beyond, longest / np.where(length > 0.0, length, 1.0), 1.0)
        touching = self._load > 0.0
        return {
            "anchor": np.where(touching[:, None], slip * shrink[:, None], 0.0),
            "load": self._load.copy(),
            "slip_speed": np.where(touching & beyond, (length - longest) / step.dt, 0.0),
            "side": np.where(self._near, self._side, 0.0),
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
        """Where the samples are [m] and the force on each of them [N], both ``(n, 3)``, at the last gradient."""
        return self._samples.positions(self._x), self._force.copy()

    def contacts(self) -> tuple[int, float]:
        """Number of loaded samples and smallest gap [m] at the last gradient."""
        return int(np.count_nonzero(self._load)), float(self._gaps.min(initial=np.inf))
