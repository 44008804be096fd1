"""Stiffness of affine bodies: what keeps a free rigid body rigid.

A body moves by x = A X + b; A and b follow from four control nodes, A = sum_k x_k (x) b_k with the constant
gradients b_k of their barycentric coordinates. With the rest volume V,

    E = V kappa |A^T A - I|^2 = 4 V kappa |G|^2,    G = (A^T A - I) / 2

(Lan, Kaufman, Li, Jiang & Yang, Affine body dynamics, ACM Trans. Graph. 41(4), 2022, eq. 7; the same for A A^T).
So the body is one St. Venant-Kirchhoff element with Poisson's ratio 0 and Young's modulus 8 kappa: a mean stress s
stretches it by s / (8 kappa). The second derivative is a material part, positive semidefinite, and a stress part,
of which the tension alone is taken unless ``exact`` (as in :mod:`sim_core.energies.membrane`).
"""

from collections.abc import Mapping

import numpy as np
import taichi as ti

from sim_core.energies.projection import symmetric_eigen
from sim_core.energies.term import Buffers, Memoryless
from sim_core.kernels import F1, F2, F3, I1, I2, BoundKernel, mat3, vec3

KAPPA_PA = 1e9
"""Stiffness of every affine body: a Young's modulus of 8 GPa, that of hard wood or filled plastic. Contact
pressures of 0.1 MPa strain it by 1e-5; gels and sheets, and the layer of contact itself, are far softer."""


@ti.func
def _gradient_of(x: ti.template(), nodes: ti.template(), slope: ti.template(), e: ti.i32):
    """sum_k x_k (x) b_k."""
    a = mat3(0.0)
    for k in ti.static(range(4)):
        for i in ti.static(range(3)):
            for j in ti.static(range(3)):
                a[i, j] += x[nodes[e, k], i] * slope[e, k, j]
    return a


@ti.func
def _strain(a: mat3):
    return 0.5 * (a.transpose() @ a - ti.Matrix.identity(ti.f64, 3))


@ti.kernel
def _energy(x: F2, nodes: I2, slope: F3, stiffness: F1, out: F1):
    ti.loop_config(serialize=True)
    for e in range(nodes.shape[0]):
        out[0] = out[0] + 0.5 * stiffness[e] * _strain(_gradient_of(x, nodes, slope, e)).norm_sqr()


@ti.kernel
def _gradient(x: F2, nodes: I2, slope: F3, stiffness: F1, out: F2):
    ti.loop_config(serialize=True)
    for e in range(nodes.shape[0]):
        a = _gradient_of(x, nodes, slope, e)
        p = stiffness[e] * a @ _strain(a)
        for k in ti.static(range(4)):
            g = p @ vec3(slope[e, k, 0], slope[e, k, 1], slope[e, k, 2])
            for i in ti.static(range(3)):
                out[nodes[e, k], i] = out[nodes[e, k], i] + g[i]


@ti.kernel
def _hessian(
    x: F2, nodes: I2, slope: F3, stiffness: F1, exact: I1, foreseen: I1, move: F2, slots: I2, out: F1
):  # fmt: skip
    """``foreseen``: take the stress that the ``move`` to x has by the strain's linear part, G - sym(dA^T dA) / 2."""
    ti.loop_config(serialize=True)
    for e in range(nodes.shape[0]):
        a = _gradient_of(x, nodes, slope, e)
        s = stiffness[e] * _strain(a)
        if foreseen[0] == 1:
            change = _gradient_of(move, nodes, slope, e)
            s -= 0.5 * stiffness[e] * change.transpose() @ change
        if exact[0] == 0:
            values, axes = symmetric_eigen(s)
            s = mat3(0.0)
            for k in ti.static(range(3)):
                axis = vec3(axes[0, k], axes[1, k], axes[2, k])
                s += ti.max(values[k], 0.0) * axis.outer_product(axis)
        left = a @ a.transpose()
        block = 10 * e
        for k in range(4):
            bk = vec3(slope[e, k, 0], slope[e, k, 1], slope[e, k, 2])
            for m in range(k, 4):
                bm = vec3(slope[e, m, 0], slope[e, m, 1], slope[e, m, 2])
                h = 0.5 * stiffness[e] * (bk.dot(bm) * left + (a @ bm).outer_product(a @ bk))
                geometric = bk.dot(s @ bm)
                for i in range(3):
                    for j in ti.static(range(3)):
                        if k != m or i <= j:
                            value = h[i, j]
                            if i == j:
                                value += geometric
                            at = slots[block, 3 * i + j]
                            out[at] = out[at] + value
                block += 1


class AffineShape(Memoryless):
    """Term of all affine bodies of a scene. ``control``: their control nodes, int32 ``(n, 4)``; ``rest``: positions
    of all nodes at rest [m]; ``volumes``: [m^3] ``(n,)``."""

    mirrored = True
    measured_at_rest = False

    def __init__(self, name: str, control: np.ndarray, rest: np.ndarray, volumes: np.ndarray) -> None:
        self.name = name
        self._nodes = np.ascontiguousarray(control, dtype=np.int32)
        self._slope = np.ascontiguousarray([barycentric(rest[c])[:, 1:] for c in control])
        corners = rest[self._nodes]
        self._arms = corners - corners.mean(axis=1, keepdims=True)
        self._stiffness = 8.0 * KAPPA_PA * np.asarray(volumes, dtype=float)
        self._exact, self._foreseen = np.zeros(1, dtype=np.int32), np.zeros(1, dtype=np.int32)

    def blocks(self) -> np.ndarray:
        i, j = np.triu_indices(4)
        return np.stack([self._nodes[:, i], self._nodes[:, j]], axis=-1).reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._x = buffers.x
        bodies = (buffers.x, self._nodes, self._slope, self._stiffness)
        self.add_energy = BoundKernel(_energy, *bodies, buffers.energy)
        self.add_gradient = BoundKernel(_gradient, *bodies, buffers.gradient)
        self._move = np.zeros_like(buffers.x)
        self._add_hessian = BoundKernel(
            _hessian, *bodies, self._exact, self._foreseen, self._move, slots, buffers.hessian
        )

    def add_hessian(self, exact: bool) -> None:
        self._exact[0] = exact
        self._add_hessian()

    def foresee(self, move: np.ndarray | None) -> None:
        """As :meth:`sim_core.energies.membrane.Membrane.foresee`: a body that turns is not stretched."""
        self._foreseen[0] = move is not None
        if move is not None:
            self._move[:] = move

    def straighten(self, start: np.ndarray, free: np.ndarray) -> None:
        """Give bodies, where they are now, the strain that a move of their nodes from ``start`` [m] ``(n, 3)`` has to
        first order: the strain of second order, of the square of the angle by which a body turns, would make any
        larger turn costly. ``free``: bool ``(n, 3)``; only bodies of which all control nodes are."""
        some = free[self._nodes].all(axis=(1, 2))
        nodes, slope = self._nodes[some], self._slope[some]
        before, now = (np.einsum("nki,nkj->nij", x[nodes], slope) for x in (start, self._x))
        half = np.einsum("nji,njk->nik", before, now - 0.5 * before)
        values, axes = np.linalg.eigh(half + half.transpose(0, 2, 1))  # A_0^T A_0 + 2 sym(A_0^T dA)
        stretch = np.einsum("nij,nj,nkj->nik", axes, np.sqrt(np.maximum(values, 0.0)), axes)
        left, _, right = np.linalg.svd(now)
        placed = np.einsum("nij,nkj->nki", left @ right @ stretch, self._arms[some])
        self._x[nodes] = self._x[nodes].mean(axis=1, keepdims=True) + placed

    def configure(self, parameters: Mapping[str, float]) -> None:
        del parameters


def barycentric(corners: np.ndarray) -> np.ndarray:
    """Coefficients ``(4, 4)`` of the barycentric coordinates of a tetrahedron ``(4, 3)``: times (1, X) they give those
    of the point X; the last three columns are the gradients b_k [1/m]."""
    return np.asarray(np.linalg.inv(np.column_stack([np.ones(4), corners]).T))


def coordinates(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric coordinates ``(n, 4)`` of ``points`` ``(n, 3)``."""
    points = np.atleast_2d(points)
    return np.asarray(np.column_stack([np.ones(len(points)), points]) @ barycentric(corners).T)
