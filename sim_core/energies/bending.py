"""Bending energy of a sheet from the hinge angles of its mesh, plate rigidity included.

    E = sum_T A_T/2 kappa_T^T D kappa_T,    kappa_T = B_T (theta - theta_0) - kappa^p_T,    D = h^3/12 C

theta_0 are rest angles (any curved or creased rest shape), kappa^p_T plastic curvatures, C the plane
stress stiffness (E, nu, orthotropic if asked) and B_T the curvature operator of
:mod:`sim_core.energies.curvature`, which is exact for constant curvature on any mesh. In terms of
hinges this is a constant quadratic form E = 1/2 d^T Q d - d^T p + e_0 with d = theta - theta_0, so
Q d - p are the hinge moments. Without ``exact`` the Hessian is the Gauss-Newton part G^T Q G, which
is positive semidefinite; ``exact`` adds the moments times the second derivatives of the angles.

Bending plasticity, per triangle, in curvature (so that the mesh does not decide): with the norm
|kappa|_D = sqrt(kappa^T D kappa / D_11), elastic while |kappa_T|_D <= k_Y + H a, radial return with
linear hardening H beyond, where a is the accumulated plastic curvature [1/m]. Simo & Hughes,
Computational Inelasticity, box 3.1, written for moment and curvature.
"""

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp
import taichi as ti

from sim_core.energies.curvature import curvature_operator
from sim_core.energies.dihedral import (
    angle,
    angle_gradient,
    angle_gradient_change,
    corner,
)
from sim_core.energies.membrane import material_frames
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.geometry.sheets import SheetMesh, find_hinges
from sim_core.kernels import F1, F2, I1, I2, BoundKernel, vec3
from sim_core.materials.elastic import plane_stress

_VOIGT = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


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
    """Deviation of the angles from rest, on the branch nearest to zero turn of the rest angle."""
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        out[h] = angle(x0, x1, x2, x3) - rest[h]


@ti.kernel
def _energy(d: F1, row: I1, column: I1, q: F1, p: F1, constant: F1, out: F1):
    ti.loop_config(serialize=True)
    for k in range(row.shape[0]):
        scale = 1.0
        if row[k] == column[k]:
            scale = 0.5
        out[0] = out[0] + scale * q[k] * d[row[k]] * d[column[k]]
    ti.loop_config(serialize=True)
    for h in range(d.shape[0]):
        out[0] = out[0] - d[h] * p[h]
    ti.loop_config(serialize=True)
    for h in range(1):
        out[0] = out[0] + constant[h]


@ti.kernel
def _moments(d: F1, row: I1, column: I1, q: F1, p: F1, out: F1):
    """Hinge moments Q d - p [N m]."""
    ti.loop_config(serialize=True)
    for h in range(d.shape[0]):
        out[h] = -p[h]
    ti.loop_config(serialize=True)
    for k in range(row.shape[0]):
        i = row[k]
        j = column[k]
        out[i] = out[i] + q[k] * d[j]
        if i != j:
            out[j] = out[j] + q[k] * d[i]


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
def _gauss_newton(g: F2, hinge: I2, row: I1, column: I1, q: F1, slots: I2, out: F1):
    """Add Q_ij (g_i g_j^T + g_j g_i^T) for i < j and Q_ii g_i g_i^T, upper triangle."""
    ti.loop_config(serialize=True)
    for k in range(row.shape[0]):
        i = row[k]
        j = column[k]
        for a in range(4):
            for b in range(4):
                same = hinge[i, a] == hinge[j, b]
                for r in range(3):
                    for c in range(3):
                        value = q[k] * g[i, 3 * a + r] * g[j, 3 * b + c]
                        if i == j and (a > b or (a == b and r > c)):
                            value = 0.0
                        if i != j and same and r == c:
                            value = 2.0 * value
                        at = slots[16 * k + 4 * a + b, 3 * r + c]
                        out[at] = out[at] + value


@ti.kernel
def _curved(x: F2, hinge: I2, moment: F1, start: I1, slots: I2, out: F1):
    """Add moment times the second derivative of the angle, one column of the 12 x 12 at a time."""
    ti.loop_config(serialize=True)
    for h in range(hinge.shape[0]):
        x0, x1, x2, x3 = _load(x, hinge, h)
        for b in range(4):
            for c in range(3):
                unit = vec3(0.0, 0.0, 0.0)
                for j in ti.static(range(3)):
                    if j == c:
                        unit[j] = 1.0
                d0 = vec3(0.0, 0.0, 0.0)
                d1 = vec3(0.0, 0.0, 0.0)
                d2 = vec3(0.0, 0.0, 0.0)
                d3 = vec3(0.0, 0.0, 0.0)
                if b == 0:
                    d0 = unit
                elif b == 1:
                    d1 = unit
                elif b == 2:
                    d2 = unit
                else:
                    d3 = unit
                change = angle_gradient_change(x0, x1, x2, x3, d0, d1, d2, d3)
                for k in ti.static(range(12)):
                    a = ti.static(k // 3)
                    r = ti.static(k % 3)
                    if a < b or (a == b and r <= c):
                        at = slots[start[h] + 4 * a + b, 3 * r + c]
                        out[at] = out[at] + moment[h] * change[k]


class Bending:
    """Term of one sheet. ``node_offset``: index of the sheet's first node among all nodes.

    ``mesh`` is the flat or curved mesh whose metric defines areas; ``rest_angles`` default to those
    of the mesh itself [rad], shape ``(n_hinges,)``. ``held``: bool ``(n,)``, nodes in one rigid clamp;
    triangles of such nodes alone do not bend, which puts the clamp's edge where the held nodes end.
    """

    mirrored = True

    def __init__(
        self,
        name: str,
        mesh: SheetMesh,
        node_offset: int,
        axis: np.ndarray,
        rest_angles: np.ndarray | None = None,
        held: np.ndarray | None = None,
    ) -> None:
        self.name = name
        self.hinges = find_hinges(mesh.triangles)
        frames = material_frames(mesh.nodes, mesh.triangles, axis)
        rigid = np.zeros(len(mesh.triangles), dtype=bool) if held is None else held[mesh.triangles].all(axis=1)
        self._kappa = curvature_operator(mesh.nodes, mesh.triangles, self.hinges, frames, mesh.areas, rigid)
        self._hinge = np.ascontiguousarray(self.hinges.nodes + node_offset, dtype=np.int32)
        self._areas = mesh.areas
        n_hinges = len(self._hinge)
        self._forms = self._unit_forms(self._kappa)
        self._deviation = np.zeros(n_hinges)
        self._moment = np.zeros(n_hinges)
        self._plastic_moment = np.zeros(n_hinges)
        self._plastic_energy = np.zeros(1)
        self._g = np.zeros((n_hinges, 12))
        self._d = np.zeros((3, 3))
        self._yield_curvature = np.inf
        self._hardening = 0.0
        if rest_angles is None:
            rest_angles = self._measure(mesh.nodes, node_offset)
        self.rest_angles = np.array(rest_angles, dtype=float)

    def _measure(self, nodes: np.ndarray, node_offset: int) -> np.ndarray:
        out = np.zeros(len(self._hinge))
        hinge = np.ascontiguousarray(self._hinge - node_offset, dtype=np.int32)
        BoundKernel(_angles, np.ascontiguousarray(nodes), hinge, np.zeros(len(hinge)), out)()
        return out

    def _unit_forms(self, kappa: sp.csr_matrix) -> np.ndarray:
        """Values of Q per unit of D_11, D_12, D_13, D_22, D_23, D_33: ``(n_pairs, 6)``."""
        forms = []
        rows = [kappa[k::3] for k in range(3)]
        area = sp.diags(self._areas)
        for i, j in _VOIGT:
            form = rows[i].T @ area @ rows[j]
            forms.append(form if i == j else form + form.T)
        pattern = sp.triu(sum(abs(f) for f in forms) + sp.eye(kappa.shape[1])).tocoo()
        self._row = np.ascontiguousarray(pattern.row, dtype=np.int32)
        self._column = np.ascontiguousarray(pattern.col, dtype=np.int32)
        self._q = np.zeros(len(self._row))
        diagonal = np.zeros(kappa.shape[1], dtype=np.int32)
        on_diagonal = np.flatnonzero(self._row == self._column)
        diagonal[self._row[on_diagonal]] = 16 * on_diagonal
        self._diagonal = diagonal
        return np.column_stack([np.asarray(sp.csr_matrix(f)[self._row, self._column]).ravel() for f in forms])

    def blocks(self) -> np.ndarray:
        left = np.repeat(self._hinge[self._row], 4, axis=1).reshape(-1, 16)
        right = np.tile(self._hinge[self._column], (1, 4))
        return np.stack([left, right], axis=-1).reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        form = (self._deviation, self._row, self._column, self._q, self._plastic_moment)
        self._angles = BoundKernel(_angles, buffers.x, self._hinge, self.rest_angles, self._deviation)
        self._energy = BoundKernel(_energy, *form, self._plastic_energy, buffers.energy)
        self._moments = BoundKernel(_moments, *form, self._moment)
        self._gradient = BoundKernel(_gradient, buffers.x, self._hinge, self._moment, buffers.gradient)
        self._gradients = BoundKernel(_gradients, buffers.x, self._hinge, self._g)
        self._gauss_newton = BoundKernel(
            _gauss_newton, self._g, self._hinge, self._row, self._column, self._q, slots, buffers.hessian
        )
        self._curved = BoundKernel(
            _curved, buffers.x, self._hinge, self._moment, self._diagonal, slots, buffers.hessian
        )

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._d[:] = parameters["thickness_m"] ** 3 / 12.0 * plane_stress(parameters)
        self._d *= parameters.get("bending_factor", 1.0)
        self._q[:] = self._forms @ np.asarray([self._d[i, j] for i, j in _VOIGT])
        self._yield_curvature = parameters.get("yield_curvature_per_m", np.inf)
        self._hardening = parameters.get("hardening_ratio", 0.0)

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del step
        plastic = internals.get("plastic_curvature")
        if plastic is None:
            return
        moment = (self._areas[:, None] * (plastic @ self._d)).ravel()
        self._plastic_moment[:] = self._kappa.T @ moment
        self._plastic_energy[0] = 0.5 * moment @ plastic.ravel()

    def add_energy(self) -> None:
        self._angles()
        self._energy()

    def add_gradient(self) -> None:
        self._angles()
        self._moments()
        self._gradient()

    def add_hessian(self, exact: bool) -> None:
        self._gradients()
        self._gauss_newton()
        if exact:
            self._angles()
            self._moments()
            self._curved()

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        del step
        if "plastic_curvature" not in internals:
            return internals
        self._angles()
        plastic, accumulated = internals["plastic_curvature"], internals["accumulated_curvature"]
        elastic = (self._kappa @ self._deviation).reshape(-1, 3) - plastic
        norm = np.sqrt(np.einsum("mi,ij,mj->m", elastic, self._d, elastic) / self._d[0, 0])
        excess = norm - (self._yield_curvature + self._hardening * accumulated)
        flow = np.where(excess > 0.0, excess / (1.0 + self._hardening), 0.0)
        direction = elastic / np.where(norm > 0.0, norm, 1.0)[:, None]
        return {
            "plastic_curvature": plastic + flow[:, None] * direction,
            "accumulated_curvature": accumulated + flow,
        }

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
        self._angles()
        return np.asarray(self._kappa @ self._deviation).reshape(-1, 3)
