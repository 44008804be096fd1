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


def least_volumes(term: NeoHookean, path: np.ndarray) -> np.ndarray:
    """Least J at the points of each element ``(t - 1, m)`` on the straight ways of the nodes from each place of a
    ``path`` [m] ``(t, n, 3)`` to the next."""
    count = len(term.tets)
    gradients = term.gradients.reshape(count, 4, 10, 3).transpose(0, 2, 1, 3).reshape(count, 10, 12)
    f = (path[:, term.tets].swapaxes(-1, -2) @ gradients).reshape(len(path), count, 3, 4, 3).swapaxes(-2, -3)
    f0, d = f[:-1], np.diff(f, axis=0)
    cofactors, own = _cofactors(f), _cofactors(d)
    whole = (f[..., 0, :] * cofactors[..., 0, :]).sum(axis=-1)
    c0, c1, c2 = whole[:-1], (cofactors[:-1] * d).sum((-2, -1)), (own * f0).sum((-2, -1))
    c3 = (d[..., 0, :] * own[..., 0, :]).sum(axis=-1)
    least = np.minimum(c0, whole[1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(c2**2 - 3.0 * c1 * c3)
        # Where J'(s) = 0: both roots of a quadratic in the form that loses no digits.
        middle = -(c2 + np.where(c2 < 0.0, -root, root))
        for s in (middle / (3.0 * c3), c1 / middle):
            inside = np.isfinite(s) & (s > 0.0) & (s < 1.0)
            at = np.where(inside, s, 0.0)
            least = np.minimum(least, c0 + at * (c1 + at * (c2 + at * c3)))
    return np.asarray(least.min(axis=2))


def _cofactors(f: np.ndarray) -> np.ndarray:
    return np.cross(f[..., (1, 2, 0), :], f[..., (2, 0, 1), :])
