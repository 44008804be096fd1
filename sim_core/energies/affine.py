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

from sim_core.energies.term import Memoryless

KAPPA_PA = 1e9
"""Stiffness of every affine body: a Young's modulus of 8 GPa, that of hard wood or filled plastic. Contact
pressures of 0.1 MPa strain it by 1e-5; gels and sheets, and the layer of contact itself, are far softer."""


class AffineShape(Memoryless):
    """Term of all affine bodies of a scene. ``control``: their control nodes, int32 ``(n, 4)``; ``rest``: positions
    of all nodes at rest [m]; ``volumes``: [m^3] ``(n,)``."""

    def __init__(self, name: str, control: np.ndarray, rest: np.ndarray, volumes: np.ndarray) -> None:
        self.name = name
        self._nodes = np.ascontiguousarray(control, dtype=np.int32)
        self._slope = np.ascontiguousarray([barycentric(rest[c])[:, 1:] for c in control])
        self._stiffness = 8.0 * KAPPA_PA * np.asarray(volumes, dtype=float)

    @property
    def control(self) -> np.ndarray:
        """Control nodes of each body, int ``(n, 4)``."""
        return self._nodes

    @property
    def slopes(self) -> np.ndarray:
        """Gradients of the barycentric coordinates of the control nodes [1/m] ``(n, 4, 3)``."""
        return self._slope

    @property
    def stiffness(self) -> np.ndarray:
        """8 V kappa of each body [J] ``(n,)``."""
        return self._stiffness

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
