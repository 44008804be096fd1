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

from sim_core.core import language as lang
from sim_core.core.language import vec3
from sim_core.energies.element_values import ElementValues
from sim_core.energies.term import Memoryless, Quantity, counted
from sim_core.materials.elastic import plane_stress, plane_stress_by, poisson_ratios


@lang.func
def green_strain(f1, f2):
    return vec3(0.5 * (f1.dot(f1) - 1.0), 0.5 * (f2.dot(f2) - 1.0), f1.dot(f2))


@lang.func
def tension_of(s):
    """A stress without its compressive principal part."""
    mean = 0.5 * (s[0] + s[1])
    half = 0.5 * (s[0] - s[1])
    radius = lang.sqrt(half * half + s[2] * s[2])
    high = lang.max(mean + radius, 0.0)
    low = lang.max(mean - radius, 0.0)
    found = vec3(high, high, 0.0)
    if radius > 0.0:
        centre = 0.5 * (high + low)
        scale = 0.5 * (high - low) / radius
        found = vec3(centre + scale * half, centre - scale * half, scale * s[2])
    return found


class Membrane(ElementValues, Memoryless):
    """Term of one sheet. ``nodes``: rest positions of all nodes [m] ``(n, 3)``; ``triangles``: int32
    ``(m, 3)`` with indices into them; ``axis``: material direction 1, a unit 3-vector (projected on
    each triangle)."""

    quantities: tuple[Quantity, ...] = (
        Quantity("E_pa", "Pa", power=1),
        Quantity("thickness_m", "m", power=1),
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
        self._elastic = np.zeros((count, 3, 3))

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        self._given = dict(parameters)
        self._configure_grading(parameters)
        self._nu[:] = poisson_ratios(self.name, parameters["nu"], self._nu_shift, thin=True)
        self._elastic[:] = parameters["thickness_m"] * plane_stress(parameters, self._nu)
        self._damping[:] = parameters.get("stiffness_damping_s", 0.0) + self._more_damping

    @property
    def triangles(self) -> np.ndarray:
        """Nodes of the triangles among all, int32 ``(m, 3)``."""
        return self._triangles

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

    def hats(self) -> np.ndarray:
        """Gradients of the hat functions of the corners in the material axes [1/m] ``(m, 3, 2)``."""
        return np.asarray(np.concatenate([-self._dm_inverse.sum(axis=1, keepdims=True), self._dm_inverse], axis=1))


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
