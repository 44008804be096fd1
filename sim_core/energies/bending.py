"""Bending energy of a sheet from the hinge angles of its mesh, plate rigidity included.

    E = sum_T A_T/2 kappa_T^T D kappa_T,    kappa_T = B_T (theta - theta_0) - kappa^p_T,    D = h^3/12 C

theta_0 are rest angles (any curved or creased rest shape), kappa^p_T plastic curvatures, C the plane
stress stiffness (E, nu, orthotropic if asked; with the nu of T, so D is one of each triangle) and B_T the
curvature operator of :mod:`sim_core.energies.curvature`, which is exact for constant curvature on any mesh.
B_T^T A_T D kappa_T are moments on the hinges around T. Without ``exact`` the Hessian is the Gauss-Newton part
A_T L^T D L with L = dkappa_T/dx, which is positive semidefinite; ``exact`` adds the hinge moments times
the second derivatives of the angles.

Plastic flow (:mod:`sim_core.energies.plastic_flow`) is part of the energy that a step minimises: D becomes the
tangent of the return mapping, and the internal variables follow from where the step ends.

Damping by the rate of bending (Kelvin-Voigt, beta [s]) adds A_T beta/(2 tau) |kappa_T - kappa_b|_D^2, kappa_b from
:meth:`sim_core.energies.term.StepContext.base`: the moment beta D dkappa/dt, which no rigid motion has.
"""

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from sim_core.energies import bending_kernels as kernels
from sim_core.energies.curvature import Stencils, curvature_operator
from sim_core.energies.element_values import ElementValues
from sim_core.energies.linearised import (
    Blocks,
    ByNumber,
    Chain,
    Linearised,
    Transposed,
    axes_of,
    gathered,
    placed,
    places,
)
from sim_core.energies.membrane import material_frames
from sim_core.energies.plastic_flow import PlasticFlow
from sim_core.energies.sheet_vjp import Flowing, SheetAlong
from sim_core.energies.term import Buffers, Internals, Quantity, StepContext
from sim_core.geometry.sheets import SheetMesh, find_hinges
from sim_core.kernels import BoundKernel
from sim_core.materials.elastic import applied, plane_stress, plane_stress_by, plane_stress_by_nu, poisson_ratios

_SIDE_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


class Bending(ElementValues):
    """Term of one sheet. ``node_offset``: index of the sheet's first node among all nodes.

    ``mesh`` is the flat or curved mesh whose metric defines areas; rest angles are those at ``formed`` [m] ``(n, 3)``,
    an isometric form of it (default: the mesh itself). ``held``: bool ``(n,)``, nodes in one rigid clamp;
    triangles of such nodes alone do not bend, which puts the clamp's edge where the held nodes end. Factors of the
    stiffness of triangles leave the curvature at which they yield as it is.
    """

    mirrored = True
    measured_at_rest = True
    quantities: tuple[Quantity, ...] = (
        Quantity("E_pa", "Pa", power=1, closed=False),
        Quantity("thickness_m", "m", power=3, closed=False),
        Quantity("nu", "-"),
        Quantity("stiffness_damping_s", "s"),
        Quantity("yield_curvature_per_m", "1/m", shares=True),
        Quantity("hardening_ratio", "-", shares=True),
    )

    def __init__(
        self,
        name: str,
        mesh: SheetMesh,
        node_offset: int,
        axis: np.ndarray,
        formed: np.ndarray | None = None,
        held: np.ndarray | None = None,
    ) -> None:
        super().__init__(mesh.areas)
        self.name = name
        self.hinges = find_hinges(mesh.triangles)
        frames = material_frames(mesh.nodes, mesh.triangles, axis)
        count = len(mesh.triangles)
        self.rigid = np.zeros(count, dtype=bool) if held is None else held[mesh.triangles].all(axis=1)
        self._kappa = curvature_operator(mesh.nodes, mesh.triangles, self.hinges, frames, mesh.areas, self.rigid)
        self._hinge = np.ascontiguousarray(self.hinges.nodes + node_offset, dtype=np.int32)
        self._stencils = Stencils(self._kappa, self._hinge)
        n_hinges = len(self._hinge)
        self._deviation, self._moment = np.zeros(n_hinges), np.zeros(n_hinges)
        self._plastic, self._base = np.zeros((count, 3)), np.zeros((count, 3))
        self._g = np.zeros((n_hinges, 12))
        self._d, self._tangent = np.zeros((count, 3, 3)), np.zeros((count, 3, 3))
        self._slope: np.ndarray | None = None
        self._onset = np.full(count, np.inf)
        self._rate, self._exact = np.zeros(count), np.zeros(1, dtype=np.int32)
        self._seen = np.full((0, 3), np.nan)
        self._yield_curvature, self._yield_share = np.inf, np.ones(count)
        self._hardening_ratio, self._hardening_share = 0.0, np.ones(count)
        self._hardening = np.zeros(count)
        self._damped = False
        self.rest_angles = self._measure(mesh.nodes if formed is None else formed, node_offset)
        self.built_angles = self.rest_angles.copy()
        """Angles [rad] of the shape in which the sheet was built, ``(n_hinges,)``."""

    def _measure(self, nodes: np.ndarray, node_offset: int) -> np.ndarray:
        out = np.zeros(len(self._hinge))
        hinge = np.ascontiguousarray(self._hinge - node_offset, dtype=np.int32)
        BoundKernel(kernels.angles, np.ascontiguousarray(nodes), hinge, np.zeros(len(hinge)), out)()
        return out

    def blocks(self) -> np.ndarray:
        """Pairs of the nodes of each triangle's stencil, then of each side of each hinge."""
        i, j = np.array(_SIDE_PAIRS).T
        sides = np.stack([self._hinge[:, [0, 1, 2]], self._hinge[:, [0, 1, 3]]], axis=1).reshape(-1, 3)
        return np.concatenate([*self._stencils.pairs(), np.stack([sides[:, i], sides[:, j]], axis=-1).reshape(-1, 2)])

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._x = buffers.x
        self._seen = np.full_like(buffers.x, np.nan)
        around = self._stencils
        stencil = (around.first, around.around, around.b)
        angles = (self._deviation, *stencil)
        law = (*angles, self._plastic, self._base, self._onset, self._size, self._d, self._hardening, self._rate)
        inner, outer = np.split(slots, [int(around.start[-1])])
        scratch = np.zeros((3 * int(around.nodes.max(initial=0)), 6))
        self._angles = BoundKernel(kernels.angles, buffers.x, self._hinge, self.rest_angles, self._deviation)
        self._elsewhere, self._deviation_there = np.zeros_like(buffers.x), np.zeros(len(self._hinge))
        there = (self._elsewhere, self._hinge)
        self._angles_there = BoundKernel(kernels.angles, *there, self.rest_angles, self._deviation_there)
        self._gradients_there = BoundKernel(kernels.gradients, *there, self._g)
        self._energy = BoundKernel(kernels.energy, *law, buffers.energy)
        self._moments = BoundKernel(kernels.moments, *law, self._moment)
        self._tangents = BoundKernel(
            kernels.tangents,
            *(*angles, self._plastic, self._onset, self._d, self._hardening, self._rate, self._exact, self._tangent),
        )
        self._gradient = BoundKernel(kernels.gradient, buffers.x, self._hinge, self._moment, buffers.gradient)
        self._gradients = BoundKernel(kernels.gradients, buffers.x, self._hinge, self._g)
        self._gauss_newton = BoundKernel(
            kernels.gauss_newton,
            *(self._g, *stencil, around.place, around.nodes, self._size, self._tangent, around.start),
            *(np.ascontiguousarray(inner), scratch, buffers.hessian),
        )
        self._curved = BoundKernel(
            kernels.curved, buffers.x, self._hinge, self._moment, np.ascontiguousarray(outer), buffers.hessian
        )

    def scale_flow(self, onset: np.ndarray, hardening: np.ndarray) -> None:
        """Let each triangle yield at ``onset`` ``(m,)`` times the curvature that is configured, and harden by
        ``hardening`` ``(m,)`` times the ratio."""
        self._yield_share[:], self._hardening_share[:] = onset, hardening
        self._hardening[:] = self._hardening_ratio * hardening

    def set_rest_angles(self, angles: np.ndarray) -> None:
        """Take other rest angles [rad] ``(n_hinges,)``."""
        self.rest_angles[:] = angles
        self._seen[:] = np.nan

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._given, self._slope = dict(parameters), None
        self._configure_grading(parameters)
        self._nu[:] = poisson_ratios(self.name, parameters["nu"], self._beside, thin=True)
        self._d[:] = self._rigidity(plane_stress(parameters, self._nu))
        self._yield_curvature = parameters.get("yield_curvature_per_m", np.inf)
        self._hardening_ratio = parameters.get("hardening_ratio", 0.0)
        self._hardening[:] = self._hardening_ratio * self._hardening_share
        self._damping[:] = parameters.get("stiffness_damping_s", 0.0) + self._more_damping
        self._damped = bool(self._damping.any())

    def _rigidity(self, stiffness: np.ndarray) -> np.ndarray:
        """D [N m] of plane stress stiffness [Pa], ``(m, 3, 3)``."""
        return np.asarray(self._given["thickness_m"] ** 3 / 12.0 * stiffness)

    @property
    def hinge_nodes(self) -> np.ndarray:
        """Nodes of the hinges among all, int32 ``(n_hinges, 4)``."""
        return self._hinge

    @property
    def operator(self) -> sp.csr_matrix:
        """From changes of the angles to curvatures, ``(3 m, n_hinges)``."""
        return self._kappa

    @property
    def stencils(self) -> Stencils:
        """Hinges and nodes around each triangle."""
        return self._stencils

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
        """D of the triangles [N m] ``(m, 3, 3)``; changed in place."""
        return self._d

    def stiffness_by(self, quantity: str) -> np.ndarray:
        """Derivative of :attr:`stiffness` by one number of the term ``(m, 3, 3)``."""
        if quantity == "thickness_m":
            return np.asarray(3.0 / self._given["thickness_m"] * self._d)
        return self._rigidity(plane_stress_by(self._given, quantity, self._nu))

    def _stiffness_by_nu(self) -> np.ndarray:
        """Derivative of D by Poisson's ratio of each triangle, ``(m, 3, 3)``."""
        if self._slope is None:
            self._slope = self._rigidity(plane_stress_by_nu(self._given, self._nu))
        return self._slope

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        self._grade_at(step.time)
        self._onset[:] = np.inf
        if internals:
            self._plastic[:] = internals["plastic_curvature"]
            self._onset[:] = self._onset_of(internals)
        self._rate[:] = self._damping / step.tau
        if self._damped or internals:  # beside flow, also for the derivative by a damping of zero
            self._base[:] = step.base(self.curvatures_at)

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
        self._measure_angles()
        self._exact[0] = exact
        self._tangents()
        self._gradients()
        self._gauss_newton()
        if exact:
            self._moments()
            self._curved()

    def end_step(self, step: StepContext, internals: Internals) -> Internals:
        del step
        if not internals:
            return internals
        flow = self._flow(internals)
        return {
            "plastic_curvature": internals["plastic_curvature"] + flow.amount[:, None] * flow.direction,
            "accumulated_curvature": internals["accumulated_curvature"] + flow.amount,
        }

    def _flow(self, internals: Internals) -> PlasticFlow:
        """What flows in a step from ``internals`` to the positions at hand."""
        elastic = self.curvatures() - internals["plastic_curvature"]
        return PlasticFlow(elastic, self._onset_of(internals), self._hardening, self._d)

    def _onset_of(self, internals: Internals) -> np.ndarray:
        """Curvature [1/m] ``(m,)`` at which each triangle flows."""
        hardened = self._hardening * internals["accumulated_curvature"]
        return np.asarray(self._yield_curvature * self._yield_share + hardened)

    def along(self, vectors: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals) -> SheetAlong:
        """What forces along nodal ``vectors`` ``(n, 3)``, and new internal variables with the weights ``kept``,
        flattened, know of the sheet's numbers at the end of a step from ``internals``."""
        return SheetAlong(
            area=self._size,
            stiffness=self._d,
            slope=self._stiffness_by_nu,
            strain=self.curvatures(),
            straining=self.curving(vectors),
            base=lambda: step.base(self.curvatures_at),
            damping=self._damping,
            tau=step.tau,
            flowing=Flowing(self._flow(internals), internals, kept) if internals else None,
        )

    def _moments_of(self, internals: Internals) -> np.ndarray:
        """Moments of the triangles per width [N] ``(m, 3)`` at the end of a step from ``internals``."""
        curvatures = self.curvatures()
        moment = applied(self._d, self._flow(internals).left if internals else curvatures)
        if self._damped:
            moment += self._rate[:, None] * applied(self._d, curvatures - self._base)
        return moment

    def by_rest_angles(
        self, along: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals
    ) -> np.ndarray:
        """Derivative by the rest angles ``(n_hinges,)`` of the work of the forces along nodal vectors ``(n, 3)`` and of
        the product of the new internal variables, flattened, with ``kept``. Rates of bending do not depend on them."""
        del step
        return np.asarray(-(self._kappa.T @ self._by_curvatures(along, kept, internals).ravel()))

    def _by_curvatures(self, along: np.ndarray, kept: np.ndarray, internals: Internals) -> np.ndarray:
        """As :meth:`by_rest_angles`, by the curvatures ``(m, 3)`` [1/m] of the triangles, at given rates."""
        moment = self._size[:, None] * applied(self._d, self.curving(along))
        if internals:
            place, flow = places(internals), self._flow(internals)
            turned = kept[place["plastic_curvature"]] - moment
            moment = moment + np.einsum("mij,mi->mj", flow.by_curvature(), turned)
            moment += (flow.rate * kept[place["accumulated_curvature"]])[:, None] * flow.slope
        return np.asarray(moment)

    def by_rest(
        self, along: np.ndarray, kept: np.ndarray, step: StepContext, internals: Internals, pairs: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives as :meth:`by_rest_angles`: by the entries of the curvature operator at ``pairs`` of triangles and
        hinges, int ``(2, k)``, as ``(k, 3)``, by the areas of the triangles ``(m,)``, and by the rest angles."""
        triangle, hinge = pairs
        by_curvature = self._by_curvatures(along, kept, internals)
        moment = self._moments_of(internals)
        curving, turning = self.curving(along), self.turning(along)
        out = by_curvature[triangle] * self._deviation[hinge, None]
        out += (self._size[:, None] * moment)[triangle] * turning[hinge, None]
        if self._damped:
            since = self._deviation - step.base(self.deviations_at)
            out += ((self._rate * self._size)[:, None] * applied(self._d, curving))[triangle] * since[hinge, None]
        by_area = self._size / self._whole_size * (moment * curving).sum(axis=1)
        return out, by_area, np.asarray(-(self._kappa.T @ by_curvature.ravel()))

    def by_angles_at(self, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Derivative by positions ``x`` [m] ``(n, 3)`` of the sum of the angles there with ``weights``."""
        self._elsewhere[:] = x
        self._gradients_there()
        out = np.zeros_like(x)
        np.add.at(out, self._hinge, (weights[:, None] * self._g).reshape(-1, 4, 3))
        return out

    def curving(self, along: np.ndarray) -> np.ndarray:
        """Change of the curvatures along nodal vectors ``(n, 3)``, ``(m, 3)``."""
        return np.asarray(self._kappa @ self.turning(along)).reshape(-1, 3)

    def turning(self, along: np.ndarray) -> np.ndarray:
        """Change of the angles along nodal vectors ``(n, 3)``, ``(n_hinges,)``."""
        self._gradients()
        moves = np.take(along, self._hinge, axis=0).reshape(-1, 12)
        return np.asarray(np.einsum("hk,hk->h", self._g, moves))

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised | None:
        """Derivatives by plastic and accumulated curvature (at yield, those of going on elastically), and by the
        positions that rates of bending are measured from."""
        del after
        if not internals and not self._damped:
            return None
        now = self._turns_by_positions()
        start = past = None
        if self._damped:
            rate = -(self._rate * self._size)[:, None, None] * self._d
            outward = (Transposed(now), self._kappa.T, self._by_triangle(rate), self._kappa)
            start = Chain((*outward, self._turns_by_positions(step.x_start, step.weights[0])))
            if step.x_past is not None:
                past = Chain((*outward, self._turns_by_positions(step.x_past, step.weights[1])))
        if not internals:
            return Linearised(force_start=start, force_past=past)
        return self._with_flow(step, internals, (self._kappa @ now.tocsr()).tocsr(), start, past)

    def by_positions(self, x: np.ndarray) -> sp.csr_matrix:
        """Derivative of all curvatures by all positions, ``(3 m, 3 n)``, at ``x``."""
        return (self._kappa @ self._turns_by_positions(x).tocsr()).tocsr()

    def _turns_by_positions(self, x: np.ndarray | None = None, weight: float = 1.0) -> Blocks:
        """Derivative of all angles by all positions, ``(n_hinges, 3 n)``, at ``x`` (None: at those at hand), times a
        weight."""
        if x is None:
            self._gradients()
        else:
            self._elsewhere[:] = x
            self._gradients_there()
        hinge = np.arange(len(self._hinge))[:, None]
        return placed((weight * self._g[:, None], hinge, axes_of(self._hinge)), shape=(len(self._hinge), self._x.size))

    @staticmethod
    def _by_triangle(stiffness: np.ndarray) -> Blocks:
        """Block diagonal matrix of a stiffness of each triangle ``(m, 3, 3)``."""
        rows = np.arange(3 * len(stiffness)).reshape(-1, 3)
        return placed((stiffness, rows, rows), shape=(rows.size, rows.size))

    def _with_flow(
        self,
        step: StepContext,
        internals: Internals,
        curvatures: sp.csr_matrix,
        start: Chain | None,
        past: Chain | None,
    ) -> Linearised:
        place, flow = places(internals), self._flow(internals)
        plastic, accumulated = place["plastic_curvature"], place["accumulated_curvature"][:, None]
        size, hardening = plastic.size + accumulated.size, self._hardening[:, None]
        count = len(self._size)
        rows = np.arange(3 * count).reshape(count, 3)
        rate, along = flow.rate[:, None], flow.direction
        by_curvature, by_accumulated = flow.by_curvature(), -hardening * rate * along
        weight = self._size[:, None, None]
        moments = placed(
            (-weight * (self._d @ (np.eye(3) - by_curvature)), rows, plastic),
            (-weight * applied(self._d, by_accumulated)[..., None], rows, accumulated),
            shape=(3 * count, size),
        )
        memory = placed(
            (np.eye(3) - by_curvature, plastic, plastic),
            (by_accumulated[..., None], plastic, accumulated),
            ((-rate * flow.slope)[:, None], accumulated, plastic),
            ((1.0 - hardening * rate)[..., None], accumulated, accumulated),
            shape=(size, size),
        )
        by_total: Blocks = placed(
            (by_curvature, plastic, rows), ((rate * flow.slope)[:, None], accumulated, rows), shape=(size, 3 * count)
        )
        change = self.curvatures() - self._base
        numbers = {}
        for quantity in self._given:
            d, onset, ratio, damping = self._by_number(quantity)
            harder = ratio * self._hardening_share
            later = onset * self._yield_share + harder * internals["accumulated_curvature"]
            turned, rise = flow.by_law(d, later, harder)
            moment = applied(d, flow.left) - applied(self._d, turned)
            moment += applied(self._rate[:, None, None] * d + damping / step.tau * self._d, change)
            kept = gathered((turned, plastic), (rise, accumulated), size=size)
            numbers[quantity] = ByNumber(curvatures.T @ (self._size[:, None] * moment).ravel(), kept, np.zeros(3))
        return Linearised(
            numbers=numbers,
            force_start=start,
            force_past=past,
            force_memory=(curvatures.T @ moments.tocsr()).tocoo(),
            memory_memory=memory,
            memory_end=(by_total.tocsr() @ curvatures).tocoo(),
        )

    def _by_number(self, quantity: str) -> tuple[np.ndarray, float, float, float]:
        """Derivatives of D, of the yield curvature, of the hardening and of the damping by one number of the term."""
        given, ends = self._given, []
        h = 1e-5 * abs(given[quantity]) or 1e-7
        for value in (given[quantity] + h, given[quantity] - h):
            self.configure({**given, quantity: value})
            ends.append((self._d.copy(), self._yield_curvature, self._hardening_ratio))
        self.configure(given)
        d, onset, hardening = ((a - b) / (2.0 * h) for a, b in zip(*ends, strict=True))
        return d, onset, hardening, float(quantity == "stiffness_damping_s")

    lasting = ("plastic_curvature", "accumulated_curvature")

    def initial_internals(self) -> Internals:
        """Plastic curvature [1/m] ``(m, 3)`` and its accumulation ``(m,)``; nothing when yield is off."""
        if not np.isfinite(self._yield_curvature):
            return {}
        return {
            "plastic_curvature": np.zeros((len(self._size), 3)),
            "accumulated_curvature": np.zeros(len(self._size)),
        }

    def curvatures(self) -> np.ndarray:
        """Elastic plus plastic curvature change of each triangle at ``buffers.x`` [1/m], ``(m, 3)``."""
        self._measure_angles()
        return np.asarray(self._kappa @ self._deviation).reshape(-1, 3)

    def curvatures_at(self, x: np.ndarray) -> np.ndarray:
        """As :meth:`curvatures`, at other positions [m] ``(n, 3)``."""
        return np.asarray(self._kappa @ self.deviations_at(x)).reshape(-1, 3)

    def deviations_at(self, x: np.ndarray) -> np.ndarray:
        """Deviations of the angles from rest [rad] ``(n_hinges,)`` at other positions [m] ``(n, 3)``."""
        self._elsewhere[:] = x
        self._angles_there()
        return np.array(self._deviation_there)
