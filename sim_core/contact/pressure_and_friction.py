"""Contact and friction laws, per unit area of the touching surface.

Normal pressure against the gap g > 0, with stiffness k [Pa/m] and range w [m], s = g / w:

    psi(g) = k w^2 (-ln s + 2 s - s^2/2 - 3/2),   p(g) = -psi' = k w (1 - s)^2 / s   for s < 1, else 0

Surfaces feel each other from the range on, softly at first (p and p' vanish there); the slope passes k at
s = 0.71, and without bound towards g = 0, so no load closes the gap: a log barrier (Li et al., Incremental
Potential Contact, ACM Trans. Graph. 39(4), 2020) in units of a pressure. Below the share ``core`` of the range
the law goes on straight, with the slope that it has there; the core is as good as zero unless an iteration
may overlap on its way (:mod:`sim_core.solve.newton`).

Friction is Coulomb's law with an elastic pre-sliding spring: the tangential traction follows the elastic slip
u, at first with the stiffness k, until it reaches mu times the normal pressure of the start of the step,
lambda_n, at |u| = u_c = 2 mu lambda_n / (k A), y = |u| / u_c:

    D(u) = mu lambda_n u_c (y^2 - y^3/3)     y <= 1,    |dD/du| = mu lambda_n (2 y - y^2)
           mu lambda_n (|u| - u_c/3)         beyond,    |dD/du| = mu lambda_n

so a resting contact holds its load without creep (a velocity-regularised law creeps) and the
threshold does not depend on direction. The force has no kink where sliding begins (it is IPC's f_1, of the
slip instead of the velocity), so a contact that stops at its limit has one tangent. Wriggers, Computational
Contact Mechanics, 2nd ed., sec. 4.2 and 10.5 (elastic slip, return mapping). Effects may add pressures and change the
friction bound (:mod:`sim_core.contact.added_laws`).
"""

from collections.abc import Mapping

import numpy as np

from sim_core.core import language as lang
from sim_core.core.language import mat3, vec3

STIFFNESS, RANGE, CORE, MU, OFFSET, BLEND, GUARD, REACH = range(8)
"""Layout of the coefficient array of every contact term. ``OFFSET`` [m]: distance at which the gap is zero;
``BLEND`` [m]: width over which distances to several triangles are blended; ``GUARD``: 1 where distances have
no sign, because nothing has crossed; ``REACH`` [m]: gap from which on no pressure acts, of effects neither."""

CORE_GUARDED, CORE_FREE = 1e-3, 0.2
"""Share of the range below which the law is straight: where nothing crosses, and where iterates may overlap."""


def coefficients(offset: float) -> np.ndarray:
    """Coefficient array of a term whose gap is zero at the distance ``offset`` [m]."""
    c = np.zeros(8)
    c[OFFSET] = offset
    set_guard(c, True)
    return c


def set_guard(c: np.ndarray, on: bool) -> None:
    """Switch between the law itself and the one whose iterates may overlap."""
    c[GUARD] = on
    c[CORE] = CORE_GUARDED if on else CORE_FREE


def set_law(c: np.ndarray, parameters: Mapping[str, float]) -> None:
    """Take stiffness, range, friction and, if it has changed, the distance without gap by name."""
    c[STIFFNESS] = parameters["stiffness_pa_per_m"]
    c[RANGE] = parameters["range_m"]
    c[MU] = parameters["friction"]
    c[OFFSET] = parameters.get("offset_m", c[OFFSET])


LAW_OF = {"friction": MU, "stiffness_pa_per_m": STIFFNESS, "range_m": RANGE, "offset_m": OFFSET}
"""Places in the law of the numbers that a contact is given by name."""


@lang.func
def potential(g: lang.f64, c: lang.template()):
    """Energy per area [J/m^2]."""
    out = 0.0
    w = c[RANGE]
    s = g / w
    if s < 1.0:
        e = lang.max(s, c[CORE])
        k = c[STIFFNESS]
        out = k * w * w * (-lang.log(e) + 2.0 * e - 0.5 * e * e - 1.5)
        if s < e:
            over = (e - s) * w
            out += k * over * (w * (1.0 - e) ** 2 / e + 0.5 * over * (1.0 / (e * e) - 1.0))
    return out


@lang.func
def pressure(g: lang.f64, c: lang.template()):
    """Pressure [Pa], not negative."""
    out = 0.0
    w = c[RANGE]
    s = g / w
    if s < 1.0:
        e = lang.max(s, c[CORE])
        out = c[STIFFNESS] * w * ((1.0 - e) ** 2 / e + (e - s) * (1.0 / (e * e) - 1.0))
    return out


@lang.func
def slope(g: lang.f64, c: lang.template()):
    """-dp/dg [Pa/m], not negative."""
    out = 0.0
    s = g / c[RANGE]
    if s < 1.0:
        e = lang.max(s, c[CORE])
        out = c[STIFFNESS] * (1.0 / (e * e) - 1.0)
    return out


@lang.func
def friction_potential(u, limit: lang.f64, stiffness: lang.f64):
    """Energy [J] of the elastic slip u [m]; ``limit`` = mu lambda_n [N], ``stiffness`` = k A [N/m]."""
    length = u.norm()
    longest = 2.0 * limit / stiffness
    out = limit * (length - longest / 3.0)
    if length < longest:
        out = 0.5 * stiffness * length * length * (1.0 - length / (3.0 * longest))
    return out


@lang.func
def friction_force(u, limit: lang.f64, stiffness: lang.f64):
    """dD/du [N]."""
    length = u.norm()
    longest = 2.0 * limit / stiffness
    out = (stiffness * (1.0 - 0.5 * length / longest)) * u
    if length >= longest:
        out = u * (limit / length)
    return out


@lang.func
def friction_stiffness(u, limit: lang.f64, stiffness: lang.f64, projector):
    """d2D/du2 [N/m] within the tangent plane of ``projector``; positive semidefinite."""
    length = u.norm()
    longest = 2.0 * limit / stiffness
    out = stiffness * projector
    if length > 0.0:
        unit = u / length
        along = unit.outer_product(unit)
        if length < longest:
            y = length / longest
            out = stiffness * ((1.0 - 0.5 * y) * (projector - along) + (1.0 - y) * along)
        else:
            out = (projector - along) * (limit / length)
    return out


@lang.func
def tangent_projector(n):
    return mat3(1, 0, 0, 0, 1, 0, 0, 0, 1) - vec3(n[0], n[1], n[2]).outer_product(n)
