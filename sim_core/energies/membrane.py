"""Membrane energy of a sheet: constant-strain triangles, plane stress, orthotropic if asked.

    E = sum_T  h A_T / 2  eps^T C eps,    eps = (eps_11, eps_22, 2 eps_12),  Green strain
    F = [x_1 - x_0, x_2 - x_0] Dm^-1  (3 x 2),    eps = (F^T F - I) / 2

Damping by the rate of strain (Kelvin-Voigt, beta [s]) adds h A_T beta/(2 tau) (eps - eps_b)^T C (eps - eps_b), eps_b
from :meth:`sim_core.energies.term.StepContext.base`: the stress beta C deps/dt, which no rigid motion has. Both
together are one quadratic form:

    h A_T / 2 [(eps - eps_0)^T (1 + k) C (eps - eps_0) + eps_b^T C eps_0],   eps_0 = k / (1 + k) eps_b,   k = beta / tau

C is the plane-stress stiffness of :mod:`sim_core.materials.elastic` in the material axes of each
triangle, with the triangle's own Poisson's ratio. Bonet & Wood, Nonlinear Continuum Mechanics for Finite
Element Analysis, ch. 5 and 9 (St. Venant-Kirchhoff). The Hessian splits into a material part (positive
semidefinite) and a stress part; outside of ``exact`` the compressive principal stress is clamped to zero
in the latter, which makes the sum positive semidefinite.
"""

from collections.abc import Mapping

import numpy as np
import taichi as ti

from sim_core.energies.element_values import ElementValues
from sim_core.energies.linearised import Blocks, Linearised, axes_of, placed
from sim_core.energies.sheet_vjp import SheetAlong
from sim_core.energies.term import Buffers, Internals, Memoryless, Quantity, StepContext
from sim_core.kernels import F1, F2, F3, I1, I2, BoundKernel, row, times3, vec3
from sim_core.materials.elastic import applied, plane_stress, plane_stress_by, plane_stress_by_nu, poisson_ratios

PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Upper blocks of the 3 x 3 node blocks, in storage order."""


@ti.func
def shape_of(dm_inverse: ti.template(), e: ti.i32):
    """Gradients of the three hat functions in the material axes (3 x 2)."""
    b = ti.Matrix.zero(ti.f64, 3, 2)
    for j in ti.static(range(2)):
        b[1, j] = dm_inverse[e, 0, j]
        b[2, j] = dm_inverse[e, 1, j]
        b[0, j] = -dm_inverse[e, 0, j] - dm_inverse[e, 1, j]
    return b


@ti.func
def columns_of(x: ti.template(), tri: ti.template(), e: ti.i32, b: ti.template()):
    """The two columns of the deformation gradient."""
    f1 = vec3(0.0, 0.0, 0.0)
    f2 = vec3(0.0, 0.0, 0.0)
    for a in ti.static(range(3)):
        p = vec3(x[tri[e, a], 0], x[tri[e, a], 1], x[tri[e, a], 2])
        f1 += p * b[a, 0]
        f2 += p * b[a, 1]
    return f1, f2


@ti.func
def green_strain(f1, f2):
    return vec3(0.5 * (f1.dot(f1) - 1.0), 0.5 * (f2.dot(f2) - 1.0), f1.dot(f2))


@ti.kernel
def _strain_of_all(x: F2, tri: I2, dm_inverse: F3, out: F2):
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        f1, f2 = columns_of(x, tri, e, shape_of(dm_inverse, e))
        eps = green_strain(f1, f2)
        for i in ti.static(range(3)):
            out[e, i] = eps[i]


@ti.kernel
def _energy(x: F2, tri: I2, dm_inverse: F3, area: F1, c: F3, before: F2, out: F1):
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        b = shape_of(dm_inverse, e)
        f1, f2 = columns_of(x, tri, e, b)
        eps = green_strain(f1, f2) - row(before, e)
        out[0] = out[0] + 0.5 * area[e] * eps.dot(times3(c, e, eps))


@ti.func
def _stress(
    x: ti.template(), tri: ti.template(), e: ti.i32, b: ti.template(), area: ti.template(), c: ti.template(),
    before: ti.template(),
):  # fmt: skip
    """The two columns of the first Piola-Kirchhoff stress, times the area."""
    f1, f2 = columns_of(x, tri, e, b)
    s = times3(c, e, green_strain(f1, f2) - row(before, e)) * area[e]
    return f1 * s[0] + f2 * s[2], f1 * s[2] + f2 * s[1]


@ti.kernel
def _gradient(x: F2, tri: I2, dm_inverse: F3, area: F1, c: F3, before: F2, out: F2):
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        b = shape_of(dm_inverse, e)
        p1, p2 = _stress(x, tri, e, b, area, c, before)
        for a in ti.static(range(3)):
            g = p1 * b[a, 0] + p2 * b[a, 1]
            for j in ti.static(range(3)):
                out[tri[e, a], j] = out[tri[e, a], j] + g[j]


@ti.kernel
def _straining_of_all(x: F2, tri: I2, dm_inverse: F3, vectors: F2, strains: F2, straining: F2):
    """Green strains, and their derivatives along nodal vectors."""
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        b = shape_of(dm_inverse, e)
        f1, f2 = columns_of(x, tri, e, b)
        v1, v2 = columns_of(vectors, tri, e, b)
        eps, slope = green_strain(f1, f2), vec3(f1.dot(v1), f2.dot(v2), f1.dot(v2) + f2.dot(v1))
        for i in ti.static(range(3)):
            strains[e, i] = eps[i]
            straining[e, i] = slope[i]


@ti.func
def tension_of(s):
    """A stress without its compressive principal part."""
    mean = 0.5 * (s[0] + s[1])
    half = 0.5 * (s[0] - s[1])
    radius = ti.sqrt(half * half + s[2] * s[2])
    high = ti.max(mean + radius, 0.0)
    low = ti.max(mean - radius, 0.0)
    found = vec3(high, high, 0.0)
    if radius > 0.0:
        centre = 0.5 * (high + low)
        scale = 0.5 * (high - low) / radius
        found = vec3(centre + scale * half, centre - scale * half, scale * s[2])
    return found


@ti.func
def add_triangle(e: ti.i32, area: ti.template(), s, cl, f1, f2, b, slots: ti.template(), out: ti.template()):
    """Add the Hessian of a triangle with the stress s and the stiffness cl by Green strain, times its area."""
    # d eps / d x_a = (f1 b1, f2 b2, f1 b2 + f2 b1), so the material part is a sum of f_p f_q^T.
    block = 6 * e
    for a in range(3):
        left1 = area[e] * (cl.transpose() @ vec3(b[a, 0], 0.0, b[a, 1]))
        left2 = area[e] * (cl.transpose() @ vec3(0.0, b[a, 1], b[a, 0]))
        for d in range(a, 3):
            geometric = area[e] * (
                s[0] * b[a, 0] * b[d, 0] + s[1] * b[a, 1] * b[d, 1] + s[2] * (b[a, 0] * b[d, 1] + b[a, 1] * b[d, 0])
            )
            right1 = vec3(b[d, 0], 0.0, b[d, 1])
            right2 = vec3(0.0, b[d, 1], b[d, 0])
            g1 = left1.dot(right1) * f1 + left1.dot(right2) * f2
            g2 = left2.dot(right1) * f1 + left2.dot(right2) * f2
            for i in range(3):
                for j in ti.static(range(3)):
                    if a != d or i <= j:
                        value = f1[i] * g1[j] + f2[i] * g2[j]
                        if i == j:
                            value += geometric
                        at = slots[block, 3 * i + j]
                        out[at] = out[at] + value
            block += 1


@ti.kernel
def _hessian(
    x: F2, tri: I2, dm_inverse: F3, area: F1, c: F3, before: F2, exact: I1, foreseen: I1, move: F2, slots: I2, out: F1
):
    """``foreseen``: take the stress that the ``move`` to x has by the strain's linear part, eps - sym(dF^T dF) / 2."""
    ti.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        b = shape_of(dm_inverse, e)
        f1, f2 = columns_of(x, tri, e, b)
        eps = green_strain(f1, f2) - row(before, e)
        if foreseen[0] == 1:
            d1, d2 = columns_of(move, tri, e, b)
            eps -= vec3(0.5 * d1.dot(d1), 0.5 * d2.dot(d2), d1.dot(d2))
        s = times3(c, e, eps)
        if exact[0] == 0:
            s = tension_of(s)
        cl = ti.Matrix.zero(ti.f64, 3, 3)
        for i, j in ti.static(ti.ndrange(3, 3)):
            cl[i, j] = c[e, i, j]
        add_triangle(e, area, s, cl, f1, f2, b, slots, out)


class Membrane(ElementValues, Memoryless):
    """Term of one sheet. ``nodes``: rest positions of all nodes [m] ``(n, 3)``; ``triangles``: int32
    ``(m, 3)`` with indices into them; ``axis``: material direction 1, a unit 3-vector (projected on
    each triangle)."""

    mirrored = True
    measured_at_rest = True
    quantities: tuple[Quantity, ...] = (
        Quantity("E_pa", "Pa", power=1, closed=False),
        Quantity("thickness_m", "m", power=1, closed=False),
        Quantity("nu", "-"),
        Quantity("stiffness_damping_s", "s"),
    )

    def __init__(self, name: str, nodes: np.ndarray, triangles: np.ndarray, axis: np.ndarray) -> None:
        self.name = name
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        frames = material_frames(nodes, triangles, axis)
        edges = np.stack(
            [nodes[triangles[:, k]] - nodes[triangles[:, 0]] for k in (1, 2)],
            axis=-1,
        )
        dm = np.einsum("mij,mik->mjk", frames, edges)
        self._dm_inverse: np.ndarray = np.ascontiguousarray(np.linalg.inv(dm))
        super().__init__(0.5 * np.linalg.det(dm))
        count = len(triangles)
        self._elastic, self._c = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
        self._before, self._strains = np.zeros((count, 3)), np.zeros((count, 3))
        self._slope: np.ndarray | None = None
        self._damped, self._constant = False, 0.0
        self._exact, self._foreseen = np.zeros(1, dtype=np.int32), np.zeros(1, dtype=np.int32)

    def blocks(self) -> np.ndarray:
        pairs = np.asarray(PAIRS)
        return self._triangles[:, pairs].reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._x, self._elsewhere = buffers.x, np.zeros_like(buffers.x)
        self._strains_there = BoundKernel(
            _strain_of_all, self._elsewhere, self._triangles, self._dm_inverse, self._strains
        )
        mesh = (buffers.x, self._triangles, self._dm_inverse, self._size, self._c, self._before)
        self._energy, self._total = BoundKernel(_energy, *mesh, buffers.energy), buffers.energy
        self.add_gradient = BoundKernel(_gradient, *mesh, buffers.gradient)
        self._vectors, self._straining = np.zeros_like(buffers.x), np.zeros_like(self._strains)
        self._strains_along = BoundKernel(_straining_of_all, *mesh[:3], self._vectors, self._strains, self._straining)
        self._move = np.zeros_like(buffers.x)
        self._add_hessian = BoundKernel(
            _hessian, *mesh, self._exact, self._foreseen, self._move, slots, buffers.hessian
        )

    def add_hessian(self, exact: bool) -> None:
        self._exact[0] = exact
        self._add_hessian()

    def foresee(self, move: np.ndarray | None) -> None:
        """Until told otherwise, let the Hessian's stress part be that which ``move`` [m] ``(n, 3)``, at whose end it
        is taken, has to first order (None: that of the positions)."""
        self._foreseen[0] = move is not None
        if move is not None:
            self._move[:] = move

    def along(self, vectors: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals) -> SheetAlong:
        """What forces along nodal ``vectors`` ``(n, 3)`` know of the sheet's numbers at the end of a step."""
        del kept, internals
        self._vectors[:] = vectors
        self._strains_along()
        return SheetAlong(
            area=self._size,
            stiffness=self._elastic,
            slope=self._stiffness_by_nu,
            strain=self._strains.copy(),
            straining=self._straining.copy(),
            base=lambda: step.base(self.strains_at),
            damping=self._damping,
            tau=step.tau,
        )

    def by_rest(self, along: np.ndarray, step: StepContext) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the work of the forces along nodal vectors ``(n, 3)`` by Dm^-1 ``(m, 2, 2)`` and by the areas
        ``(m,)`` of the triangles: with V = dv Dm^-1 as F is dx Dm^-1, it is A S : F^T V, and S is that of the law at
        strains (F^T F - 1) / 2 at the end of the step, and of damping linear in those at its end, its start and
        before."""
        rate, (now, before) = self._damping / step.tau, step.weights
        times = [(self._x, rate), (step.x_start, -now * rate)]
        if step.x_past is not None:
            times.append((step.x_past, -before * rate))
        (f, sides), (v, moved) = self.slopes(self._x), self.slopes(along)
        sheared = f.transpose(0, 2, 1) @ v
        strain, virtual = np.zeros((len(sheared), 3)), as_strain(sheared)
        end = as_strain(0.5 * (f.transpose(0, 2, 1) @ f - np.eye(2)))
        out = sides.transpose(0, 2, 1) @ f @ as_stress(applied(self._tangent(end), virtual))
        held = as_stress(applied(self._elastic, virtual))
        for x, weight in times:
            if weight.any():
                there, across = self.slopes(x)
                metric = there.transpose(0, 2, 1) @ there
                strain += weight[:, None] * as_strain(0.5 * (metric - np.eye(2)))
                out += weight[:, None, None] * across.transpose(0, 2, 1) @ there @ held
        stress = as_stress(self._stress(end) + applied(self._elastic, strain))
        out += sides.transpose(0, 2, 1) @ v @ stress + moved.transpose(0, 2, 1) @ f @ stress
        work = np.einsum("mij,mij->m", stress, sheared)
        return self._size[:, None, None] * out, self._size / self._whole_size * work

    def _stress(self, strain: np.ndarray) -> np.ndarray:
        """Stress of the law without damping at Green strains [N/m], ``(m, 3)`` both."""
        return applied(self._elastic, strain)

    def _tangent(self, strain: np.ndarray) -> np.ndarray:
        """Its derivative ``(m, 3, 3)``."""
        del strain
        return self._elastic

    def slopes(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of nodal vectors by the material coordinates, and differences along two sides, ``(m, 3, 2)``."""
        sides = (x[self._triangles[:, 1:]] - x[self._triangles[:, :1]]).transpose(0, 2, 1)
        return sides @ self._dm_inverse, sides

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._given, self._slope = dict(parameters), None
        self._configure_grading(parameters)
        self._nu[:] = poisson_ratios(self.name, parameters["nu"], self._beside, thin=True)
        self._elastic[:] = parameters["thickness_m"] * plane_stress(parameters, self._nu)
        self._damping[:] = parameters.get("stiffness_damping_s", 0.0) + self._more_damping
        self._damped = bool(self._damping.any())
        self._c[:] = self._elastic
        self._before[:], self._constant = 0.0, 0.0

    @property
    def triangles(self) -> np.ndarray:
        """Nodes of the triangles among all, int32 ``(m, 3)``."""
        return self._triangles

    @property
    def areas(self) -> np.ndarray:
        """Areas of the triangles [m^2] ``(m,)``, times the factors of their stiffness; changed in place."""
        return self._size

    @property
    def whole_areas(self) -> np.ndarray:
        """Areas of the triangles [m^2] ``(m,)``."""
        return self._whole_size

    @property
    def stiffness(self) -> np.ndarray:
        """h C of the triangles [N/m] ``(m, 3, 3)``, without damping; changed in place."""
        return self._elastic

    def stiffness_by(self, quantity: str) -> np.ndarray:
        """Derivative of :attr:`stiffness` by one number of the term ``(m, 3, 3)``."""
        thickness = self._given["thickness_m"]
        if quantity == "thickness_m":
            return np.asarray(self._elastic / thickness)
        return np.asarray(thickness * plane_stress_by(self._given, quantity, self._nu))

    def _stiffness_by_nu(self) -> np.ndarray:
        """Derivative of h C by Poisson's ratio of each triangle, ``(m, 3, 3)``."""
        if self._slope is None:
            self._slope = self._given["thickness_m"] * plane_stress_by_nu(self._given, self._nu)
        return self._slope

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del internals
        self._grade_at(step.time)
        if not self._damped:
            return
        rate = self._damping / step.tau
        self._c[:] = (1.0 + rate)[:, None, None] * self._elastic
        base = step.base(self.strains_at)
        self._before[:] = (rate / (1.0 + rate))[:, None] * base
        self._constant = 0.5 * float(np.einsum("t,ti,tij,tj->", self._size, base, self._elastic, self._before))

    def add_energy(self) -> None:
        self._energy()
        self._total[0] += self._constant

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised | None:
        """Derivatives by the positions that rates of strain are measured from."""
        del internals, after
        if not self._damped:
            return None
        pull = (-self._damping / step.tau * self._size)[:, None, None] * self.by_positions(self._x).transpose(0, 2, 1)
        pull, axes, shape = pull @ self._elastic, axes_of(self._triangles), (self._x.size,) * 2

        def by(x: np.ndarray, weight: float) -> Blocks:
            return placed((weight * pull @ self.by_positions(x), axes, axes), shape=shape)

        now, before = step.weights
        past = None if step.x_past is None else by(step.x_past, before)
        return Linearised(force_start=by(step.x_start, now), force_past=past)

    def strains_at(self, x: np.ndarray) -> np.ndarray:
        """Green strains at positions ``x`` [m], ``(m, 3)``."""
        self._elsewhere[:] = x
        self._strains_there()
        return np.array(self._strains)

    def hats(self) -> np.ndarray:
        """Gradients of the hat functions of the corners in the material axes [1/m] ``(m, 3, 2)``."""
        return np.asarray(np.concatenate([-self._dm_inverse.sum(axis=1, keepdims=True), self._dm_inverse], axis=1))

    def by_positions(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of the strains of the triangles by their corners at ``x``, ``(m, 3, 9)``."""
        shape = self.hats()
        f = np.einsum("taj,tai->tij", shape, x[self._triangles])
        first = np.einsum("ti,ta->tai", f[:, :, 0], shape[:, :, 0])
        second = np.einsum("ti,ta->tai", f[:, :, 1], shape[:, :, 1])
        sheared = np.einsum("ti,ta->tai", f[:, :, 0], shape[:, :, 1]) + np.einsum(
            "ti,ta->tai", f[:, :, 1], shape[:, :, 0]
        )
        return np.asarray(np.stack([first, second, sheared], axis=1).reshape(len(f), 3, 9))


def as_strain(tensor: np.ndarray) -> np.ndarray:
    """Components 11, 22, twice 12 of the symmetric part of tensors ``(m, 2, 2)``."""
    return np.stack([tensor[:, 0, 0], tensor[:, 1, 1], tensor[:, 0, 1] + tensor[:, 1, 0]], axis=-1)


def as_stress(components: np.ndarray) -> np.ndarray:
    """Symmetric tensors ``(m, 2, 2)`` from components 11, 22, 12."""
    return np.asarray(components[:, [[0, 2], [2, 1]]])


def material_frames(nodes: np.ndarray, triangles: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Orthonormal in-plane frames: columns material direction 1 and 2, shape ``(m, 3, 2)``. ``axis``: projected on the
    triangles, ``(3,)`` or one a triangle ``(m, 3)``."""
    p, q, r = (nodes[triangles[:, k]] for k in range(3))
    normal = np.cross(q - p, r - p)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    up = normal @ axis if axis.ndim == 1 else np.einsum("mi,mi->m", normal, axis)
    first = axis - normal * up[:, None]
    steep = np.linalg.norm(first, axis=1) < 1e-6
    first[steep] = (q - p)[steep]
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normal, first)], axis=-1)
