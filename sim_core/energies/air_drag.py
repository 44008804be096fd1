"""Air drag on a sheet: pressure against its normal motion, quadratic in speed.

    U = dt sum_T rho C_D A_T / 6 |v_n|^3,    v_n = n . (c - c_start)/dt

c is the centroid, n the normal at the start of the step, rho the density of air: the force is
1/2 rho C_D A v_n |v_n| against the motion (Hoerner, Fluid-Dynamic Drag, 1965, ch. 3: flat plates, C_D
about 1.2 broadside).
"""

from collections.abc import Mapping

import numpy as np

from sim_core.core import language as lang
from sim_core.core.language import F1, F2, I2, vec3
from sim_core.energies.term import Memoryless, counted

AIR_DENSITY_KG_M3 = 1.2


@lang.func
def _advance(x: lang.template(), start: lang.template(), tri: lang.template(), normal: lang.template(), e: lang.i32):
    """Normal motion of the centroid [m] and the normal."""
    move = vec3(0.0, 0.0, 0.0)
    for a in lang.static(range(3)):
        i = tri[e, a]
        move += vec3(x[i, 0] - start[i, 0], x[i, 1] - start[i, 1], x[i, 2] - start[i, 2]) / 3.0
    n = vec3(normal[e, 0], normal[e, 1], normal[e, 2])
    return move.dot(n), n


@lang.kernel
def _energy(x: F2, start: F2, tri: I2, normal: F2, factor: F1, out: F1):
    """``factor``: rho C_D A / dt^2 of each triangle."""
    lang.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        s, _ = _advance(x, start, tri, normal, e)
        out[0] = out[0] + factor[e] * lang.abs(s) ** 3 / 6.0


@lang.kernel
def _gradient(x: F2, start: F2, tri: I2, normal: F2, factor: F1, out: F2):
    lang.loop_config(serialize=True)
    for e in range(tri.shape[0]):
        s, n = _advance(x, start, tri, normal, e)
        f = factor[e] * 0.5 * s * lang.abs(s) / 3.0 * n
        for a in range(3):
            for j in lang.static(range(3)):
                out[tri[e, a], j] = out[tri[e, a], j] + f[j]


class AirDragTerm(Memoryless):
    """Term of one sheet."""

    def __init__(self, name: str, triangles: np.ndarray, areas: np.ndarray) -> None:
        self.name = name
        self._triangles = np.ascontiguousarray(triangles, dtype=np.int32)
        self._areas = areas
        self._coefficient = 0.0

    @property
    def triangles(self) -> np.ndarray:
        """Nodes of the triangles, int32 ``(m, 3)``."""
        return self._triangles

    def drag_areas(self, coefficient: float | None = None) -> np.ndarray:
        """rho C_D A of the triangles [kg/m] ``(m,)``; ``coefficient``: another C_D than that which was configured."""
        return np.asarray(AIR_DENSITY_KG_M3 * (self._coefficient if coefficient is None else coefficient) * self._areas)

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        self._coefficient = parameters["drag_coefficient"]
