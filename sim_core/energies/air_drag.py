"""Air drag on a sheet: pressure against its normal motion, quadratic in speed.

    U = dt sum_T rho C_D A_T / 6 |v_n|^3,    v_n = n . (c - c_start)/dt

c is the centroid, n the normal at the start of the step, rho the density of air: the force is
1/2 rho C_D A v_n |v_n| against the motion (Hoerner, Fluid-Dynamic Drag, 1965, ch. 3: flat plates, C_D
about 1.2 broadside).
"""

from collections.abc import Mapping

import numpy as np
import taichi as ti

from sim_core.energies.linearised import Linearised, axes_of, placed, skew
from sim_core.energies.term import Buffers, Internals, Memoryless, StepContext
from sim_core.kernels import F1, F2, I2, BoundKernel, vec3

AIR_DENSITY_KG_M3 = 1.2


@ti.func
def _advance(x: ti.template(), start: ti.template(), tri: ti.template(), normal: ti.template(), e: ti.i32):
    """Normal motion of the centroid [m] and the normal."""
    move = vec3(0.0, 0.0, 0.0)
    for a in ti.static(range(3)):
        i = tri[e, a]
        move += vec3(x[i, 0] - start[i, 0], x[i, 1] - start[i, 1], x[i, 2] - start[i, 2]) / 3.0
    n = vec3(normal[e, 0], normal[e, 1], normal[e, 2])
    return move.dot(n), n


@ti.kernel
def _energy(x: F2, start: F2, tri: I2, normal: F2, factor: F1, out: F1):
    """``factor``: rho C_D A / dt^2 of each triangle."""
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        s, _ = _advance(x, start, tri, normal, e)
        out[0] = out[0] + factor[e] * ti.abs(s) ** 3 / 6.0


@ti.kernel
def _gradient(x: F2, start: F2, tri: I2, normal: F2, factor: F1, out: F2):
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        s, n = _advance(x, start, tri, normal, e)
        f = factor[e] * 0.5 * s * ti.abs(s) / 3.0 * n
        for a in range(3):
            for j in ti.static(range(3)):
                out[tri[e, a], j] = out[tri[e, a], j] + f[j]


@ti.kernel
def _hessian(x: F2, start: F2, tri: I2, normal: F2, factor: F1, slots: I2, out: F1):
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        s, n = _advance(x, start, tri, normal, e)
        k = factor[e] * ti.abs(s) / 9.0
        for block in range(9):
            for i in range(3):
                for j in range(3):
                    at = slots[9 * e + block, 3 * i + j]
                    out[at] = out[at] + k * n[i] * n[j]


class AirDragTerm(Memoryless):
    """Term of one sheet."""

    mirrored = False
    measured_at_rest = True

    def __init__(self, name: str, triangles: np.ndarray, areas: np.ndarray) -> None:
        self.name = name
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self._areas = areas
        self._factor = np.zeros(len(areas))
        self._normal = np.zeros((len(areas), 3))
        self._coefficient = 0.0

    def blocks(self) -> np.ndarray:
        a, b = np.divmod(np.arange(9), 3)
        return np.stack([self._triangles[:, a], self._triangles[:, b]], axis=-1).reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._x, self._start = buffers.x, np.zeros_like(buffers.x)
        mesh = (buffers.x, self._start, self._triangles, self._normal, self._factor)
        self.add_energy = BoundKernel(_energy, *mesh, buffers.energy)
        self.add_gradient = BoundKernel(_gradient, *mesh, buffers.gradient)
        self._hessian = BoundKernel(_hessian, *mesh, slots, buffers.hessian)

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._coefficient = parameters["drag_coefficient"]

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del internals
        self._start[:] = step.x_start
        corners = step.x_start[self._triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._normal[:] = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        self._factor[:] = AIR_DENSITY_KG_M3 * self._coefficient * self._areas / step.dt**2

    def add_hessian(self, exact: bool) -> None:
        del exact
        self._hessian()

    def by_areas(self, along: np.ndarray) -> np.ndarray:
        """Derivative of the work of the forces along nodal vectors ``(n, 3)`` by the triangles' areas ``(m,)``."""
        move, drift = (
            (v[self._triangles].mean(axis=1) * self._normal).sum(axis=1) for v in (self._x - self._start, along)
        )
        return np.asarray(0.5 * self._factor / self._areas * move * np.abs(move) * drift)

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised:
        """Derivatives by where the step started: of the motion, and of the normal."""
        del internals, after
        corners = step.x_start[self._triangles]
        sides = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        by_first, by_second = -skew(sides[1]), skew(sides[0])  # of the product of both sides
        turned = np.concatenate([-by_first - by_second, by_first, by_second], axis=-1)
        length = np.linalg.norm(np.cross(*sides), axis=1)[:, None, None]
        n = self._normal
        turned = (np.eye(3) - n[:, :, None] * n[:, None]) @ turned / length
        move = (self._x - step.x_start)[self._triangles].mean(axis=1)
        s = (move * n).sum(axis=1)
        ds = np.einsum("ti,tij->tj", move, turned) - np.tile(n, 3) / 3.0
        force = (self._factor * np.abs(s))[:, None, None] * n[:, :, None] * ds[:, None]
        force = (force + (self._factor * 0.5 * s * np.abs(s))[:, None, None] * turned) / 3.0
        axes = axes_of(self._triangles)
        return Linearised(force_start=placed((np.tile(force, (1, 3, 1)), axes, axes), shape=(self._x.size,) * 2))
