"""Integration over triangles and over quadratic faces (corners a b c, mid-edges ab bc ca)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

_A, _B = 0.816847572980459, 0.091576213509771
_C, _D = 0.108103018168070, 0.445948490915965
_POINTS = np.array([[_A, _B, _B], [_B, _A, _B], [_B, _B, _A], [_C, _D, _D], [_D, _C, _D], [_D, _D, _C]])
_WEIGHTS = np.repeat([0.109951743655322, 0.223381589678011], 3) / 2.0
"""Barycentric points and weights of the rule of degree 4 (Dunavant, Int. J. Numer. Meth. Eng. 21, 1985)."""


@dataclass(frozen=True)
class FaceRule:
    """``weights`` of the points ``(q,)``, which sum to 1/2; ``shape`` functions there ``(q, k)`` and their ``slopes``
    by both coordinates ``(q, k, 2)``."""

    weights: np.ndarray
    shape: np.ndarray
    slopes: np.ndarray

    def sides(self, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of the place by both coordinates at the points of faces ``(m, k, 3)``, ``(m, q, 3)`` each."""
        first, second = np.einsum("qad,mai->dmqi", self.slopes, corners)
        return first, second

    def shares(self, corners: np.ndarray) -> np.ndarray:
        """Areas that the nodes have of faces ``(m, k, 3)`` [m]: integrals of the shape functions [m^2] ``(m, k)``."""
        density = np.linalg.norm(np.cross(*self.sides(corners)), axis=-1)
        return np.asarray(np.einsum("q,qa,mq->ma", self.weights, self.shape, density))


@cache
def face_rule(nodes: int) -> FaceRule:
    """Rule for faces of 3 nodes, of degree 1, or of 6, of degree 4."""
    if nodes == 3:
        slopes = np.array([[[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]]])
        return FaceRule(np.array([0.5]), np.full((1, 3), 1.0 / 3.0), slopes)
    i, j = np.array([[0, 1], [1, 2], [2, 0]]).T
    shape = np.concatenate([_POINTS * (2.0 * _POINTS - 1.0), 4.0 * _POINTS[:, i] * _POINTS[:, j]], axis=1)
    by_l = np.zeros((len(_POINTS), 6, 3))
    for k in range(3):
        by_l[:, k, k] = 4.0 * _POINTS[:, k] - 1.0
        by_l[:, 3 + k, i[k]] = 4.0 * _POINTS[:, j[k]]
        by_l[:, 3 + k, j[k]] = 4.0 * _POINTS[:, i[k]]
    return FaceRule(_WEIGHTS, shape, by_l[:, :, 1:] - by_l[:, :, :1])
