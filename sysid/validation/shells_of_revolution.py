"""Thin linear shells of revolution under point loads, by a Ritz method: solutions without a mesh.

Displacements u along the meridian, v round, w outward are u_n(s) cos(n t), v_n(s) sin(n t), w_n(s) cos(n t), with
Legendre polynomials of the arc s; harmonics n do not couple. Strains and changes of curvature of the theory of
Sanders (NASA TR R-24, 1959) and Koiter, with the radius r(s), r' = dr/ds, curvatures k_s and k_t:

    e_s = u' + k_s w,    e_t = (v_t + r' u) / r + k_t w,    g = v' + (u_t - r' v) / r
    f_s = -w' + k_s u,   f_t = -w_t / r + k_t v,            f_n = (v' + (r' v - u_t) / r) / 2
    c_s = f_s',          c_t = (f_t,t + r' f_s) / r
    2 c_st = f_t' + (f_s,t - r' f_t) / r + (k_t - k_s) f_n
    energy = 1/2 int C (e_s^2 + e_t^2 + 2 nu e_s e_t + (1 - nu) g^2 / 2)
                   + D (c_s^2 + c_t^2 + 2 nu c_s c_t + (1 - nu) (2 c_st)^2 / 2) dA
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre
from scipy.linalg import null_space


@dataclass(frozen=True)
class Meridian:
    """Arc from 0 to ``length``; ``shape`` gives r, r', k_s, k_t at arcs ``(k,)``, an array ``(4, k)``."""

    length: float
    shape: Callable[[np.ndarray], np.ndarray]


def cylinder(radius: float, length: float) -> Meridian:
    """A line along the axis."""
    line = np.array([[radius], [0.0], [0.0], [1.0 / radius]])
    return Meridian(length, lambda s: line + np.zeros_like(s))


def sphere(radius: float, angle: float) -> Meridian:
    """A circle from the equator up to ``angle`` [rad]."""

    def shape(s: np.ndarray) -> np.ndarray:
        bend = np.full_like(s, 1.0 / radius)
        return np.stack([radius * np.cos(s / radius), -np.sin(s / radius), bend, bend])

    return Meridian(radius * angle, shape)


def strains(shape: np.ndarray, n: int, fields: np.ndarray) -> np.ndarray:
    """e_s, e_t, g, c_s, c_t, 2 c_st ``(6, k, ...)`` of a harmonic, without their factors cos or sin of (n t).

    ``shape`` ``(4, k)`` as of :class:`Meridian`; ``fields`` ``(3, 3, k, ...)``: u, v, w and their two derivatives by
    the arc.
    """
    r, dr, ks, kt = (part.reshape(-1, *([1] * (fields.ndim - 3))) for part in shape)
    (u, du, _), (v, dv, _), (w, dw, ddw) = fields
    fs, dfs = ks * u - dw, ks * du - ddw
    ft = n * w / r + kt * v
    dft = n * (dw - w * dr / r) / r + kt * dv + (ks - kt) * dr / r * v
    fn = 0.5 * (dv + (dr * v + n * u) / r)
    return np.stack(
        [
            du + ks * w,
            (n * v + dr * u) / r + kt * w,
            dv - (n * u + dr * v) / r,
            dfs,
            (n * ft + dr * fs) / r,
            dft - (n * fs + dr * ft) / r + (kt - ks) * fn,
        ]
    )


def deflection(
    meridian: Meridian,
    values: Mapping[str, float],
    arc: float,
    forces: Sequence[tuple[float, float]],
    held: Sequence[tuple[float, int, int]] = (),
    degree: int = 40,
    most: int = 80,
) -> float:
    """Way outward [m] of the place (``arc``, t = 0) under radial forces there: pairs of t and the force [N], even in t.

    ``held``: arcs at which u, v or w (0, 1, 2) or its derivative of an order are zero; ``degree`` of the polynomials;
    ``most``: the highest harmonic. Harmonics that the forces do not have are left out: with them, the rigid motions.
    """
    e, nu, h = values["E_pa"], values["nu"], values["thickness_m"]
    plane = np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, 0.5 * (1.0 - nu)]]) * e * h / (1.0 - nu**2)
    law = np.block([[plane, np.zeros((3, 3))], [np.zeros((3, 3)), plane * h**2 / 12.0]])
    points, weights = legendre.leggauss(degree + 20)
    s = 0.5 * meridian.length * (points + 1.0)
    shape = meridian.shape(s)
    fields = np.zeros((3, 3, len(s), 3, degree + 1))
    for k in range(3):
        fields[k, :, :, k] = _polynomials(s, degree, meridian.length)
    conditions = np.zeros((len(held) + 1, 3, degree + 1))
    for row, (place, field, order) in zip(conditions, [*held, (arc, 2, 0)], strict=True):
        row[field] = _polynomials(np.array([place]), degree, meridian.length)[order, 0]
    *fixed, pushed = conditions.reshape(len(held) + 1, -1)
    free = null_space(np.reshape(fixed, (len(held), -1))) if held else np.eye(len(pushed))
    area = 0.5 * meridian.length * weights * shape[0]
    way = 0.0
    for n in range(most + 1):
        force = sum(amount * np.cos(n * angle) for angle, amount in forces)
        if abs(force) < 1e-9 * max(abs(amount) for _, amount in forces):
            continue
        strain = strains(shape, n, fields).reshape(6, len(s), -1) @ free
        energy = np.einsum("aki,ab,bkj,k->ij", strain, law, strain, area, optimize=True)
        response = (pushed @ free) @ np.linalg.solve(energy, pushed @ free)
        way += float(force * response) / (np.pi if n else 2.0 * np.pi)
    return way


def _polynomials(s: np.ndarray, degree: int, length: float) -> np.ndarray:
    """Legendre polynomials of the arc and two derivatives by it, ``(3, k, degree + 1)``."""
    points = 2.0 * s / length - 1.0
    rows = [legendre.legval(points, legendre.legder(np.eye(degree + 1), order)).T for order in range(3)]
    return np.stack([row * (2.0 / length) ** order for order, row in enumerate(rows)])
