"""Bending energy of a sheet from the hinge angles of its mesh, plate rigidity included.

    E = sum_T A_T/2 kappa_T^T D kappa_T,    kappa_T = B_T (theta - theta_0) - kappa^p_T,    D = h^3/12 C

theta_0 are rest angles (any curved or creased rest shape), kappa^p_T plastic curvatures, C the plane
stress stiffness (E, nu, orthotropic if asked) and B_T the curvature operator of
:mod:`sim_core.energies.curvature`, which is exact for constant curvature on any mesh. B_T^T A_T D kappa_T
are moments on the hinges around T. Without ``exact`` the Hessian is the Gauss-Newton part
A_T L^T D L with L = dkappa_T/dx, which is positive semidefinite; ``exact`` adds the hinge moments times
the second derivatives of the angles.

Bending plasticity, per triangle, in curvature (so that the mesh does not decide): with the norm
|kappa|_D = sqrt(kappa^T D kappa / D_11), elastic while |kappa_T|_D <= k_Y + H a, radial return with
linear hardening H beyond, where a is the accumulated plastic curvature [1/m]. Simo & Hughes,
Computational Inelasticity, box 3.1, written for moment and curvature.
"""

from collections.abc import Mapping

import numpy as np
import taichi as ti

from sim_core.energies.curvature import curvature_operator
from sim_core.energies.dihedral import angle, angle_gradient, corner, side_curvature
from sim_core.energies.linearised import ByNumber, Linearised, axes_of, gathered, placed, places
from sim_core.energies.membrane import material_frames
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.geometry.sheets import SheetMesh, find_hinges
from sim_core.kernels import F1, F2, I1, I2, BoundKernel, mat3, vec3
from sim_core.materials.elastic import plane_stress

_SIDE_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@ti.func
def _load(x: ti.template(), hinge: ti.template(), h: ti.i32):
    return (
        corner(x, hinge[h, 0]),
        corner(x, hinge[h, 1]),
        corner(x, hinge[h, 2]),
        corner(x, hinge[h, 3]),
    )


@ti.kernel
def _angles(x: F2, hinge: I2, rest: F1, out: F1):
    """Deviation of the angles from rest [rad]."""
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        out[h] = angle(x0, x1, x2, x3) - rest[h]


@ti.func
def _elastic_curvature(
    t: ti.i32, d: ti.template(), first: ti.template(), around: ti.template(), b: ti.template(), plastic: ti.template()
):
    """Elastic curvature of triangle ``t`` [1/m]."""
    kappa = -vec3(plastic[t, 0], plastic[t, 1], plastic[t, 2])
    for k in range(first[t], first[t + 1]):
        kappa += d[around[k]] * vec3(b[k, 0], b[k, 1], b[k, 2])
    return kappa


@ti.func
def _moment(c: ti.template(), kappa):
    m = vec3(0.0, 0.0, 0.0)
    for i in ti.static(range(3)):
        m[i] = c[i, 0] * kappa[0] + c[i, 1] * kappa[1] + c[i, 2] * kappa[2]
    return m


@ti.kernel
def _energy(d: F1, first: I1, around: I1, b: F2, plastic: F2, area: F1, c: F2, out: F1):
    ti.loop_config(serialize=True)
    for t in range(area.shape[0]):
        kappa = _elastic_curvature(t, d, first, around, b, plastic)
        out[0] = out[0] + 0.5 * area[t] * kappa.dot(_moment(c, kappa))


@ti.kernel
def _moments(d: F1, first: I1, around: I1, b: F2, plastic: F2, area: F1, c: F2, out: F1):
    """Hinge moments [N m]."""
    ti.loop_config(serialize=True)
    for h in range(d.shape[0]):
        out[h] = 0.0
    ti.loop_config(serialize=True)
    for t in range(area.shape[0]):
        m = area[t] * _moment(c, _elastic_curvature(t, d, first, around, b, plastic))
        for k in range(first[t], first[t + 1]):
            out[around[k]] = out[around[k]] + b[k, 0] * m[0] + b[k, 1] * m[1] + b[k, 2] * m[2]


@ti.kernel
def _gradient(x: F2, hinge: I2, moment: F1, out: F2):
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        g = angle_gradient(x0, x1, x2, x3)
        for a in ti.static(range(4)):
            for j in ti.static(range(3)):
                out[hinge[h, a], j] = out[hinge[h, a], j] + moment[h] * g[3 * a + j]


@ti.kernel
def _gradients(x: F2, hinge: I2, out: F2):
    """Store the twelve derivatives of every angle."""
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        g = angle_gradient(x0, x1, x2, x3)
        for k in ti.static(range(12)):
            out[h, k] = g[k]


@ti.kernel
def _gauss_newton(
    g: F2, first: I1, around: I1, b: F2, place: I2, nodes: I1, area: F1, c: F2, start: I1, slots: I2, row: F2, out: F1
):
    """Add A L^T D L for each triangle. ``place``: columns of L where a hinge's nodes are; ``nodes``: how
    many; ``start``: the triangle's first block; ``row``: scratch for L and A D L, ``(columns, 6)``."""
    ti.loop_config(serialize=True)
    for t in range(area.shape[0]):
        for n in range(3 * nodes[t]):
            for r in ti.static(range(3)):
                row[n, r] = 0.0
        for k in range(first[t], first[t + 1]):
            h = around[k]
            for a in range(4):
                for j in ti.static(range(3)):
                    n = 3 * place[k, a] + j
                    for r in ti.static(range(3)):
                        row[n, r] = row[n, r] + b[k, r] * g[h, 3 * a + j]
        for n in range(3 * nodes[t]):
            for r in ti.static(range(3)):
                row[n, 3 + r] = area[t] * (c[r, 0] * row[n, 0] + c[r, 1] * row[n, 1] + c[r, 2] * row[n, 2])
        block = start[t]
        for p in range(nodes[t]):
            left = mat3(0.0)
            for i, r in ti.static(ti.ndrange(3, 3)):
                left[i, r] = row[3 * p + i, r]
            for q in range(p, nodes[t]):
                right = mat3(0.0)
                for r, j in ti.static(ti.ndrange(3, 3)):
                    right[r, j] = row[3 * q + j, 3 + r]
                m = left @ right
                if p == q:
                    for i, j in ti.static(((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))):
                        at = slots[block, 3 * i + j]
                        out[at] = out[at] + m[i, j]
                else:
                    for i, j in ti.static(ti.ndrange(3, 3)):
                        at = slots[block, 3 * i + j]
                        out[at] = out[at] + m[i, j]
                block += 1


@ti.kernel
def _curved(x: F2, hinge: I2, moment: F1, slots: I2, out: F1):
    """Add moment times the second derivative of the angle, side by side."""
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        for side in range(2):
            apex = x2
            turn = 1.0
            if side == 1:
                apex = x3
                turn = -1.0
            n, along, up, dc, dphi = side_curvature(x0, x1, apex, turn)
            block = 12 * h + 6 * side
            for i in range(3):
                for j in range(i, 3):
                    left = moment[h] * (dc[i, 2 * j] * along + dc[i, 2 * j + 1] * up)
                    right = (moment[h] * dphi[i, 2]) * (dphi[j, 0] * along + dphi[j, 1] * up)
                    for r in ti.static(range(3)):
                        for q in ti.static(range(3)):
                            if i != j or r <= q:
                                at = slots[block, 3 * r + q]
                                out[at] = out[at] + n[r] * left[q] - right[r] * n[q]
                    block += 1


class Bending:
    """Term of one sheet. ``node_offset``: index of the sheet's first node among all nodes.

    ``mesh`` is the flat or curved mesh whose metric defines areas; rest angles are those at ``formed`` [m] ``(n, 3)``,
    an isometric form of it (default: the mesh itself). ``held``: bool ``(n,)``, nodes in one rigid clamp;
    triangles of such nodes alone do not bend, which puts the clamp's edge where the held nodes end.
    """

    mirrored = True

    def __init__(
        self,
        name: str,
        mesh: SheetMesh,
        node_offset: int,
        axis: np.ndarray,
        formed: np.ndarray | None = None,
        held: np.ndarray | None = None,
    ) -> None:
        self.name = name
        self.hinges = find_hinges(mesh.triangles)
        frames = material_frames(mesh.nodes, mesh.triangles, axis)
        count = len(mesh.triangles)
        rigid = np.zeros(count, dtype=bool) if held is None else held[mesh.triangles].all(axis=1)
        self._kappa = curvature_operator(mesh.nodes, mesh.triangles, self.hinges, frames, mesh.areas, rigid)
        self._hinge = np.ascontiguousarray(self.hinges.nodes + node_offset, dtype=np.int32)
        self._areas = mesh.areas
        self._set_stencils()
        n_hinges = len(self._hinge)
        self._deviation = np.zeros(n_hinges)
        self._moment = np.zeros(n_hinges)
        self._plastic = np.zeros((count, 3))
        self._g = np.zeros((n_hinges, 12))
        self._d = np.zeros((3, 3))
        self._seen = np.full((0, 3), np.nan)
        self._yield_curvature = np.inf
        self._hardening = 0.0
        self.rest_angles = self._measure(mesh.nodes if formed is None else formed, node_offset)

    def _measure(self, nodes: np.ndarray, node_offset: int) -> np.ndarray:
        out = np.zeros(len(self._hinge))
        hinge = np.ascontiguousarray(self._hinge - node_offset, dtype=np.int32)
        BoundKernel(_angles, np.ascontiguousarray(nodes), hinge, np.zeros(len(hinge)), out)()
        return out

    def _set_stencils(self) -> None:
        """Hinges and nodes that the curvature of each triangle depends on, one after the other."""
        rows = [self._kappa[k::3].tocsr() for k in range(3)]
        pattern = sum(abs(r) for r in rows).tocsr()
        pattern.sort_indices()
        self._first = pattern.indptr.astype(np.int32)
        self._around = pattern.indices.astype(np.int32)
        triangle = np.repeat(np.arange(len(self._areas)), np.diff(pattern.indptr))
        self._b = np.column_stack([np.asarray(r[triangle, pattern.indices]).ravel() for r in rows])
        key = triangle[:, None].astype(np.int64) * (self._hinge.max(initial=0) + 1) + self._hinge[self._around]
        members, place = np.unique(key, return_inverse=True)
        owner = members // (self._hinge.max(initial=0) + 1)
        self._nodes = np.bincount(owner, minlength=len(self._areas)).astype(np.int32)
        begin = np.concatenate([[0], np.cumsum(self._nodes)])
        self._place = (place.reshape(-1, 4) - begin[triangle][:, None]).astype(np.int32)
        self._members = members % (self._hinge.max(initial=0) + 1)
        self._begin = begin
        self._start = np.concatenate([[0], np.cumsum(self._nodes * (self._nodes + 1) // 2)]).astype(np.int32)

    def blocks(self) -> np.ndarray:
        """Pairs of the nodes of each triangle's stencil, then of each side of each hinge."""
        pairs = []
        for t, count in enumerate(self._nodes):
            nodes = self._members[self._begin[t] : self._begin[t] + count]
            i, j = np.triu_indices(count)
            pairs.append(np.column_stack([nodes[i], nodes[j]]))
        i, j = np.array(_SIDE_PAIRS).T
        sides = np.stack([self._hinge[:, [0, 1, 2]], self._hinge[:, [0, 1, 3]]], axis=1).reshape(-1, 3)
        pairs.append(np.stack([sides[:, i], sides[:, j]], axis=-1).reshape(-1, 2))
        return np.concatenate(pairs)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._x = buffers.x
        self._seen = np.full_like(buffers.x, np.nan)
        stencil = (self._first, self._around, self._b)
        law = (self._deviation, *stencil, self._plastic, self._areas, self._d)
        inner, outer = np.split(slots, [int(self._start[-1])])
        scratch = np.zeros((3 * int(self._nodes.max(initial=0)), 6))
        self._angles = BoundKernel(_angles, buffers.x, self._hinge, self.rest_angles, self._deviation)
        self._energy = BoundKernel(_energy, *law, buffers.energy)
        self._moments = BoundKernel(_moments, *law, self._moment)
        self._gradient = BoundKernel(_gradient, buffers.x, self._hinge, self._moment, buffers.gradient)
        self._gradients = BoundKernel(_gradients, buffers.x, self._hinge, self._g)
        self._gauss_newton = BoundKernel(
            _gauss_newton,
            *(self._g, *stencil, self._place, self._nodes, self._areas, self._d, self._start),
            *(np.ascontiguousarray(inner), scratch, buffers.hessian),
        )
        self._curved = BoundKernel(
            _curved, buffers.x, self._hinge, self._moment, np.ascontiguousarray(outer), buffers.hessian
        )

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._given = dict(parameters)
        self._d[:] = parameters["thickness_m"] ** 3 / 12.0 * plane_stress(parameters)
        self._d *= parameters.get("bending_factor", 1.0)
        self._yield_curvature = parameters.get("yield_curvature_per_m", np.inf)
        self._hardening = parameters.get("hardening_ratio", 0.0)

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del step
        self._plastic[:] = internals.get("plastic_curvature", 0.0)

    def _measure_angles(self) -> None:
        """Bring the angles up to date with the positions."""
        if not np.array_equal(self._seen, self._x):
            self._angles()
            self._seen[:] = self._x

    def add_energy(self) -> None:
        self._measure_angles()
        self._energy()

    def add_gradient(self) -> None:
        self._measure_angles()
        self._moments()
        self._gradient()

    def add_hessian(self, exact: bool) -> None:
        self._gradients()
        self._gauss_newton()
        if exact:
            self._measure_angles()
            self._moments()
            self._curved()

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        del step
        if "plastic_curvature" not in internals:
            return internals
        plastic, accumulated = internals["plastic_curvature"], internals["accumulated_curvature"]
        elastic = self.curvatures() - plastic
        norm = np.sqrt(np.einsum("mi,ij,mj->m", elastic, self._d, elastic) / self._d[0, 0])
        excess = norm - (self._yield_curvature + self._hardening * accumulated)
        flow = np.where(excess > 0.0, excess / (1.0 + self._hardening), 0.0)
        direction = elastic / np.where(norm > 0.0, norm, 1.0)[:, None]
        return {
            "plastic_curvature": plastic + flow[:, None] * direction,
            "accumulated_curvature": accumulated + flow,
        }

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised | None:
        """Derivatives by plastic and accumulated curvature; at yield, those of going on elastically."""
        del step, after
        if "plastic_curvature" not in internals:
            return None
        place, whole = places(internals), self._x.size
        plastic, accumulated = place["plastic_curvature"], place["accumulated_curvature"][:, None]
        size = plastic.size + accumulated.size
        self._gradients()
        hinge = np.broadcast_to(np.arange(len(self._hinge))[:, None], (len(self._hinge), 1))
        angles = placed((self._g[:, None], hinge, axes_of(self._hinge)), shape=(len(self._hinge), whole))
        curvatures = (self._kappa @ angles.tocsr()).tocsr()  # of all triangles by all positions, (3 m, 3 n)
        count = len(self._areas)
        moments = -self._areas[:, None, None] * self._d
        rows = np.arange(3 * count).reshape(count, 3)
        stiffness = placed((moments, rows, plastic), shape=(3 * count, size))

        elastic = self.curvatures() - internals["plastic_curvature"]
        metric = self._d / self._d[0, 0]
        norm = np.sqrt(np.einsum("mi,ij,mj->m", elastic, metric, elastic))
        excess = norm - (self._yield_curvature + self._hardening * internals["accumulated_curvature"])
        flows = excess > 0.0
        far = np.where(norm > 0.0, norm, 1.0)[:, None]
        along, slope = elastic / far, elastic @ metric / far
        flow = np.where(flows, excess, 0.0) / (1.0 + self._hardening)
        rate = np.where(flows, 1.0 / (1.0 + self._hardening), 0.0)[:, None]
        turn = np.eye(3) - along[:, :, None] * slope[:, None, :]
        by_curvature = rate[..., None] * along[:, :, None] * slope[:, None] + (flow[:, None] / far)[..., None] * turn
        by_accumulated = -self._hardening * rate * along
        one = np.ones((count, 1, 1))
        memory = placed(
            (np.eye(3) - by_curvature, plastic, plastic),
            (by_accumulated[..., None], plastic, accumulated),
            ((-rate * slope)[:, None], accumulated, plastic),
            (one - self._hardening * rate[..., None], accumulated, accumulated),
            shape=(size, size),
        )
        by_total = placed(
            (by_curvature, plastic, rows), ((rate * slope)[:, None], accumulated, rows), shape=(size, 3 * count)
        )
        numbers = {}
        for quantity in self._given:
            d, onset, hardening = self._by_number(quantity)
            moment = (self._areas[:, None] * (elastic @ d)).ravel()
            metric_slope = (d - self._d * d[0, 0] / self._d[0, 0]) / self._d[0, 0]
            grown = 0.5 * np.einsum("mi,ij,mj->m", elastic, metric_slope, elastic) / far[:, 0]
            later = onset + hardening * internals["accumulated_curvature"] + hardening * flow
            rise = np.where(flows, grown - later, 0.0) / (1.0 + self._hardening)
            turned = rise[:, None] * along - (flow * grown / far[:, 0])[:, None] * along
            kept = gathered((turned, plastic), (rise, accumulated), size=size)
            numbers[quantity] = ByNumber(curvatures.T @ moment, kept, np.zeros(3))
        return Linearised(
            numbers=numbers,
            force_memory=(curvatures.T @ stiffness.tocsr()).tocoo(),
            memory_memory=memory,
            memory_end=(by_total.tocsr() @ curvatures).tocoo(),
        )

    def _by_number(self, quantity: str) -> tuple[np.ndarray, float, float]:
        """Derivatives of D, of the yield curvature and of the hardening by one number of the term."""
        given, ends = self._given, []
        h = 1e-5 * abs(given[quantity]) or 1e-7
        for value in (given[quantity] + h, given[quantity] - h):
            self.configure({**given, quantity: value})
            ends.append((self._d.copy(), self._yield_curvature, self._hardening))
        self.configure(given)
        d, onset, hardening = ((a - b) / (2.0 * h) for a, b in zip(*ends, strict=True))
        return d, onset, hardening

    def initial_internals(self) -> Internals:
        """Plastic curvature [1/m] ``(m, 3)`` and its accumulation ``(m,)``; nothing when yield is off."""
        if not np.isfinite(self._yield_curvature):
            return {}
        return {
            "plastic_curvature": np.zeros((len(self._areas), 3)),
            "accumulated_curvature": np.zeros(len(self._areas)),
        }

    def curvatures(self) -> np.ndarray:
        """Elastic plus plastic curvature change of each triangle at ``buffers.x`` [1/m], ``(m, 3)``."""
        self._measure_angles()
        return np.asarray(self._kappa @ self._deviation).reshape(-1, 3)
