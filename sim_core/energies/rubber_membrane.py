"""Membrane energy of a rubber film: incompressible neo-Hookean law in plane stress, constant-strain triangles.

    W = mu / 2 (tr C + 1 / det C - 3),    mu = E / 3,    C = F^T F = 1 + 2 E_Green  (2 x 2, in plane)

per volume at rest; a film that keeps its volume is 1 / J = 1 / sqrt(det C) times as thick as at rest, and that is the
last stretch of the three (Treloar, The Physics of Rubber Elasticity, 3rd ed., eq. 4.10; Holzapfel, Nonlinear Solid
Mechanics, sec. 6.3). Stress and stiffness by Green strain are

    S = mu (1 - C^-1 / J^2),    dS = mu / J^2 [C^-1 (C^-1 : dC) + C^-1 dC C^-1],

the latter positive definite at any stretch, so that the material part of the Hessian is; the stress part is treated as
that of :mod:`sim_core.energies.membrane`, which this law follows in all else: damping by the rate of strain is
Kelvin-Voigt's with the stiffness at small strain. At small strain it is linear elasticity with nu = 1/2.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import taichi as ti

from sim_core.energies.membrane import Membrane, add_triangle, columns_of, green_strain, shape_of, tension_of
from sim_core.energies.sheet_vjp import SheetAlong
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.errors import ConfigError
from sim_core.kernels import F1, F2, F3, I1, I2, BoundKernel, row, times3, vec3

INCOMPRESSIBLE = 0.5


@ti.func
def _inverse(eps):
    """Components 11, 22, 12 of C^-1, and 1 / det C."""
    a, b, c = 1.0 + 2.0 * eps[0], 1.0 + 2.0 * eps[1], eps[2]
    least = 1.0 / (a * b - c * c)
    return vec3(b * least, a * least, -c * least), least


@ti.kernel
def _energy(x: F2, tri: I2, dm_inverse: F3, area: F1, mu: F1, viscous: F3, base: F2, out: F1):
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        f1, f2 = columns_of(x, tri, e, shape_of(dm_inverse, e))
        eps = green_strain(f1, f2)
        _, least = _inverse(eps)
        rate = eps - row(base, e)
        elastic = mu[e] * (eps[0] + eps[1] + 0.5 * (least - 1.0))
        out[0] = out[0] + area[e] * (elastic + 0.5 * rate.dot(times3(viscous, e, rate)))


@ti.kernel
def _gradient(x: F2, tri: I2, dm_inverse: F3, area: F1, mu: F1, viscous: F3, base: F2, out: F2):
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        b = shape_of(dm_inverse, e)
        f1, f2 = columns_of(x, tri, e, b)
        eps = green_strain(f1, f2)
        inverse, least = _inverse(eps)
        s = times3(viscous, e, eps - row(base, e)) + mu[e] * (vec3(1.0, 1.0, 0.0) - least * inverse)
        s *= area[e]
        p1, p2 = f1 * s[0] + f2 * s[2], f1 * s[2] + f2 * s[1]
        for a in ti.static(range(3)):
            g = p1 * b[a, 0] + p2 * b[a, 1]
            for j in ti.static(range(3)):
                out[tri[e, a], j] = out[tri[e, a], j] + g[j]


@ti.kernel
def _hessian(
    x: F2, tri: I2, dm_inverse: F3, area: F1, mu: F1, viscous: F3, base: F2, exact: I1, foreseen: I1, move: F2,
    slots: I2, out: F1,
):  # fmt: skip
    """``foreseen``: take the stress that the ``move`` to x has by the strain's linear part: to first order, as a large
    move of a law that is not linear may foresee a film turned inside out."""
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        b = shape_of(dm_inverse, e)
        f1, f2 = columns_of(x, tri, e, b)
        eps = green_strain(f1, f2)
        inverse, least = _inverse(eps)
        i, j, k = inverse[0], inverse[1], inverse[2]
        cl = ti.Matrix.zero(ti.f64, 3, 3)
        for p, q in ti.static(ti.ndrange(3, 3)):
            cl[p, q] = viscous[e, p, q]
        scale = mu[e] * least
        cl[0, 0] += 4.0 * scale * i * i
        cl[1, 1] += 4.0 * scale * j * j
        cl[2, 2] += scale * (3.0 * k * k + i * j)
        cl[0, 1] += scale * (2.0 * i * j + 2.0 * k * k)
        cl[1, 0] += scale * (2.0 * i * j + 2.0 * k * k)
        cl[0, 2] += 4.0 * scale * i * k
        cl[2, 0] += 4.0 * scale * i * k
        cl[1, 2] += 4.0 * scale * j * k
        cl[2, 1] += 4.0 * scale * j * k
        s = times3(viscous, e, eps - row(base, e)) + mu[e] * (vec3(1.0, 1.0, 0.0) - least * inverse)
        if foreseen[0] == 1:
            d1, d2 = columns_of(move, tri, e, b)
            s -= cl @ vec3(0.5 * d1.dot(d1), 0.5 * d2.dot(d2), d1.dot(d2))
        if exact[0] == 0:
            s = tension_of(s)
        add_triangle(e, area, s, cl, f1, f2, b, slots, out)


class RubberMembrane(Membrane):
    """Term of one film; arguments as of :class:`Membrane`. Raises ``ConfigError`` for another Poisson's ratio than 0.5,
    and for a grain."""

    def __init__(self, name: str, nodes: np.ndarray, triangles: np.ndarray, axis: np.ndarray) -> None:
        super().__init__(name, nodes, triangles, axis)
        self._mu, self._viscous = np.zeros(len(self._size)), np.zeros_like(self._elastic)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        super().bind(buffers, slots)
        mesh = (buffers.x, self._triangles, self._dm_inverse, self._size, self._mu, self._viscous, self._before)
        self._energy = BoundKernel(_energy, *mesh, buffers.energy)
        self.add_gradient = BoundKernel(_gradient, *mesh, buffers.gradient)
        self._add_hessian = BoundKernel(
            _hessian, *mesh, self._exact, self._foreseen, self._move, slots, buffers.hessian
        )

    def configure(self, parameters: Mapping[str, float]) -> None:
        super().configure(parameters)
        if (self._nu != INCOMPRESSIBLE).any() or parameters.get("anisotropy_ratio", 1.0) != 1.0:
            raise ConfigError(
                f"{self.name}: the neo-Hookean law of films is isotropic and keeps the volume, and nu is "
                f"{self._nu[0]:g}, the ratio of moduli {parameters.get('anisotropy_ratio', 1.0):g}.",
                "Write 'nu: 0.5' and leave out what makes a sheet anisotropic, or leave out 'law: neo_hookean'.",
            )
        self._mu[:] = parameters["thickness_m"] * parameters["E_pa"] / 3.0
        self._viscous[:] = 0.0

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del internals
        if self.grading is not None and self.grading.go_to(step.time):
            self._weigh()
        if self._damped:
            self._viscous[:] = (self._damping / step.tau)[:, None, None] * self._elastic
            self._before[:] = step.base(self.strains_at)

    def along(self, vectors: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals) -> SheetAlong:
        found = super().along(vectors, kept, step, internals)
        return replace(found, law=self._stress(found.strain))

    def _inverses(self, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """C^-1 ``(m, 2, 2)`` and 1 / det C ``(m,)`` at Green strains ``(m, 3)``."""
        c = np.eye(2) + 2.0 * strain[:, [[0, 2], [2, 1]]] * [[1.0, 0.5], [0.5, 1.0]]
        return np.linalg.inv(c), 1.0 / np.linalg.det(c)

    def _stress(self, strain: np.ndarray) -> np.ndarray:
        inverse, least = self._inverses(strain)
        parts = np.stack([1.0 - least * inverse[:, 0, 0], 1.0 - least * inverse[:, 1, 1], -least * inverse[:, 0, 1]])
        return np.asarray(self._mu[:, None] * parts.T)

    def _tangent(self, strain: np.ndarray) -> np.ndarray:
        inverse, least = self._inverses(strain)
        i, j, k = inverse[:, 0, 0], inverse[:, 1, 1], inverse[:, 0, 1]
        rows = [
            [4.0 * i * i, 2.0 * (i * j + k * k), 4.0 * i * k],
            [2.0 * (i * j + k * k), 4.0 * j * j, 4.0 * j * k],
            [4.0 * i * k, 4.0 * j * k, 3.0 * k * k + i * j],
        ]
        return np.asarray((self._mu * least)[:, None, None] * np.moveaxis(np.array(rows), -1, 0))
