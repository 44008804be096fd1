"""Derivative of a gel's forces and memory by its shape at rest.

Moving rest positions by dX changes the gradients of the shape functions, dg_a = -(grad dX)^T g_a, and the volume of
a quadrature point, dw = w div dX, so with L = grad dX

    dF = -F L  for the deformation gradient at the end of the step, at its start and before,
    dV = -V L  for V = grad v of nodal vectors v

and the work of the forces along v, sum w P : V, changes by sum Y : L, that is by sum_q Y_q g_b at node b, with

    Y = w (P : V) 1 - V^T w P - sum_i F_i^T dW/dF_i

(Eshelby's energy-momentum tensor, J. Elasticity 5, 1975, of the work in place of the energy). What the stress
remembers depends on the deformation at the start of the step and before; the mean dilatation of an element on its
volumes too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim_core.energies.neo_hookean_kernels import HISTORY_J

_P, _Q = [1, 2, 0], [2, 0, 1]


@dataclass(frozen=True)
class GelStep:
    """A step at the quadrature points of m elements. ``weight``: volumes [m^3] ``(m, 4)``; ``now``: F at its end
    ``(m, 4, 3, 3)``; ``stress``: H [Pa] ``(m, 4, 3, 3)`` and ``pressure`` of the memory [Pa] ``(m, 4)``. ``mu``,
    ``bulk`` [Pa] and ``own``, K_own / K: of the elements ``(m, 1)``; ``share``, ``bulk_share``: factors on the energies
    of both. ``earlier``: F at other times, with the factors by which S_dev and K (J - 1) there are in the stress and
    pressure of the memory; ``fresh``: b g; all these factors ``(m, 1)``."""

    weight: np.ndarray
    now: np.ndarray
    stress: np.ndarray
    pressure: np.ndarray
    mu: np.ndarray
    bulk: np.ndarray
    own: np.ndarray
    share: np.ndarray
    bulk_share: np.ndarray
    earlier: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]
    fresh: np.ndarray


def by_rest(step: GelStep, slope: np.ndarray, kept: np.ndarray | None) -> np.ndarray:
    """Y of all quadrature points ``(m, 4, 3, 3)`` for V = ``slope`` ``(m, 4, 3, 3)``, that of the weights ``kept`` of
    the new stress that relaxes, as a symmetric tensor ``(m, 4, 3, 3)``, included."""
    f, v, w, own = step.now, slope, step.weight[..., None, None], step.own
    cof, turned = cofactor(f), cofactor_slope(f, v)
    theta, swelling = determinant(f, cof) - 1.0, _dot(cof, v)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray((step.weight * values).sum(axis=1, keepdims=True) / step.weight.sum(axis=1, keepdims=True))

    def mixed(values: np.ndarray) -> np.ndarray:
        return np.asarray(own * values + (1.0 - own) * mean(values))

    one, shear, bulk = np.eye(3), step.share * step.mu, step.bulk_share * step.bulk
    push = (shear / 3.0 * theta + bulk * mixed(theta) + step.pressure)[..., None, None]
    first = shear[..., None, None] * (f - cof) + push * cof + f @ step.stress
    slopes = shear[..., None, None] * (v - turned) + push * turned + v @ step.stress
    slopes = slopes + (shear / 3.0 * swelling + bulk * mixed(swelling))[..., None, None] * cof
    spread = bulk * (theta - mean(theta))
    strain = _symmetric(f.swapaxes(-1, -2) @ v)
    out = -(v.swapaxes(-1, -2) @ first) - f.swapaxes(-1, -2) @ slopes
    for there, sheared, pressed in step.earlier:
        cof_then = cofactor(there)
        then = sheared[..., None, None] * stress_slope(there, cof_then, strain, step.mu)
        if pressed.any():
            then += (pressed * step.bulk * mixed(swelling))[..., None, None] * cof_then
            volume = determinant(there, cof_then)
            spread = spread + pressed * step.bulk * (volume - mean(volume))
        out -= there.swapaxes(-1, -2) @ then
    work = _dot(first, v) + (1.0 - own) * spread * mean(swelling)
    out = w * (out + work[..., None, None] * one)
    if kept is not None:
        ends = ((f, step.fresh), (step.earlier[0][0], -step.fresh))
        for there, factor in ends:
            slope_there = stress_slope(there, cofactor(there), kept, step.mu)
            out -= factor[..., None, None] * there.swapaxes(-1, -2) @ slope_there
    return np.asarray(out)


def as_tensors(components: np.ndarray, off_diagonal: float = 1.0) -> np.ndarray:
    """Symmetric tensors ``(..., 3, 3)`` from components 11 22 33 23 13 12, off the diagonal times a factor."""
    scaled = components * np.repeat([1.0, off_diagonal], 3)
    return np.asarray(scaled[..., [[0, 5, 4], [5, 1, 3], [4, 3, 2]]])


def cofactor(f: np.ndarray) -> np.ndarray:
    """Cofactors of matrices ``(..., 3, 3)``, the derivative of the determinant."""
    return np.asarray(f[..., _P, :][..., _P] * f[..., _Q, :][..., _Q] - f[..., _P, :][..., _Q] * f[..., _Q, :][..., _P])


def cofactor_slope(f: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Derivative of :func:`cofactor` along ``v``, a symmetric form."""
    a, b = (f[..., i, :] for i in (_P, _Q))
    c, d = (v[..., i, :] for i in (_P, _Q))
    straight = a[..., _P] * d[..., _Q] + c[..., _P] * b[..., _Q]
    return np.asarray(straight - a[..., _Q] * d[..., _P] - c[..., _Q] * b[..., _P])


def determinant(f: np.ndarray, cof: np.ndarray) -> np.ndarray:
    """Determinants ``(...)`` of matrices whose cofactors are known."""
    return np.asarray((f[..., 0, :] * cof[..., 0, :]).sum(axis=-1))


def stress_slope(f: np.ndarray, cof: np.ndarray, along: np.ndarray, mu: np.ndarray) -> np.ndarray:
    """Derivative by F of S_dev : T for symmetric tensors T = ``along``, where S_dev = mu 1 + s(J) cof^T cof,
    s = mu ((J - 1) / 3 - 1) / J, ``mu`` ``(m, 1)``."""
    j = determinant(f, cof)
    crushed = j <= HISTORY_J
    least = np.where(crushed, HISTORY_J, j)
    factor = mu * ((j - 1.0) / 3.0 - 1.0) / least
    steep = np.where(crushed, mu / (3.0 * HISTORY_J), 4.0 * mu / (3.0 * least**2))
    pulled = cof @ along
    return np.asarray(
        (steep * _dot(pulled, cof))[..., None, None] * cof + 2.0 * factor[..., None, None] * cofactor_slope(f, pulled)
    )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("...ij,...ij->...", a, b))


def _symmetric(a: np.ndarray) -> np.ndarray:
    return np.asarray(0.5 * (a + a.swapaxes(-1, -2)))
