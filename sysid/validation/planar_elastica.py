"""Inextensible rods that bend in a plane, to eight digits: solutions for strips of any bending stiffness B.

Slope theta(s) along the length s in [0, 1] L; loads in units of B / L^2. What has a closed form is given by it
(elliptic integrals of modulus k = sin(a/2)); the others are boundary value problems, solved by collocation
(:func:`scipy.integrate.solve_bvp`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

RESIDUAL, MOST_NODES = 1e-8, 100_000
"""Of the collocation, relative; most nodes it may use."""


def heavy(gamma: float) -> tuple[float, float]:
    """Drop and reach of the tip over the length of a strip held horizontally that sags under its weight w per length,
    Gamma = w L^3 / B: theta'' = -Gamma (1 - s) cos(theta), theta(0) = theta'(1) = 0 (Romero et al., ACM Trans. Graph.
    40(4), 2021). For large Gamma all of the bend is in a layer of 1 / sqrt(2 Gamma)."""
    return _cantilever(gamma, lambda s: 1.0 - s)


def tip_loaded(alpha: float) -> tuple[float, float]:
    """Deflection and shortening over the length of a cantilever under a force at its tip across it at rest, alpha =
    P L^2 / B: theta'' = -alpha cos(theta) (Bisshopp & Drucker, Quart. Appl. Math. 3, 1945)."""
    drop, reach = _cantilever(alpha, np.ones_like)
    return drop, 1.0 - reach


def rolled(angle: float) -> tuple[float, float]:
    """Deflection and shortening over the length of a cantilever under a couple M at its tip: an arc of ``angle`` =
    M L / B [rad]."""
    return float((1.0 - np.cos(angle)) / angle), float(1.0 - np.sin(angle) / angle)


def hinged(approach: float) -> tuple[float, float, float]:
    """P / P_Euler, slope at the ends [rad] and deflection at the middle over the length of a column with two hinges
    that have approached by ``approach`` of its length: P / P_Euler = (2 K / pi)^2, approach = 2 (1 - E / K),
    deflection k / K (Timoshenko & Gere, Theory of Elastic Stability, 2nd ed., sec. 2.7)."""

    def excess(modulus: float) -> float:
        return float(2.0 * (1.0 - ellipe(modulus**2) / ellipk(modulus**2)) - approach)

    modulus = brentq(excess, 1e-6, 1.0 - 1e-9, xtol=1e-15)
    quarter = ellipk(modulus**2)
    return float((2.0 * quarter / np.pi) ** 2), float(2.0 * np.arcsin(modulus)), float(modulus / quarter)


def pressed(lowering: float) -> tuple[float, float]:
    """N and T in B / L^2 on the tip of a strip clamped normal to a plane, tip right under the clamp, free to turn but
    stuck, with the clamp lowered by ``lowering`` of the length: theta'' = -N sin(theta) - T cos(theta), theta(0) =
    theta'(1) = 0 (Sano, Yamaguchi & Wada, Phys. Rev. Lett. 118, 2017). Followed from the buckled strip: theta =
    T / N (w sin(w s) - 1 + cos(w s)), tan(w) = w."""

    def slopes(_: np.ndarray, y: np.ndarray, p: np.ndarray) -> np.ndarray:
        return np.stack([y[1], -p[0] * np.sin(y[0]) - p[1] * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    first = min(lowering, 0.01)
    w, s = 4.493409457909064, np.linspace(0.0, 1.0, 101)
    shape = w * np.sin(w * s) - 1.0 + np.cos(w * s)
    ratio = np.sqrt(2.0 * first / np.trapezoid(shape**2, s))
    bend = ratio * (w**2 * np.cos(w * s) - w * np.sin(w * s))
    values = np.stack([ratio * shape, bend, s, np.zeros_like(s)])
    forces = w**2 * np.array([1.0, ratio])
    for part in np.linspace(first, lowering, 6):

        def ends(a: np.ndarray, b: np.ndarray, _: np.ndarray, reach: float = 1.0 - part) -> np.ndarray:
            return np.array([a[0], a[2], a[3], b[1], b[2] - reach, b[3]])

        found = solve_bvp(slopes, ends, s, values, p=forces, tol=RESIDUAL, max_nodes=MOST_NODES)
        s, values, forces = found.x, found.y, found.p
    return float(forces[0]), float(abs(forces[1]))


def _cantilever(load: float, share: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
    """Drop and reach of the tip: theta'' = -load share(s) cos(theta), theta(0) = theta'(1) = 0. Followed from a light
    load; nodes are dense at the clamp."""

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[0], a[2], a[3], b[1]])

    s = np.linspace(0.0, 1.0, 201) ** 2
    values = np.stack([np.zeros_like(s), np.zeros_like(s), s, np.zeros_like(s)])
    first = min(load, 1.0)
    for part in np.geomspace(first, load, 1 + int(np.ceil(4.0 * np.log10(load / first)))):

        def slopes(s: np.ndarray, y: np.ndarray, part: float = part) -> np.ndarray:
            return np.stack([y[1], -part * share(s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

        found = solve_bvp(slopes, ends, s, values, tol=RESIDUAL, max_nodes=MOST_NODES)
        s, values = found.x, found.y
    return float(values[3, -1]), float(values[2, -1])
