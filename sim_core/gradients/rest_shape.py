"""Derivatives by the shapes of bodies at rest.

The mechanics depend on rest positions X through what is measured on them once: Dm^-1 and areas of triangles, the
curvature operator and the rest angles of a sheet, gradients and volumes of a gel's quadrature points, masses, areas of
contact samples and edges, places in the mounts. The core sums up weights of these over the steps, and they are passed
on to the nodes once, at the end:

    dL/dX = sum_q (sum_steps dL/dq) dq/dX    +    what is put at X: where nodes start, and what follows the mounts

A rigid motion of a body's shape together with all that it touches changes nothing but where it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from sim_core.contact.measures import Measures
from sim_core.core.adjoint import CoreAdjoint
from sim_core.core.record import contacts_of, edges_of, surfaces_of
from sim_core.energies.bending import Bending
from sim_core.energies.curvature_rest import CurvatureRest, frames_of
from sim_core.geometry import tet10
from sim_core.geometry.sheets import SheetMesh, area_slopes
from sim_core.geometry.solids import TetMesh
from sim_core.scene.assembly import BuiltBody, grain
from sim_core.scene.carriage import carriers
from sim_core.scene.scene import Frame, Scene

_TINY = 1e-30


class RestShapes:
    """Shapes of ``bodies`` at rest, for one adjoint after the other."""

    def __init__(self, scene: Scene, bodies: Sequence[str]) -> None:
        self._scene = scene
        self.sheets: dict[str, SheetShape] = {}
        self.gels: dict[str, GelShape] = {}
        for name in bodies:
            if isinstance(scene.bodies[name].mesh, SheetMesh):
                self.sheets[name] = SheetShape(scene, scene.bodies[name])
            else:
                self.gels[name] = GelShape(scene, scene.bodies[name])
        self._loose = np.ones(len(scene.rest), dtype=bool)
        for follower in scene.followers:
            self._loose[follower.nodes] = False
        self.placed = np.zeros_like(scene.rest)

    @property
    def bodies(self) -> list[str]:
        """Names of the bodies."""
        return [*self.sheets, *self.gels]

    def __bool__(self) -> bool:
        return bool(self.bodies)

    @property
    def pairs(self) -> dict[str, np.ndarray]:
        """Triangles and hinges ``(2, k)`` on which the curvature operators depend, by the names of bending terms."""
        return {sheet.bending.name: sheet.pairs for sheet in self.sheets.values()}

    def put(self, x: np.ndarray, held: np.ndarray, frames: Mapping[str, Frame]) -> None:
        """Begin anew, with the weights of where nodes are put when the mounts are at ``frames``: ``x`` ``(n, 3)``, of
        those that follow mounts ``held``."""
        scene = self._scene
        self.placed[:] = 0.0
        for follower in scene.followers:
            turn = frames[follower.mount][1] * scene.start[follower.mount][1].inv()
            self.placed[follower.nodes] += turn.inv().apply(follower.axes * held[follower.nodes])
        for name in self.bodies:
            nodes = scene.bodies[name].nodes
            free, along = nodes[self._loose[nodes]], carriers(scene, name)
            if not along:
                self.placed[free] += x[free]
            for carrier in along:
                turn = frames[carrier.mount][1] * scene.start[carrier.mount][1].inv()
                shares = (carrier.weights * self._loose[carrier.nodes])[:, None]
                self.placed[carrier.nodes] += turn.inv().apply(shares * x[carrier.nodes])

    def total(self, adjoint: CoreAdjoint) -> np.ndarray:
        """Derivatives by the rest positions of all nodes ``(n, 3)``, but for what their own bodies measure on them."""
        scene, total = self._scene, self.placed.copy()
        local, first = adjoint.elements("follower_local").reshape(-1, 3), 0
        for follower in scene.followers:
            own = local[first : first + len(follower.nodes)]
            first += len(follower.nodes)
            np.add.at(total, follower.nodes, scene.start[follower.mount][1].apply(own))
        for measures, weights in self._touching(adjoint):
            at = 0
            for measure in measures:
                total += measure.back(scene.rest, weights[at : at + measure.count])
                at += measure.count
        return np.asarray(total)

    def _touching(self, adjoint: CoreAdjoint) -> list[tuple[Sequence[Measures], np.ndarray]]:
        """What contacts measure at rest, and its weights."""
        found: list[tuple[Sequence[Measures], np.ndarray]] = []
        for name, terms in (("sample", contacts_of(self._scene)), ("surface", surfaces_of(self._scene))):
            areas, first = adjoint.elements(f"{name}_area"), 0
            for term in terms:
                found.append((term.measures, areas[first : first + len(term.areas)]))
                first += len(term.areas)
        areas, squares = adjoint.elements("edge_area"), adjoint.elements("edge_square")
        first = 0
        for pair in edges_of(self._scene):
            ours, theirs = pair.sides
            own = slice(first, first + len(ours.edges))
            other = slice(own.stop, own.stop + len(theirs.edges))
            first = other.stop
            if ours is theirs:  # listed twice
                weights = [areas[own] + areas[other], squares[own] + squares[other]]
            else:
                weights = [areas[own], areas[other], squares[own], squares[other]]
                if theirs.areas is None:
                    weights = [areas[own], squares[own]]
            found.append((pair.measures, np.concatenate(weights)))
        return found


class SheetShape:
    """What is measured on a sheet."""

    def __init__(self, scene: Scene, body: BuiltBody) -> None:
        assert isinstance(body.mesh, SheetMesh)
        self._rest, self._nodes = scene.rest, body.nodes
        self._triangles, self._axes = body.mesh.triangles + int(body.nodes[0]), grain(body)
        self.bending = next(t for t in body.terms if isinstance(t, Bending))
        self._curvature = CurvatureRest(
            body.rest, body.mesh.triangles, self.bending.hinges, self._axes, self.bending.rigid
        )
        self.pairs = self._curvature.pairs
        """Triangles and hinges on which its curvature operator depends ``(2, k)``."""

    def pass_on(
        self, hats: np.ndarray, area: np.ndarray, operator: np.ndarray, angle: np.ndarray, total: np.ndarray
    ) -> None:
        """Add the derivatives by the nodes to those of all ``(n, 3)``, from weights of the gradients of the triangles'
        hat functions ``(m, 3, 2)``, of areas ``(m,)``, of the operator at ``pairs`` ``(k, 3)`` and of rest angles."""
        corners, inverse = self._rest[self._triangles], hats[:, 1:] - hats[:, :1]
        slopes = area[:, None, None] * area_slopes(self._rest, self._triangles)
        for k in range(3):
            moved = np.repeat(corners[None].astype(complex), 3, axis=0)
            moved[np.arange(3), :, k, np.arange(3)] += 1j * _TINY
            sides = (moved[..., 1:, :] - moved[..., :1, :]).swapaxes(-1, -2)
            found = np.linalg.inv(frames_of(moved, self._axes).swapaxes(-1, -2) @ sides)
            slopes[:, k] += (found.imag / _TINY * inverse).sum(axis=(-1, -2)).T
        np.add.at(total, self._triangles, slopes)
        total[self._nodes] += self._curvature.back(operator)
        total += self.bending.by_angles_at(self._rest, angle)


class GelShape:
    """What is measured on a gel."""

    def __init__(self, scene: Scene, body: BuiltBody) -> None:
        assert isinstance(body.mesh, TetMesh)
        self._tets, self._rest = body.mesh.tets + int(body.nodes[0]), scene.rest

    def pass_on(self, gradient: np.ndarray, volume: np.ndarray, mass: np.ndarray, total: np.ndarray) -> None:
        """Add the derivatives by the nodes to those of all ``(n, 3)``, from weights of the gradients of the shape
        functions at the quadrature points ``(m, 4, 10, 3)``, of the logarithms of their volumes ``(m, 4)``, and of the
        elements' masses over their density ``(m, 10, 10)``: of volumes, d det = det div dX, and of gradients, d grad N
        = -(grad dX)^T grad N."""
        places = self._rest[self._tets]
        own, _ = tet10.gradients(places, tet10.four_point_rule()[0])
        tensor = volume[..., None, None] * np.eye(3) - np.einsum("mqak,mqaj->mqkj", own, gradient)
        slopes = np.einsum("mqkj,mqcj->mck", tensor, own)
        points, weights = tet10.conical_rule(4)  # as of solids.element_masses
        own, det = tet10.gradients(places, points)
        n = tet10.shape(points)
        dense = np.einsum("qa,mab,qb->mq", n, mass, n, optimize=True) * det * weights
        np.add.at(total, self._tets, slopes + np.einsum("mq,mqai->mai", dense, own))
