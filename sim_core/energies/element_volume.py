"""How much of its volume at rest a solid keeps, at every point at which its law is evaluated, and on the way there.

On the straight way F(s) = (1 - s) F_0 + s F_1 from one deformation gradient to another, with D = F_1 - F_0,

    J(s) = det F_0 + s (cof F_0 : D) + s^2 (cof D : F_0) + s^3 det D

A solid cannot pass J = 0, but an equilibrium on the other side may be found by a step that jumps there, and even one in
which an element has turned over twice, with J > 0 again: the least J(s) tells, unless a body turns by half a turn at
once.
"""

from __future__ import annotations

import numpy as np

from sim_core.energies.neo_hookean import NeoHookean

NEXT, AFTER = np.array([1, 2, 0]), np.array([2, 0, 1])
"""The next row or column, and the one after it."""


def least_volumes(term: NeoHookean, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Least J at the points of each element ``(m,)`` on the straight way of the nodes from ``before`` to ``after`` [m]
    ``(n, 3)``."""
    gradients = term.gradients.reshape(len(term.tets), 4, 10, 3)
    f0, f1 = (np.einsum("eai,eqaj->eqij", x[term.tets], gradients, optimize=True) for x in (before, after))
    d = f1 - f0
    cof0, cof_d = _cofactor(f0), _cofactor(d)
    c0, c1 = _det(f0, cof0), (cof0 * d).sum((2, 3))
    c2, c3 = (cof_d * f0).sum((2, 3)), _det(d, cof_d)
    least = np.minimum(c0, _det(f1, _cofactor(f1)))
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(c2**2 - 3.0 * c1 * c3)
        # Where J'(s) = 0: both roots of a quadratic in the form that loses no digits.
        middle = -(c2 + np.where(c2 < 0.0, -root, root))
        for s in (middle / (3.0 * c3), c1 / middle):
            inside = np.isfinite(s) & (s > 0.0) & (s < 1.0)
            at = np.where(inside, s, 0.0)
            least = np.minimum(least, c0 + at * (c1 + at * (c2 + at * c3)))
    return np.asarray(least.min(axis=1))


def _det(f: np.ndarray, cofactor: np.ndarray) -> np.ndarray:
    return np.asarray((f[..., 0, :] * cofactor[..., 0, :]).sum(axis=-1))


def _cofactor(f: np.ndarray) -> np.ndarray:
    first, second = f[..., NEXT, :], f[..., AFTER, :]
    return np.asarray(first[..., NEXT] * second[..., AFTER] - first[..., AFTER] * second[..., NEXT])
