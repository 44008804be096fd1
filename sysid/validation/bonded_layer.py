"""Frictionless rigid indenters on an elastic layer that is bonded to a rigid base (Lebedev & Ufliand 1958).

A pressure p(r) on the layer of thickness h, with the Hankel transform P(q), sinks its surface by

    w(r) = 2 / E* int P(q) L(q h) J0(q r) dq,    1 / E* = (1 - nu^2) / E,
    L(x) = (2 k sinh 2x - 4 x) / (2 k cosh 2x + 4 x^2 + 1 + k^2),    k = 3 - 4 nu

(Hayes, Keer, Herrmann & Mockros, J. Biomech. 5, 1972, 541). With P(q) = E* / pi int_0^a f(t) cos(q t) dt the surface
is free beyond the radius a of the contact, and an indenter at the depth d whose profile rises by g(r) asks that

    f(x) + 2 / pi int_0^a f(t) K(x, t) dt = d - b(x),    b(x) = x int_0^x g'(r) / sqrt(x^2 - r^2) dr,
    K(x, t) = int_0^inf (L(q h) - 1) cos(q x) cos(q t) dq,    F = 2 E* int_0^a f(t) dt

A flat punch has b = 0; where the profile is smooth the contact ends where f(a) = 0. On a half space L = 1: a flat punch
has F = 2 E* a d (Boussinesq, Sneddon), a ball of the radius R, b = x^2 / R, has F = 4/3 E* a d (Hertz).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq

POINTS, WAVES, HIGHEST = 40, 400, 40.0
"""Points on each part of the contact radius, wave numbers, and the highest of them times h: there L is 1."""


def softness(x: np.ndarray, nu: float) -> np.ndarray:
    """L - 1 at wave numbers times the thickness ``x``."""
    k, decay = 3.0 - 4.0 * nu, np.exp(-2.0 * x)
    above = 2.0 * k * (1.0 - decay**2) - 8.0 * x * decay
    below = 2.0 * k * (1.0 + decay**2) + 2.0 * (4.0 * x**2 + 1.0 + k**2) * decay
    return np.asarray(above / below - 1.0)


def pressed(
    nu: float, radius: float, rise: Callable[[np.ndarray], np.ndarray], flat: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """f at the rim of the contact, and F / (2 E*), of the depth 1 and of the rise b ``(2,)``, in units of h.

    ``radius``: a / h; ``flat``: radius at which the profile begins to rise. A depth d gives d times the first less the
    second.
    """
    ends = [0.0, flat, radius] if 0.0 < flat < radius else [0.0, radius]
    parts = [_gauss(POINTS, low, high) for low, high in pairwise(ends)]
    x = np.concatenate([*(points for points, _ in parts), [radius]])
    weights = np.concatenate([*(weights for _, weights in parts), [0.0]])
    q, by_q = _gauss(WAVES, 0.0, HIGHEST)
    waves = np.cos(np.outer(x, q))
    kernel = (waves * (softness(q, nu) * by_q)) @ waves.T
    right = np.stack([np.ones_like(x), rise(x)], axis=1)
    f = np.linalg.solve(np.eye(len(x)) + 2.0 / np.pi * kernel * weights, right)
    return f[-1], weights @ f


def punch(nu: float, radius: float) -> float:
    """Force of a flat punch over that on a half space, 2 E* a d; ``radius``: a / h."""
    return float(pressed(nu, radius, np.zeros_like)[1][0] / radius)


def ball(nu: float, radius: float) -> tuple[float, float]:
    """sqrt(R d) / h, and the force over that of Hertz at the same depth, of a ball with the contact radius a / h."""
    rim, force = pressed(nu, radius, np.square)
    chi = float(np.sqrt(rim[1] / rim[0]))
    return chi, float(1.5 * (force[0] - force[1] / chi**2) / chi)


def rounded_punch(nu: float, radius: float, edge: float, depth: float) -> float:
    """Force over 2 E* h^2 of a flat punch of a radius whose rim is rounded by the radius ``edge``, at a depth that is
    small against that, all over h."""
    flat = radius - edge
    angles, weights = _gauss(POINTS, 0.0, 1.0)

    def rise(x: np.ndarray) -> np.ndarray:
        """b with r = x sin(angle); the rim rises with the slope of a circle."""
        low = np.arcsin(np.minimum(flat / x, 1.0))
        span = 0.5 * np.pi - low
        out = np.maximum(x[:, None] * np.sin(low[:, None] + span[:, None] * angles) - flat, 0.0)
        return np.asarray(x * span * ((out / np.sqrt(edge**2 - out**2)) @ weights))

    def lift(contact: float) -> float:
        rim, _ = pressed(nu, contact, rise, flat)
        return float(depth * rim[0] - rim[1])

    contact = brentq(lift, flat + 1e-6 * edge, flat + 0.999 * edge)
    force = pressed(nu, contact, rise, flat)[1]
    return float(depth * force[0] - force[1])


def _gauss(count: int, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    points, weights = np.polynomial.legendre.leggauss(count)
    return low + 0.5 * (high - low) * (points + 1.0), 0.5 * (high - low) * weights
