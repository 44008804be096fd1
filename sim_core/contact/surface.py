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

Friction acts on the relative motion of the sample and the point of the triangle below it at the start
of the step. Laws: :mod:`sim_core.contact.law`.
"""

from collections.abc import Mapping

import numpy as np
import taichi as ti

from sim_core.contact.candidates import Candidates
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
from sim_core.kernels import F1, F2, F3, I1, I2, BoundKernel, add_block, vec3

STIFFNESS, WIDTH, MU, EXCESS, SLIP_SCALE, OFFSET = range(6)
FAR = 1e30
"""Gap [m] of a sample without candidates."""


@ti.func
def _corner(x: ti.template(), i: ti.i32):
    return vec3(x[i, 0], x[i, 1], x[i, 2])


@ti.func
def _sample(x: ti.template(), own: ti.template(), weights: ti.template(), s: ti.i32):
    p = vec3(0.0, 0.0, 0.0)
    for a in range(weights.shape[1]):
        p += weights[s, a] * _corner(x, own[s, a])
    return p


@ti.func
def _nearest(x: ti.template(), p, triangles: ti.template(), first: ti.template(), near: ti.template(), s: ti.i32):
    """Nearest candidate of sample ``s`` at ``p`` (-1: none), barycentric weights, feature."""
    best = FAR
    barycentric = vec3(0.0, 0.0, 0.0)
    chosen = -1
    on = 6
    for k in range(first[s], first[s + 1]):
        t = near[k]
        y0 = _corner(x, triangles[t, 0])
        y1 = _corner(x, triangles[t, 1])
        y2 = _corner(x, triangles[t, 2])
        b, feature = closest_point(p, y0, y1, y2)
        d = (p - b[0] * y0 - b[1] * y1 - b[2] * y2).norm()
        if d < best - 1e-15:
            best = d
            chosen = t
            barycentric = b
            on = feature
    return chosen, barycentric, on


@ti.func
def _gap(
    x: ti.template(),
    p,
    t: ti.i32,
    b,
    feature: ti.i32,
    triangles: ti.template(),
    border: ti.template(),
    normals: ti.template(),
    side: ti.f64,
    offset: ti.f64,
):
    """Gap [m] to the closest point, its gradient in p, sign, and kind (3 face, 2 edge, 1 corner)."""
    y0 = _corner(x, triangles[t, 0])
    y1 = _corner(x, triangles[t, 1])
    y2 = _corner(x, triangles[t, 2])
    r = p - b[0] * y0 - b[1] * y1 - b[2] * y2
    d = r.norm()
    face = (y1 - y0).cross(y2 - y0).normalized()
    sign = side
    kind = 3
    direction = sign * face
    gap = sign * face.dot(r) - offset
    if feature < 6:
        kind = 2
        if feature < 3:
            kind = 1
        sign = 1.0
        if border[t, feature] == 0:
            m = vec3(0.0, 0.0, 0.0)
            for j in range(3):
                m += b[j] * _corner(normals, triangles[t, j])
            if side * m.dot(r) < 0.0:
                sign = -1.0
        if d > 1e-12:
            direction = sign * r / d
        gap = sign * d - offset
    return gap, direction, sign, kind


@ti.func
def _elastic_slip(
    x: ti.template(),
    x_start: ti.template(),
    own: ti.template(),
    weights: ti.template(),
    triangles: ti.template(),
    lag: ti.template(),
    lag_b: ti.template(),
    lag_n: ti.template(),
    anchor: ti.template(),
    s: ti.i32,
):
    """Elastic slip [m] and projector, against the triangle under the sample at the start."""
    move = _sample(x, own, weights, s) - _sample(x_start, own, weights, s)
    for j in range(3):
        i = triangles[lag[s], j]
        move -= lag_b[s, j] * (_corner(x, i) - _corner(x_start, i))
    t = tangent_projector(_corner(lag_n, s))
    return t @ (_corner(anchor, s) + move), t


@ti.kernel
def _start(
    x: F2,
    own: I2,
    weights: F2,
    triangles: I2,
    border: I2,
    first: I1,
    near: I1,
    normals: F2,
    side: F1,
    c: F1,
    lag: I1,
    lag_b: F2,
    lag_n: F2,
    height: F1,
    gaps: F1,
):
    """Triangle under each sample (-1: none), where on it, normal, height over its face, gap."""
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        p = _sample(x, own, weights, s)
        t, b, feature = _nearest(x, p, triangles, first, near, s)
        lag[s] = t
        height[s] = 0.0
        gaps[s] = FAR
        if t >= 0:
            gap, direction, _sign, _kind = _gap(x, p, t, b, feature, triangles, border, normals, side[s], c[OFFSET])
            gaps[s] = gap
            y0 = _corner(x, triangles[t, 0])
            face = (_corner(x, triangles[t, 1]) - y0).cross(_corner(x, triangles[t, 2]) - y0)
            height[s] = face.dot(p - y0)
            for j in range(3):
                lag_b[s, j] = b[j]
                lag_n[s, j] = direction[j]


@ti.kernel
def _energy(
    x: F2,
    x_start: F2,
    own: I2,
    weights: F2,
    triangles: I2,
    border: I2,
    first: I1,
    near: I1,
    normals: F2,
    side: F1,
    areas: F1,
    c: F1,
    limit: F1,
    lag: I1,
    lag_b: F2,
    lag_n: F2,
    anchor: F2,
    out: F1,
):
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        if first[s] < first[s + 1]:
            p = _sample(x, own, weights, s)
            t, b, feature = _nearest(x, p, triangles, first, near, s)
            gap, _direction, _sign, _kind = _gap(x, p, t, b, feature, triangles, border, normals, side[s], c[OFFSET])
            e = areas[s] * potential(gap, c[STIFFNESS], c[WIDTH])
            if limit[s] > 0.0:
                u, _projector = _elastic_slip(x, x_start, own, weights, triangles, lag, lag_b, lag_n, anchor, s)
                e += friction_potential(u, limit[s], c[STIFFNESS] * areas[s])
            out[0] = out[0] + e


@ti.kernel
def _gradient(
    x: F2,
    x_start: F2,
    own: I2,
    weights: F2,
    triangles: I2,
    border: I2,
    first: I1,
    near: I1,
    normals: F2,
    side: F1,
    areas: F1,
    c: F1,
    limit: F1,
    lag: I1,
    lag_b: F2,
    lag_n: F2,
    anchor: F2,
    force: F2,
    load: F1,
    gaps: F1,
    out: F2,
):
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        load[s] = 0.0
        gaps[s] = FAR
        for j in range(3):
            force[s, j] = 0.0
        if first[s] < first[s + 1]:
            p = _sample(x, own, weights, s)
            t, b, feature = _nearest(x, p, triangles, first, near, s)
            gap, direction, _sign, _kind = _gap(x, p, t, b, feature, triangles, border, normals, side[s], c[OFFSET])
            gaps[s] = gap
            load[s] = areas[s] * pressure(gap, c[STIFFNESS], c[WIDTH])
            rub = vec3(0.0, 0.0, 0.0)
            if limit[s] > 0.0:
                u, _projector = _elastic_slip(x, x_start, own, weights, triangles, lag, lag_b, lag_n, anchor, s)
                rub = -friction_force(u, limit[s], c[STIFFNESS] * areas[s])
                for k in range(3):
                    for j in range(3):
                        out[triangles[lag[s], k], j] = out[triangles[lag[s], k], j] + lag_b[s, k] * rub[j]
            normal = load[s] * direction
            for j in range(3):
                force[s, j] = normal[j] + rub[j]
                for a in range(weights.shape[1]):
                    out[own[s, a], j] = out[own[s, a], j] - weights[s, a] * force[s, j]
                for k in range(3):
                    out[triangles[t, k], j] = out[triangles[t, k], j] + b[k] * normal[j]


@ti.func
def _participant(own: ti.template(), weights: ti.template(), triangles: ti.template(), s: ti.i32, t: ti.i32, a: ti.i32):
    """Node, block of the second derivative, and weight in it of the a-th participant in a contact."""
    count = weights.shape[1]
    node = triangles[t, ti.max(a - count, 0)]
    block = a - count + 1
    weight = 1.0
    if a < count:
        node = own[s, a]
        block = 0
        weight = weights[s, a]
    return node, block, weight


@ti.kernel
def _hessian(
    x: F2,
    x_start: F2,
    own: I2,
    weights: F2,
    triangles: I2,
    border: I2,
    first: I1,
    near: I1,
    normals: F2,
    side: F1,
    areas: F1,
    c: F1,
    limit: F1,
    lag: I1,
    lag_b: F2,
    lag_n: F2,
    anchor: F2,
    exact: I1,
    start: I1,
    column: I1,
    place: I1,
    second: F3,
    out: F1,
):
    """``second``: scratch, blocks (4 x 4) of the second derivative of the gap in (p, y0, y1, y2), [1/m]."""
    ti.loop_config(serialize=True)
    for s in range(weights.shape[0]):
        if first[s] < first[s + 1]:
            p = _sample(x, own, weights, s)
            t, b, feature = _nearest(x, p, triangles, first, near, s)
            gap, direction, sign, kind = _gap(x, p, t, b, feature, triangles, border, normals, side[s], c[OFFSET])
            count = weights.shape[1] + 3
            for law in range(2):
                # First the pressure on the triangle that is nearest now, then friction on that of the start.
                on = t
                at = b
                stiff = (areas[s] * slope(gap, c[STIFFNESS], c[WIDTH])) * direction.outer_product(direction)
                bend = -areas[s] * pressure(gap, c[STIFFNESS], c[WIDTH]) * exact[0]
                active = gap < c[WIDTH]
                if law == 0 and active and exact[0] == 1:
                    distance_second_derivative(
                        p,
                        _corner(x, triangles[t, 0]),
                        _corner(x, triangles[t, 1]),
                        _corner(x, triangles[t, 2]),
                        b,
                        kind,
                        sign,
                        second,
                    )
                if law == 1:
                    bend = 0.0
                    active = limit[s] > 0.0
                    if active:
                        on = lag[s]
                        at = _corner(lag_b, s)
                        u, projector = _elastic_slip(x, x_start, own, weights, triangles, lag, lag_b, lag_n, anchor, s)
                        stiff = friction_stiffness(u, limit[s], c[STIFFNESS] * areas[s], projector)
                if active:
                    for a in range(count):
                        i, qa, wa = _participant(own, weights, triangles, s, on, a)
                        ca = wa
                        if qa > 0:
                            ca = -at[qa - 1]
                        for d in range(a, count):
                            j, qd, wd = _participant(own, weights, triangles, s, on, d)
                            cd = wd
                            if qd > 0:
                                cd = -at[qd - 1]
                            m = (ca * cd) * stiff
                            if bend != 0.0:
                                for r in ti.static(range(3)):
                                    for q in ti.static(range(3)):
                                        m[r, q] += bend * wa * wd * second[4 * qa + qd, r, q]
                            add_block(start, column, place, out, i, j, m)


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
        self._c = np.zeros(6)
        self._c[OFFSET] = offset
        self._limit, self._load, self._gaps = np.zeros(count), np.zeros(count), np.full(count, FAR)
        self._side, self._height, self._start_gap = np.ones(count), np.zeros(count), np.full(count, FAR)
        self._anchor, self._force = np.zeros((count, 3)), np.zeros((count, 3))
        self._lag_b, self._lag_n = np.zeros((count, 3)), np.zeros((count, 3))
        self._lag = np.zeros(count, dtype=np.int32)
        self._exact = np.zeros(1, dtype=np.int32)

    def blocks(self) -> np.ndarray:
        """Pairs of the samples' nodes and of the corners of all triangles in the wider search."""
        sample, triangle = self._candidates.coupled
        own, corner = self._own[sample], self._triangles[triangle]
        left = [np.repeat(own, 3, axis=1), own[:, [0]], corner[:, [0, 0, 1]]]
        right = [np.tile(corner, (1, own.shape[1])), own[:, [0]], corner[:, [1, 2, 2]]]
        inner = np.triu_indices(own.shape[1])
        members = np.unique(sample)
        left.append(self._own[members][:, inner[0]].reshape(-1, 1))
        right.append(self._own[members][:, inner[1]].reshape(-1, 1))
        return np.column_stack([np.concatenate([a.ravel() for a in left]), np.concatenate([a.ravel() for a in right])])

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        del slots
        assert buffers.pairs is not None
        self._buffers = buffers
        self._x = buffers.x
        self._x_start = np.zeros_like(buffers.x)
        self._normals = np.zeros_like(buffers.x)
        self._second = np.zeros((16, 3, 3))
        self._bind()

    def _bind(self) -> None:
        found, buffers = self._candidates, self._buffers
        surface = (self._own, self._weights, self._triangles, self._border, found.first, found.near)
        surface = (*surface, self._normals, self._side)
        lag = (self._lag, self._lag_b, self._lag_n)
        self._start = BoundKernel(_start, self._x_start, *surface, self._c, *lag, self._height, self._start_gap)
        laws = (buffers.x, self._x_start, *surface, self._areas, self._c, self._limit, *lag, self._anchor)
        table = buffers.pairs
        assert table is not None
        self._energy = BoundKernel(_energy, *laws, buffers.energy)
        self._gradient = BoundKernel(_gradient, *laws, self._force, self._load, self._gaps, buffers.gradient)
        self._hessian = BoundKernel(
            _hessian,
            *laws,
            self._exact,
            table.start,
            table.column,
            table.place,
            self._second,
            buffers.hessian,
        )

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._c[STIFFNESS] = parameters["stiffness_pa_per_m"]
        self._c[WIDTH] = parameters["rounding_m"]
        self._c[MU] = parameters["friction"]
        self._c[EXCESS] = parameters.get("static_excess", 0.0)
        self._c[SLIP_SCALE] = parameters.get("slip_speed_scale_m_s", 1.0)

    def prepare(self, step: StepContext, motion: float) -> bool:
        """Look for candidates around the start of a step; True when the coupled nodes changed."""
        reach = max(self._reach, motion)
        changed, grown = self._candidates.search(step.x_start, reach, self._reach)
        if grown:
            self._bind()
        return changed

    def outran(self) -> bool:
        """True when something may have come into contact that was not looked at."""
        return self._candidates.outran(self._x)

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        self._x_start[:] = step.x_start
        self._anchor[:] = internals["anchor"]
        if not self._candidates.any:
            self._limit[:] = 0.0
            return
        self._normals[:] = 0.0
        corners = step.x_start[self._triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        for k in range(3):
            np.add.at(self._normals, self._triangles[:, k], normal)
        known = internals["side"] if self._two_sided else np.ones(len(self._areas))
        self._side[:] = np.where(known == 0.0, 1.0, known)
        self._start()
        fresh = (known == 0.0) & (self._height < 0.0)
        if fresh.any():
            self._side[fresh] = -1.0
            self._start()
        mu = self._c[MU] * np.ones(len(self._areas))
        if self._c[EXCESS] > 0.0:
            mu *= 1.0 + self._c[EXCESS] * np.exp(-((internals["slip_speed"] / self._c[SLIP_SCALE]) ** 2))
        self._limit[:] = np.where(self._lag >= 0, mu * internals["load"], 0.0)

    def add_energy(self) -> None:
        if self._candidates.any:
            self._energy()

    def add_gradient(self) -> None:
        if self._candidates.any:
            self._gradient()
        else:
            self._load[:], self._gaps[:], self._force[:] = 0.0, FAR, 0.0

    def add_hessian(self, exact: bool) -> None:
        if self._candidates.any:
            self._exact[0] = exact
            self._hessian()

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Carry elastic slip, load, slip speed and side; zero where nothing touches or is near."""
        if not self._candidates.any:
            return self.initial_internals()
        nodes = self._triangles[np.maximum(self._lag, 0)]
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
            "side": np.where(self._gaps < self._reach, self._side, 0.0),
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
        return int(np.count_nonzero(self._load)), float(self._gaps.min(initial=np.inf))


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
