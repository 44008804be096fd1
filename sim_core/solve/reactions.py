"""What mounts bear: the loads on prescribed nodes, with weight and inertia, and what joints pass on to them.

With dE/dx of the terms on all nodes and b, the same of inertia, weight and loads, a prescribed node bears -(dE/dx + b).
Nodes embedded in others (joints) hand both on to them, with the weights of the embedding.
"""

from __future__ import annotations

import numpy as np

from sim_core.solve.system import System


def reactions(system: System) -> np.ndarray:
    """Force [N] ``(n, 3)`` that the terms exert on every node; on prescribed nodes what their mount has to bear:
    also their weight and inertia, and what those pass on that are embedded in them (joints)."""
    whole = system.gradient().copy()
    exerted = system.static_gradient()
    return np.asarray(-exerted - passed_on(system, exerted, whole - exerted))


def passed_on(system: System, exerted: np.ndarray, body: np.ndarray) -> np.ndarray:
    """What prescribed nodes bear [N] ``(n, 3)`` beside what the terms exert on them: inertia and weight of their
    own, and all that acts on nodes embedded in them. ``exerted``: dE/dx of the terms; ``body``: of inertia, weight
    and loads, ``(n, 3)`` both, or several of them, ``(n, 3, k)``."""
    passing = _passes_on(system)
    if exerted.ndim > 2 and not passing:
        return np.where(_holding(system)[..., None], body, 0.0)
    if exerted.ndim > 2:
        return np.stack([passed_on(system, exerted[..., k], body[..., k]) for k in range(exerted.shape[2])], axis=-1)
    out = np.where(_holding(system), body, 0.0)
    if passing:
        whole = exerted + body
        out += np.where(system.prescribed, system.fold(whole) - whole, 0.0)
    return out


def passed_on_by(system: System, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Transpose of :func:`reactions`: weights ``(n, 3)`` of dE/dx of the terms, and of inertia and weight, from those
    of their negative on all nodes."""
    through = np.zeros_like(weights)
    if _passes_on(system):
        held = np.where(system.prescribed, weights, 0.0)
        system.embed(through := held.copy())
        through = through - held
    return weights + through, np.where(_holding(system), weights, 0.0) + through


def _passes_on(system: System) -> bool:
    """Whether nodes are embedded in prescribed ones, which then bear what acts on them (joints)."""
    embedding = system.embedding
    return embedding is not None and bool(embedding.weights[:, system.prescribed.any(axis=1)].nnz)


def _holding(system: System) -> np.ndarray:
    """Nodes of which some component is prescribed, bool ``(n, 1)``."""
    return np.asarray(system.prescribed.any(axis=1, keepdims=True))
