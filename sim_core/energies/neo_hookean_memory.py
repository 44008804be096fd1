"""What a gel's memory of stress and pressure exerts, and what it depends on, at the quadrature points.

A memory H of stress adds H : C / 2 to the energy density, and one of pressure p adds p (J - 1): the first exerts F H,
the second p cof F. Both come from earlier positions, by S_dev and by the dilatation that the bulk modulus sees.
"""

from __future__ import annotations

import numpy as np

from sim_core.energies.linearised import complex_step
from sim_core.energies.neo_hookean_kernels import HISTORY_J
from sim_core.energies.neo_hookean_rest import cofactor

_COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def stress_forces(f: np.ndarray, grad: np.ndarray) -> np.ndarray:
    """Nodal forces of F H per weight for a unit of each component 11 22 33 23 13 12 of H, ``(p, 30, 6)``. ``f``: F at
    p points ``(p, 3, 3)``; ``grad``: gradients of the shape functions there [1/m] ``(p, 10, 3)``."""
    columns = []
    for i, j in _COMPONENTS:
        out = f[:, None, :, i] * grad[:, :, j, None]
        columns.append(out if i == j else out + f[:, None, :, j] * grad[:, :, i, None])
    return np.stack([c.reshape(len(grad), 30) for c in columns], axis=-1)


def stress_derivatives(moved: np.ndarray, grad: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Derivative of S_dev by the nodes of each point's element [Pa/m], ``(p, 6, 30)``. ``moved``: F - 1 ``(p, 3, 3)``;
    ``mu``: shear moduli [Pa] ``(p,)``."""

    def stress(g: np.ndarray) -> tuple[np.ndarray]:
        f = np.eye(3) + g
        cof = cofactor(f)
        j = (f[..., 0, :] * cof[..., 0, :]).sum(axis=-1)
        factor = mu * ((j - 1.0) / 3.0 - 1.0) / np.where(j.real > HISTORY_J, j, HISTORY_J)
        s = mu[:, None, None] * np.eye(3) + factor[..., None, None] * (np.swapaxes(cof, -1, -2) @ cof)
        return (np.stack([s[..., i, j] for i, j in _COMPONENTS], axis=-1),)

    ((by_gradient,),) = complex_step(stress, moved)
    return np.asarray(np.einsum("pkij,paj->pkai", by_gradient, grad).reshape(len(grad), 6, 30))


def volume_derivatives(f: np.ndarray, grad: np.ndarray) -> np.ndarray:
    """Derivative of J at the four points of each element by its nodes [1/m], ``(m, 4, 30)``."""
    return np.asarray(np.einsum("pij,paj->pai", cofactor(f), grad).reshape(-1, 4, 30))


def pressure_blocks(
    here: np.ndarray, there: np.ndarray, weight: np.ndarray, bulk: np.ndarray, own: np.ndarray
) -> np.ndarray:
    """Derivative by other positions of the nodal forces that a memory of pressure, K (J - 1) there, exerts,
    ``(m, 30, 30)``. ``here``, ``there``: :func:`volume_derivatives`; ``weight``: of the points [m^3] ``(m, 4)``;
    ``bulk``: K [Pa], ``own``: K_own / K, ``(m,)``."""
    w, share = weight[:, :, None], own[:, None, None]
    mean = (w * there).sum(axis=1, keepdims=True) / w.sum(axis=1, keepdims=True)
    mixed = share * there + (1.0 - share) * mean
    return np.asarray(bulk[:, None, None] * np.einsum("eqi,eqj->eij", w * here, mixed))
