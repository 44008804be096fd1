"""Internal variables of a term as one vector, and products of vectors in space."""

from __future__ import annotations

import numpy as np

from sim_core.energies.term import Internals


def flatten(internals: Internals) -> np.ndarray:
    """All internal variables of a term as one vector, in their order."""
    return np.concatenate([np.empty(0), *(a.ravel() for a in internals.values())])


def size_of(internals: Internals) -> int:
    """Length of that vector."""
    return sum(a.size for a in internals.values())


def unflatten(vector: np.ndarray, like: Internals) -> Internals:
    """The inverse of :func:`flatten`."""
    out, at = {}, 0
    for name, array in like.items():
        out[name] = vector[at : at + array.size].reshape(array.shape)
        at += array.size
    return out


def places(internals: Internals) -> dict[str, np.ndarray]:
    """Where each internal variable is in the flattened vector: arrays of its shape."""
    return unflatten(np.arange(size_of(internals)), internals)


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Vector products along the last axis, complex vectors too."""
    p, q = [1, 2, 0], [2, 0, 1]
    return np.asarray(a[..., p] * b[..., q] - a[..., q] * b[..., p])


def skew(v: np.ndarray) -> np.ndarray:
    """Matrices ``(n, 3, 3)`` of the products v x from ``(n, 3)``."""
    out = np.zeros((*v.shape, 3), dtype=v.dtype)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., i, j], out[..., j, i] = -v[..., k], v[..., k]
    return out
