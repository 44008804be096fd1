"""Contact and friction between sampled deformable surfaces and rigid shapes.

The rigid body is a node (its origin) plus a rotation that is prescribed during a step. With the
sample position p = sum_i w_i x_i, body origin c, rotation R and the shape's signed distance phi,

    g = phi(R^T (p - c)) - offset,
    E = sum_s A_s [ psi(g_s) ] + D(u_s),   u = R e_n + T (p - c - R y_n),   y_n = R_n^T (p_n - c_n)

where y_n is the body point under the sample at the start of the step, T the projector on the tangent
plane there and e_n the elastic slip carried over from the last step, in the body frame. Laws:
:mod:`sim_core.contact.pressure_and_friction`. What lies between the samples (a box's corner under the middle of a
triangle) is left to :class:`SurfaceContact` and :class:`EdgeContact` with the shape's core
(:mod:`sim_core.contact.inner_primitives`).
"""

from collections.abc import Mapping

import numpy as np
import taichi as ti
from scipy.spatial.transform import Rotation

from sim_core.contact.added_laws import AddedLaws
from sim_core.contact.continuous_collision import point_shape_way
from sim_core.contact.measures import Measures
from sim_core.contact.pressure_and_friction import (
    LAW_OF,
    OFFSET,
    RANGE,
    REACH,
    STIFFNESS,
    coefficients,
    friction_force,
    friction_potential,
    friction_stiffness,
    potential,
    pressure,
    set_guard,
    set_law,
    slide,
    slope,
    tangent_projector,
)
from sim_core.contact.rigid_derivatives import RigidStep, ShapeSurface, rigid_derivatives
from sim_core.contact.samples import Samples
from sim_core.contact.shapes import signed_distance
from sim_core.energies.linearised import Linearised
from sim_core.energies.term import Buffers, Internals, StepContext
from sim_core.kernels import F1, F2, I1, I2, BoundKernel, mat3, row, vec3


@ti.func
def _rotation(r: ti.template()):
    return mat3(r[0, 0], r[0, 1], r[0, 2], r[1, 0], r[1, 1], r[1, 2], r[2, 0], r[2, 1], r[2, 2])


@ti.func
def _position(x: ti.template(), nodes: ti.template(), weights: ti.template(), s: ti.i32):
    p = vec3(0.0, 0.0, 0.0)
    for a in range(nodes.shape[1] - 1):
        i = nodes[s, a]
        p += weights[s, a] * vec3(x[i, 0], x[i, 1], x[i, 2])
    return p


@ti.func
def _origin(x: ti.template(), nodes: ti.template(), s: ti.i32):
    b = nodes[s, nodes.shape[1] - 1]
    return vec3(x[b, 0], x[b, 1], x[b, 2])


@ti.func
def _slip(offset_vector, rotation, s: ti.i32, y_start: ti.template(), anchor: ti.template(), normal: ti.template()):
    """Elastic slip [m] and tangent projector."""
    t = tangent_projector(row(normal, s))
    u = rotation @ row(anchor, s) + t @ (offset_vector - rotation @ row(y_start, s))
    return t @ u, t


@ti.kernel
def _start(x: F2, rotation: F2, nodes: I2, weights: F2, shape: F1, new_rotation: F2, y_start: F2, normal: F2):
    """Body point under each sample and lagged normal, from the start of the step."""
    ti.loop_config(serialize=True)
    for s in range(nodes.shape[0]):
        r = _rotation(rotation)
        y = r.transpose() @ (_position(x, nodes, weights, s) - _origin(x, nodes, s))
        _distance, n, _second = signed_distance(y, shape)
        m = _rotation(new_rotation) @ n
        for j in ti.static(range(3)):
            y_start[s, j] = y[j]
            normal[s, j] = m[j]


@ti.kernel
def _slips(x: F2, rotation: F2, nodes: I2, weights: F2, y_start: F2, anchor: F2, normal: F2, slip: F2):
    """Elastic slip of each sample if it does not slide [m]."""
    ti.loop_config(serialize=True)
    for s in range(nodes.shape[0]):
        d = _position(x, nodes, weights, s) - _origin(x, nodes, s)
        u, _t = _slip(d, _rotation(rotation), s, y_start, anchor, normal)
        for j in ti.static(range(3)):
            slip[s, j] = u[j]


@ti.kernel
def _energy(
    x: F2,
    rotation: F2,
    nodes: I2,
    weights: F2,
    areas: F1,
    shape: F1,
    c: F1,
    limit: F1,
    y_start: F2,
    anchor: F2,
    normal: F2,
    added: F2,
    out: F1,
):
    ti.loop_config(serialize=True)
    for s in range(nodes.shape[0]):
        r = _rotation(rotation)
        d = _position(x, nodes, weights, s) - _origin(x, nodes, s)
        distance, _n, _second = signed_distance(r.transpose() @ d, shape)
        e = areas[s] * (potential(distance - c[OFFSET], c) + added[s, 0])
        if limit[s] > 0.0:
            u, _t = _slip(d, r, s, y_start, anchor, normal)
            e += friction_potential(u, limit[s], c[STIFFNESS] * areas[s])
        out[0] = out[0] + e


@ti.kernel
def _forces(
    x: F2,
    rotation: F2,
    nodes: I2,
    weights: F2,
    areas: F1,
    shape: F1,
    c: F1,
    limit: F1,
    y_start: F2,
    anchor: F2,
    normal: F2,
    added: F2,
    force: F2,
    load: F1,
    gap: F1,
):
    """Force on each sample [N], the part of it that keeps the surfaces apart [N], and the gap [m]."""
    ti.loop_config(serialize=True)
    for s in range(nodes.shape[0]):
        r = _rotation(rotation)
        d = _position(x, nodes, weights, s) - _origin(x, nodes, s)
        distance, n, _second = signed_distance(r.transpose() @ d, shape)
        gap[s] = distance - c[OFFSET]
        load[s] = areas[s] * pressure(gap[s], c)
        f = (load[s] + areas[s] * added[s, 1]) * (r @ n)
        if limit[s] > 0.0:
            u, _t = _slip(d, r, s, y_start, anchor, normal)
            f -= friction_force(u, limit[s], c[STIFFNESS] * areas[s])
        for j in ti.static(range(3)):
            force[s, j] = f[j]


@ti.kernel
def _gradient(nodes: I2, weights: F2, force: F2, out: F2):
    ti.loop_config(serialize=True)
    for s in range(nodes.shape[0]):
        for a in range(nodes.shape[1]):
            i = nodes[s, a]
            for j in ti.static(range(3)):
                out[i, j] = out[i, j] - weights[s, a] * force[s, j]


@ti.kernel
def _hessian(
    x: F2,
    rotation: F2,
    nodes: I2,
    weights: F2,
    areas: F1,
    shape: F1,
    c: F1,
    limit: F1,
    y_start: F2,
    anchor: F2,
    normal: F2,
    added: F2,
    exact: I1,
    slots: I2,
    out: F1,
):
    ti.loop_config(serialize=True)
    for s in range(nodes.shape[0]):
        r = _rotation(rotation)
        d = _position(x, nodes, weights, s) - _origin(x, nodes, s)
        distance, n, second = signed_distance(r.transpose() @ d, shape)
        g = distance - c[OFFSET]
        touching = g < c[REACH]
        if touching or limit[s] > 0.0:
            m = r @ n
            steep = slope(g, c) + added[s, 2]
            if exact[0] == 0:
                steep = ti.max(steep, 0.0)
            k = areas[s] * steep * m.outer_product(m)
            if exact[0] == 1:
                k -= areas[s] * (pressure(g, c) + added[s, 1]) * (r @ second @ r.transpose())
            if limit[s] > 0.0:
                u, t = _slip(d, r, s, y_start, anchor, normal)
                stiff = friction_stiffness(u, limit[s], c[STIFFNESS] * areas[s], t)
                k += t @ stiff @ t
            count = nodes.shape[1]
            n_block = 0
            for a in range(count):
                for b in range(a, count):
                    w = weights[s, a] * weights[s, b]
                    at_block = s * (count * (count + 1) // 2) + n_block
                    if w != 0.0:
                        for i in range(3):
                            for j in range(3):
                                if a != b or i <= j:
                                    at = slots[at_block, 3 * i + j]
                                    out[at] = out[at] + w * k[i, j]
                    n_block += 1


@ti.kernel
def _gaps(x: F2, rotation: F2, nodes: I2, weights: F2, shape: F1, c: F1, gap: F1):
    """Gap of each sample [m]."""
    ti.loop_config(serialize=True)
    for s in range(nodes.shape[0]):
        d = _position(x, nodes, weights, s) - _origin(x, nodes, s)
        distance, _n, _second = signed_distance(_rotation(rotation).transpose() @ d, shape)
        gap[s] = distance - c[OFFSET]


@ti.kernel
def _free_way(y: F2, dy: F2, shape: F1, c: F1, keep: F1, way: F1):
    """Shorten ``way`` to the share of ``dy`` from ``y`` on (in the body frame) that is free for all points."""
    ti.loop_config(serialize=True)
    for s in range(y.shape[0]):
        way[0] = ti.min(way[0], point_shape_way(row(y, s), row(dy, s), shape, c[OFFSET], keep[0]))


class RigidContact:
    """Term for one pair (deformable surface, rigid shape).

    ``samples``: of the surface. ``body_node``: node index of the body's origin. ``shape``: array of
    :mod:`sim_core.contact.shapes`. ``rotation``: ``(3, 3)`` body to world, written by the driver of
    the body before each step and shared with it.
    """

    mirrored = True
    measured_at_rest = True

    def __init__(self, name: str, samples: Samples, body_node: int, shape: np.ndarray, rotation: np.ndarray) -> None:
        self.name = name
        self.body_node = body_node
        self.measures: list[Measures] = [] if samples.shared is None else [samples.shared]
        """What is measured at rest: areas of the samples."""
        self.samples = samples
        count = len(samples.areas)
        body = np.full((count, 1), body_node, dtype=np.int32)
        self._nodes = np.ascontiguousarray(np.hstack([samples.nodes, body]), dtype=np.int32)
        self._weights = np.ascontiguousarray(np.hstack([samples.weights, -np.ones((count, 1))]))
        self._areas = np.ascontiguousarray(samples.areas)
        self._shape = np.ascontiguousarray(shape, dtype=float)
        self._target = rotation
        self._rotation = rotation.copy()
        self._rotation_start = rotation.copy()
        self._c = coefficients(samples.offset)
        self.laws = AddedLaws()
        self._added = np.zeros((count, 3))
        self._keep, self._way = np.zeros(1), np.ones(1)
        self._y, self._dy = np.zeros((count, 3)), np.zeros((count, 3))
        self._limit, self._load, self._gap = np.zeros(count), np.zeros(count), np.zeros(count)
        self._y_start, self._anchor = np.zeros((count, 3)), np.zeros((count, 3))
        self._normal, self._force = np.zeros((count, 3)), np.zeros((count, 3))
        self._slip = np.zeros((count, 3))
        self._exact = np.zeros(1, dtype=np.int32)

    def blocks(self) -> np.ndarray:
        a, b = np.triu_indices(self._nodes.shape[1])
        return np.stack([self._nodes[:, a], self._nodes[:, b]], axis=-1).reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._x = buffers.x
        self._x_start = np.zeros_like(buffers.x)
        self._surface = ShapeSurface(self._shape, len(self._areas))
        surface = (self._rotation, self._nodes, self._weights)
        laws = (self._areas, self._shape, self._c, self._limit, self._y_start, self._anchor, self._normal, self._added)
        self._start = BoundKernel(
            _start, self._x_start, self._rotation_start, self._nodes, self._weights, self._shape,
            self._rotation, self._y_start, self._normal,
        )  # fmt: skip
        self._energy = BoundKernel(_energy, buffers.x, *surface, *laws, buffers.energy)
        self._exert = BoundKernel(_forces, buffers.x, *surface, *laws, self._force, self._load, self._gap)
        self._slips = BoundKernel(_slips, buffers.x, *surface, self._y_start, self._anchor, self._normal, self._slip)
        measured = (self._shape, self._c, self._gap)
        self._gaps = BoundKernel(_gaps, buffers.x, *surface, *measured)
        self._gradient = BoundKernel(_gradient, self._nodes, self._weights, self._force, buffers.gradient)
        self._hessian = BoundKernel(_hessian, buffers.x, *surface, *laws, self._exact, slots, buffers.hessian)
        self._free = BoundKernel(_free_way, self._y, self._dy, self._shape, self._c, self._keep, self._way)

    @property
    def rotation_target(self) -> np.ndarray:
        """Rotation of the body at the end of the step, as its driver wrote it ``(3, 3)``."""
        return np.array(self._target)

    @property
    def law(self) -> np.ndarray:
        """Numbers of the law, as :mod:`sim_core.contact.pressure_and_friction` lays them out ``(8,)``."""
        return self._c

    def law_by(self, quantity: str) -> dict[int, float]:
        """Derivatives of the numbers of :attr:`law` by one that it is given by name, by their places."""
        return {LAW_OF[quantity]: 1.0}

    @property
    def shape(self) -> np.ndarray:
        """Shape of the body (:mod:`sim_core.contact.shapes`) ``(5,)``."""
        return self._shape

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
        self.laws.configure(parameters)
        self._c[REACH] = max(self._c[RANGE], self.laws.reach())

    def guard(self, on: bool) -> None:
        """The law itself, or one that bears overlap."""
        set_guard(self._c, on)

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        self._x_start[:] = step.x_start
        self._rotation[:] = self._target
        self._rotation_start[:] = internals["rotation"]
        self._anchor[:] = internals["anchor"]
        self.laws.bonded = internals.get("bonded")
        self._start()
        self._limit[:] = self.laws.bound(self._c, internals["load"], self._areas, internals["slip_speed"]).value

    @property
    def rotation(self) -> np.ndarray:
        """Rotation of the body now, ``(3, 3)``."""
        return np.array(self._rotation)

    @property
    def turns(self) -> bool:
        """Whether the body turns in this step."""
        return not np.array_equal(self._rotation_start, self._target)

    def turn(self, share: float) -> None:
        """Turn the body to where it is after ``share`` of the step."""
        self._rotation[:] = self._turned(share)

    def _turned(self, share: float) -> np.ndarray:
        if share >= 1.0 or not self.turns:
            return self._target
        start = Rotation.from_matrix(self._rotation_start)
        whole = (start.inv() * Rotation.from_matrix(self._target)).as_rotvec()
        return np.asarray((start * Rotation.from_rotvec(share * whole)).as_matrix())

    def free_way(self, start: np.ndarray, move: np.ndarray, keep: float, turn: tuple[float, float]) -> float:
        """Share of ``move`` from ``start`` on (both [m] ``(n, 3)``) on which gaps keep the share ``keep``, while
        the body turns from one share of the step to another. Paths are straight in the body's frame."""
        nodes, weights = self._nodes, self._weights
        since, till = (self._turned(share) for share in turn)
        self._y[:] = np.einsum("nk,nkj->nj", weights, start[nodes]) @ since
        self._dy[:] = np.einsum("nk,nkj->nj", weights, (start + move)[nodes]) @ till - self._y
        self._keep[0], self._way[0] = keep, 1.0
        self._free()
        return float(self._way[0])

    def _add_laws(self) -> None:
        """Bring what effects add up to date with the positions."""
        if self.laws.presses:
            self._gaps()
            self.laws.write_normal(self._gap, self._added)

    def _forces(self) -> None:
        self._add_laws()
        self._exert()

    def add_energy(self) -> None:
        self._add_laws()
        self._energy()

    def add_gradient(self) -> None:
        self._forces()
        self._gradient()

    def add_hessian(self, exact: bool) -> None:
        self._add_laws()
        self._exact[0] = exact
        self._hessian()

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        """Carry elastic slip, load and slip speed to the next step; all zero out of contact."""
        self._forces()
        self._slips()
        rotation = self._rotation
        stiffness = self._c[STIFFNESS] * self._areas
        anchor, speed = slide(self._slip, self._normal, self._limit, stiffness, step.dt)
        touching = self._load > 0.0
        found = {
            "rotation": rotation.copy(),
            "anchor": np.where(touching[:, None], anchor @ rotation, 0.0),
            "load": self._load.copy(),
            "slip_speed": np.where(touching, speed, 0.0),
        }
        return {**found, "bonded": self.laws.bonded_after(self._gap, touching)} if self.laws.bonds else found

    def carried(self, internals: Internals, move: np.ndarray) -> Internals:
        """Internal variables with the springs of friction stretched by a move of the start."""
        past = np.einsum("nk,nkj->nj", self._weights, move[self._nodes]) @ internals["rotation"]
        touching = internals["load"] > 0.0
        return {**internals, "anchor": internals["anchor"] + np.where(touching[:, None], past, 0.0)}

    def initial_internals(self) -> Internals:
        count = len(self._areas)
        found = {
            "rotation": self._target.copy(),
            "anchor": np.zeros((count, 3)),
            "load": np.zeros(count),
            "slip_speed": np.zeros(count),
        }
        return {**found, "bonded": np.zeros(count)} if self.laws.bonds else found

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised:
        """Derivatives by the start of the step, the memory and the turn of the body."""
        del after
        before, now = (np.einsum("nk,nkj->nj", self._weights, x[self._nodes]) for x in (step.x_start, self._x))
        self._slips()
        here = RigidStep(
            *(self._nodes, self._weights, self._areas, before, now, self._slip),
            *(internals["rotation"], self._rotation, self._limit, step.dt),
        )
        return rigid_derivatives(here, self._c, self.laws, self._surface, internals, len(self._x))

    def sample_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Where the samples are [m] and the force on each of them [N], both ``(n, 3)``, at ``buffers.x``."""
        self._forces()
        nodes, weights = self._nodes[:, :-1], self._weights[:, :-1]
        return np.einsum("nk,nkj->nj", weights, self._x[nodes]), self._force.copy()

    def moment(self) -> np.ndarray:
        """Moment [N m] ``(3,)`` of the forces on the samples about the body's node."""
        at, push = self.sample_forces()
        a = (at - self._x[self.body_node]).T @ push
        return np.array([a[1, 2] - a[2, 1], a[2, 0] - a[0, 2], a[0, 1] - a[1, 0]])

    def contacts(self) -> tuple[int, float]:
        """Number of loaded samples and smallest gap [m] at the last gradient."""
        return int(np.count_nonzero(self._load)), float(self._gap.min(initial=np.inf))
