"""Derivatives by the shapes of bodies at rest, summed up on the way back.

Terms depend on rest positions X through what is measured on them once: Dm^-1 and areas of triangles, the curvature
operator and the rest angles of a sheet, gradients and volumes of a gel's quadrature points, masses, areas of contact
samples. These do not change in a rollout, so the derivatives by them of what every step exerts and remembers are summed
up, at the cost of some products a step, and passed on to the nodes once, at the end:

    dL/dX = sum_q (sum_steps dL/dq) dq/dX    +    what is put at X: where nodes start, and what follows the mounts

A rigid motion of a body's shape together with all that it touches changes nothing but where it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.energies.bending import Bending
from sim_core.energies.bending_strain import BendingStrain
from sim_core.energies.curvature_rest import CurvatureRest, frames_of
from sim_core.energies.linearised import Linearised, times_back
from sim_core.energies.membrane import Membrane
from sim_core.energies.membrane_strain import MembraneStrain
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.energies.solid_strain import SolidStrain
from sim_core.energies.strain_law import StrainLaws
from sim_core.energies.term import ByAreas, Internals, StepContext
from sim_core.geometry import tet10
from sim_core.geometry.sheets import SheetMesh, area_slopes
from sim_core.geometry.solids import TetMesh
from sim_core.gradients.parameter_jacobian import borne_by_mass
from sim_core.gradients.step import Pulled, Weights
from sim_core.scene.assembly import BuiltBody, grain
from sim_core.scene.carriage import carriers
from sim_core.scene.fields import MASS
from sim_core.scene.scene import Frame, Scene, Values

_TINY = 1e-30


class RestSums:
    """Sums over the steps of a rollout, for the shapes of ``bodies`` at rest. ``values``: numbers of the rollout."""

    def __init__(self, scene: Scene, values: Values, bodies: Sequence[str]) -> None:
        self._scene, self._values, self._bodies = scene, values, list(bodies)
        self._parts: dict[str, _Sheet | _Gel] = {}
        for name in bodies:
            kind = _Sheet if isinstance(scene.bodies[name].mesh, SheetMesh) else _Gel
            self._parts[name] = kind(scene, scene.bodies[name])
        touching = [c.name for c in scene.rig.contacts if set(c.between) & set(bodies)]
        self._contacts = {t.name: t.measures for name in touching for t in scene.contacts[name] if t.measures}
        self._loose = np.ones(len(scene.rest), dtype=bool)
        for follower in scene.followers:
            self._loose[follower.nodes] = False
        self.clear()

    def __bool__(self) -> bool:
        return bool(self._bodies)

    def clear(self) -> None:
        """Begin anew."""
        self._placed = np.zeros_like(self._scene.rest)
        self._measured = {n: np.zeros(sum(m.count for m in ms)) for n, ms in self._contacts.items()}
        for part in self._parts.values():
            part.clear()

    def add(
        self,
        step: StepContext,
        internals: Mapping[str, Internals],
        pulled: Pulled,
        after: Weights,
        terms: Mapping[str, Linearised],
    ) -> None:
        """Add what a step has, at the end of which the system is. ``internals``: before it; ``after``: weights of its
        end; ``terms``: as linearised."""
        scene, exerted = self._scene, pulled.exerted
        for name, part in self._parts.items():
            pairs = borne_by_mass(scene, self._values.density[name], name, step, exerted, pulled.borne)
            part.add(step, internals, exerted, after.memory, pairs)
        for name, total in self._measured.items():
            if name in terms:
                total += times_back(terms[name].force_rest, exerted.ravel())
                total += times_back(terms[name].memory_rest, after.memory[name])
                if name in after.moment:
                    total += times_back(terms[name].moment_rest, after.moment[name])

    def follow(self, targets: np.ndarray, frames: Mapping[str, Frame]) -> None:
        """Add the weights ``(n, 3)`` of where nodes are that follow the mounts, which are at ``frames``: from the start
        poses on, at which they are where the shape has them."""
        scene = self._scene
        for follower in scene.followers if self._bodies else ():
            turn = frames[follower.mount][1] * scene.start[follower.mount][1].inv()
            self._placed[follower.nodes] += turn.inv().apply(follower.axes * targets[follower.nodes])

    def start(self, x: np.ndarray, frames: Mapping[str, Frame]) -> None:
        """Add the weights ``x`` ``(n, 3)`` of where nodes that follow no mount are put when the mounts are at
        ``frames``."""
        scene = self._scene
        for name in self._bodies:
            nodes = scene.bodies[name].nodes
            free = nodes[self._loose[nodes]]
            along = carriers(scene, name)
            if not along:
                self._placed[free] += x[free]
            for carrier in along:
                turn = frames[carrier.mount][1] * scene.start[carrier.mount][1].inv()
                shares = (carrier.weights * self._loose[carrier.nodes])[:, None]
                self._placed[carrier.nodes] += turn.inv().apply(shares * x[carrier.nodes])

    def gradients(self) -> dict[str, np.ndarray]:
        """Derivatives by the rest positions of each body, ``(n, 3)``."""
        scene = self._scene
        total = self._placed.copy()
        for name, measures in self._contacts.items():
            at = 0
            for measure in measures:
                total += measure.back(scene.rest, self._measured[name][at : at + measure.count])
                at += measure.count
        for part in self._parts.values():
            part.pass_on(total)
        return {name: total[scene.bodies[name].nodes] for name in self._bodies}


class _Sheet:
    """Of one sheet: by Dm^-1, areas, the entries of the curvature operator, rest angles."""

    def __init__(self, scene: Scene, body: BuiltBody) -> None:
        assert isinstance(body.mesh, SheetMesh)
        self._rest, self._nodes = scene.rest, body.nodes
        self._triangles, self._axes = body.mesh.triangles + int(body.nodes[0]), grain(body)
        self._factor = scene.fields.factor(body.name, MASS)
        self._membrane = next(t for t in body.terms if isinstance(t, Membrane))
        self._bending = next(t for t in body.terms if isinstance(t, Bending))
        own = [t for t in scene.system.terms if t.name.startswith(f"{body.name}.")]
        self._laws = [t for t in own if isinstance(t, StrainLaws)]
        self._by_areas = [t for t in own if isinstance(t, ByAreas)]
        hinges, rigid = self._bending.hinges, self._bending.rigid
        self._curvature = CurvatureRest(body.rest, body.mesh.triangles, hinges, self._axes, rigid)
        self.clear()

    def clear(self) -> None:
        count = len(self._triangles)
        self._by_inverse, self._by_area = np.zeros((count, 2, 2)), np.zeros(count)
        self._by_operator = np.zeros((self._curvature.pairs.shape[1], 3))
        self._by_angle = np.zeros(len(self._bending.hinges.nodes))

    def add(
        self,
        step: StepContext,
        internals: Mapping[str, Internals],
        exerted: np.ndarray,
        memory: Mapping[str, np.ndarray],
        borne: list[tuple[np.ndarray | float, np.ndarray, np.ndarray]],
    ) -> None:
        for term in (self._membrane, self._bending):
            term.begin_step(step, internals[term.name])
        by_inverse, by_area = self._membrane.by_rest(exerted, step)
        self._by_inverse += by_inverse
        self._by_area += by_area
        name, pairs = self._bending.name, self._curvature.pairs
        parts = self._bending.by_rest(exerted, memory[name], step, internals[name], pairs)
        self._by_operator += parts[0]
        self._by_area += parts[1]
        self._by_angle += parts[2]
        for factor, v, w in borne:
            self._by_area += factor * self._factor / 3.0 * (v[self._triangles] * w[self._triangles]).sum(axis=(1, 2))
        for laws in self._laws:
            weights = laws.rest_weights(exerted, memory[laws.name], step, internals[laws.name])
            self._by_area += weights.by_area
            measure = laws.measure
            if isinstance(measure, MembraneStrain):
                self._by_inverse += measure.by_rest(weights.end, measure.here)
                self._by_inverse += measure.by_rest(weights.start, step.x_start)
                self._by_inverse += measure.along_by_rest(weights.along, exerted)
            elif isinstance(measure, BendingStrain):
                self._by_operator += measure.by_operator(weights.end, measure.here, pairs)
                self._by_operator += measure.by_operator(weights.start, step.x_start, pairs)
                self._by_operator += measure.along_by_operator(weights.along, exerted, pairs)
                self._by_angle += measure.by_rest_angles(weights.end + weights.start)
        for added in self._by_areas:
            added.begin_step(step, internals[added.name])
            self._by_area += added.by_areas(exerted)

    def pass_on(self, total: np.ndarray) -> None:
        """Add the derivatives by the nodes to those of all ``(n, 3)``."""
        corners = self._rest[self._triangles]
        slopes = self._by_area[:, None, None] * area_slopes(self._rest, self._triangles)
        for k in range(3):
            moved = np.repeat(corners[None].astype(complex), 3, axis=0)
            moved[np.arange(3), :, k, np.arange(3)] += 1j * _TINY
            sides = (moved[..., 1:, :] - moved[..., :1, :]).swapaxes(-1, -2)
            inverse = np.linalg.inv(frames_of(moved, self._axes).swapaxes(-1, -2) @ sides)
            slopes[:, k] += (inverse.imag / _TINY * self._by_inverse).sum(axis=(-1, -2)).T
        np.add.at(total, self._triangles, slopes)
        total[self._nodes] += self._curvature.back(self._by_operator)
        total += self._bending.by_angles_at(self._rest, self._by_angle)


class _Gel:
    """Of one gel: by the gradients and volumes at quadrature points, and by the masses of elements."""

    def __init__(self, scene: Scene, body: BuiltBody) -> None:
        assert isinstance(body.mesh, TetMesh)
        self._tets, self._rest = body.mesh.tets + int(body.nodes[0]), scene.rest
        self._factor = scene.fields.factor(body.name, MASS)
        self._elastic = next(t for t in body.terms if isinstance(t, NeoHookean))
        self._laws = [t for t in body.terms if isinstance(t, StrainLaws)]
        self.clear()

    def clear(self) -> None:
        self._tensor = np.zeros((len(self._tets), 4, 3, 3))
        self._by_mass = np.zeros((len(self._tets), 10, 10))

    def add(
        self,
        step: StepContext,
        internals: Mapping[str, Internals],
        exerted: np.ndarray,
        memory: Mapping[str, np.ndarray],
        borne: list[tuple[np.ndarray | float, np.ndarray, np.ndarray]],
    ) -> None:
        term = self._elastic
        term.begin_step(step, internals[term.name])
        self._tensor += term.by_rest(exerted, memory[term.name], step)
        for laws in self._laws:
            found = laws.rest_weights(exerted, memory[laws.name], step, internals[laws.name])
            if isinstance(laws.measure, SolidStrain):
                self._tensor += laws.measure.by_rest(found, exerted, step.x_start)
        for factor, v, w in borne:
            weights = np.broadcast_to(factor, len(self._tets))[:, None, None]
            self._by_mass += weights * v[self._tets] @ w[self._tets].swapaxes(-1, -2)

    def pass_on(self, total: np.ndarray) -> None:
        """Add the derivatives by the nodes to those of all ``(n, 3)``: of volumes, d det = det div dX."""
        places = self._rest[self._tets]
        gradient, _ = tet10.gradients(places, tet10.four_point_rule()[0])
        slopes = np.einsum("mqij,mqaj->mai", self._tensor, gradient)
        points, weights = tet10.conical_rule(4)  # as of solids.element_masses
        gradient, det = tet10.gradients(places, points)
        n = tet10.shape(points)
        dense = np.einsum("qa,mab,qb->mq", n, self._by_mass, n, optimize=True) * det * weights * self._factor[:, None]
        np.add.at(total, self._tets, slopes + np.einsum("mq,mqai->mai", dense, gradient))
