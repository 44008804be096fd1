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

from sim_core.energies.curvature import curvature_operator
from sim_core.energies.dihedral import angle_slopes, hinge_angles
from sim_core.energies.element_values import ElementValues
from sim_core.energies.membrane import material_frames
from sim_core.energies.term import Internals, Quantity, counted
from sim_core.geometry.sheets import SheetMesh, find_hinges
from sim_core.materials.elastic import plane_stress, plane_stress_by, poisson_ratios


class Bending(ElementValues):
    """Term of one sheet. ``node_offset``: index of the sheet's first node among all nodes.

    ``mesh`` is the flat or curved mesh whose metric defines areas; rest angles are those at ``formed`` [m] ``(n, 3)``,
    an isometric form of it (default: the mesh itself). ``held``: bool ``(n,)``, nodes in one rigid clamp;
    triangles of such nodes alone do not bend, which puts the clamp's edge where the held nodes end. Factors of the
    stiffness of triangles leave the curvature at which they yield as it is.
    """

    quantities: tuple[Quantity, ...] = (
        Quantity("E_pa", "Pa", power=1),
        Quantity("thickness_m", "m", power=3),
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
        self._kappa = curvature_operator(mesh.nodes, mesh.triangles, self.hinges, frames, self.rigid)
        self._hinge = np.ascontiguousarray(self.hinges.nodes + node_offset, dtype=np.int32)
        self._d = np.zeros((count, 3, 3))
        self._yield_curvature, self._yield_share = np.inf, np.ones(count)
        self._hardening_ratio, self._hardening_share = 0.0, np.ones(count)
        self._hardening = np.zeros(count)
        self.rest_angles = hinge_angles(mesh.nodes if formed is None else formed, self.hinges.nodes)
        self.built_angles = self.rest_angles.copy()
        """Angles [rad] of the shape in which the sheet was built, ``(n_hinges,)``."""

    @counted
    def scale_flow(self, onset: np.ndarray, hardening: np.ndarray) -> None:
        """Let each triangle yield at ``onset`` ``(m,)`` times the curvature that is configured, and harden by
        ``hardening`` ``(m,)`` times the ratio."""
        self._yield_share[:], self._hardening_share[:] = onset, hardening
        self._hardening[:] = self._hardening_ratio * hardening

    @counted
    def set_rest_angles(self, angles: np.ndarray) -> None:
        """Take other rest angles [rad] ``(n_hinges,)``."""
        self.rest_angles[:] = angles

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        self._given = dict(parameters)
        self._configure_grading(parameters)
        self._nu[:] = poisson_ratios(self.name, parameters["nu"], self._nu_shift, thin=True)
        self._d[:] = self._rigidity(plane_stress(parameters, self._nu))
        self._yield_curvature = parameters.get("yield_curvature_per_m", np.inf)
        self._hardening_ratio = parameters.get("hardening_ratio", 0.0)
        self._hardening[:] = self._hardening_ratio * self._hardening_share
        self._damping[:] = parameters.get("stiffness_damping_s", 0.0) + self._more_damping

    def _rigidity(self, stiffness: np.ndarray) -> np.ndarray:
        """D [N m] of plane stress stiffness [Pa], ``(m, 3, 3)``."""
        return np.asarray(self._given["thickness_m"] ** 3 / 12.0 * stiffness)

    @property
    def flow_numbers(self) -> tuple[np.ndarray, np.ndarray]:
        """Curvature at which virgin triangles flow [1/m], and hardening ratio, ``(m,)`` each."""
        return self._yield_curvature * self._yield_share, self._hardening

    @property
    def flow_shares(self) -> tuple[np.ndarray, np.ndarray]:
        """What the triangles have of the two numbers that are configured, ``(m,)`` each."""
        return self._yield_share, self._hardening_share

    @property
    def hinge_nodes(self) -> np.ndarray:
        """Nodes of the hinges among all, int32 ``(n_hinges, 4)``."""
        return self._hinge

    @property
    def operator(self) -> sp.csr_matrix:
        """From changes of the angles to curvatures, ``(3 m, n_hinges)``."""
        return self._kappa

    @property
    def stiffness(self) -> np.ndarray:
        """D of the triangles [N m] ``(m, 3, 3)``; changed in place."""
        return self._d

    def stiffness_by(self, quantity: str) -> np.ndarray:
        """Derivative of :attr:`stiffness` by one number of the term ``(m, 3, 3)``."""
        if quantity == "thickness_m":
            return np.asarray(3.0 / self._given["thickness_m"] * self._d)
        return self._rigidity(plane_stress_by(self._given, quantity, self._nu))

    lasting = ("plastic_curvature", "accumulated_curvature")

    def initial_internals(self) -> Internals:
        """Plastic curvature [1/m] ``(m, 3)`` and its accumulation ``(m,)``; nothing when yield is off."""
        if not np.isfinite(self._yield_curvature):
            return {}
        return {
            "plastic_curvature": np.zeros((len(self._size), 3)),
            "accumulated_curvature": np.zeros(len(self._size)),
        }

    def curvatures_at(self, x: np.ndarray) -> np.ndarray:
        """Curvatures [1/m] ``(m, 3)``, elastic and plastic, beyond those at rest, at positions ``x`` [m] ``(n, 3)``."""
        return np.asarray(self._kappa @ (hinge_angles(x, self._hinge) - self.rest_angles)).reshape(-1, 3)

    def by_angles_at(self, x: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Derivative by positions ``x`` [m] ``(n, 3)`` of the sum of the angles there with ``weights``."""
        out = np.zeros_like(x)
        np.add.at(out, self._hinge, weights[:, None, None] * angle_slopes(x, self._hinge))
        return out
