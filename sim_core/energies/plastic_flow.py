"""Plastic flow of a triangle of a sheet within a step: the return mapping and its derivatives.

With the norm |kappa|_D = sqrt(kappa^T D kappa / D_11), in curvature, so that the mesh does not decide, a triangle is
elastic while n = |kappa_e|_D, kappa_e = kappa - kappa^p, stays below s = k_Y + H a. Beyond, with linear hardening H and
the accumulated plastic curvature a [1/m], a step that ends at kappa flows by

    g = (n - s) / (1 + H),    kappa^p' = kappa^p + g kappa_e / n,    a' = a + g,    m = D kappa_e (1 - g / n)

which is the least of D_11 [(n - g)^2 / 2 + s g + H g^2 / 2] over g >= 0: what is stored, and lost in the flow. The
least itself is the energy that the step minimises,

    W(kappa) = D_11 [n^2 / 2 - (n - s)_+^2 / (2 (1 + H))],    dW/dkappa = m,

convex and once continuously differentiable: the moment is on the yield surface at the end of every step, however
long it is. With H = 0 the moment stays at yield and nothing says where along a sheet it bends on. Ortiz & Stainier,
Comput. Methods Appl. Mech. Eng. 171, 1999; Simo & Hughes, Computational Inelasticity, box 3.1, written for moment and
curvature.
"""

from __future__ import annotations

import math
from typing import Any

from sim_core.core.material import MaterialFormula

AT_YIELD = 1e-12
"""A triangle that is no further beyond s than this share of it is at yield, but for round-off: its derivatives are
those of going on elastically."""


def yielding(
    e: Any,
    d: Any,
    plastic_curvature: Any,
    accumulated_curvature: float,
    yield_curvature_per_m: float,
    hardening_ratio: float,
) -> Any:
    """W less the energy of a sheet that does not yield, kappa^p' and a'."""
    elastic = e - plastic_curvature
    square = elastic.dot(d @ elastic) / d[0, 0]
    norm = math.sqrt(square)
    onset = yield_curvature_per_m + hardening_ratio * accumulated_curvature
    over = norm - onset if norm - onset > AT_YIELD * onset else 0.0
    amount = over / (1.0 + hardening_ratio)
    stored = 0.5 * d[0, 0] * (square - over * amount) - 0.5 * e.dot(d @ e)
    flowed = amount / (norm if norm > 0.0 else 1.0)
    return stored, plastic_curvature + flowed * elastic, accumulated_curvature + amount


LAW = MaterialFormula(yielding)
"""The same in one formula."""
