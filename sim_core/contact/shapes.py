"""Signed distance to rigid shapes in their own frame, with gradient and second derivative.

Every shape but the half space is a sharp core surrounded by a rounding of radius r:

    sphere    a point             radius R = r
    cylinder  |rho| <= R - r, |z| <= H - r   (axis z, half length H)
    box       |x_i| <= h_i - r

``shape`` arrays: kind, then parameters: half space (outward normal +z): none; sphere: R;
cylinder: R, H, r; box: h_1, h_2, h_3, r. The distance is exact outside of the core, and exact to the
nearest face inside of it.
"""

from sim_core.core import language as lang
from sim_core.core.language import mat3, vec3

HALF_SPACE, SPHERE, CYLINDER, BOX = range(4)


@lang.func
def _finish(core, inside_depth: lang.f64, inside_normal, active, r: lang.f64):
    """Distance, normal, curvature from the vector to the core (``core``) or the depth inside of it."""
    length = core.norm()
    distance = inside_depth - r
    normal = inside_normal
    second = lang.Matrix.zero(lang.f64, 3, 3)
    if length > 0.0:
        distance = length - r
        normal = core / length
        second = (active - normal.outer_product(normal)) / length
    return distance, normal, second


@lang.func
def signed_distance(y, shape: lang.template()):
    """Signed distance [m], unit gradient, second derivative [1/m] at y [m] in the body frame."""
    distance = y[2]
    normal = vec3(0.0, 0.0, 1.0)
    second = lang.Matrix.zero(lang.f64, 3, 3)
    kind = lang.cast(shape[0], lang.i32)
    if kind == lang.static(SPHERE):
        identity = mat3(1, 0, 0, 0, 1, 0, 0, 0, 1)
        distance, normal, second = _finish(y, 0.0, vec3(0.0, 0.0, 1.0), identity, shape[1])
    elif kind == lang.static(BOX):
        core = vec3(0.0, 0.0, 0.0)
        active = lang.Matrix.zero(lang.f64, 3, 3)
        depth = -1e30
        face = vec3(0.0, 0.0, 1.0)
        for i in lang.static(range(3)):
            side = 1.0
            if y[i] < 0.0:
                side = -1.0
            over = side * y[i] - (shape[1 + i] - shape[4])
            if over > 0.0:
                core[i] = side * over
                active[i, i] = 1.0
            if over > depth:
                depth = over
                face = vec3(0.0, 0.0, 0.0)
                face[i] = side
        distance, normal, second = _finish(core, depth, face, active, shape[4])
    elif kind == lang.static(CYLINDER):
        rho = lang.sqrt(y[0] * y[0] + y[1] * y[1])
        radial = vec3(1.0, 0.0, 0.0)
        if rho > 0.0:
            radial = vec3(y[0] / rho, y[1] / rho, 0.0)
        side = 1.0
        if y[2] < 0.0:
            side = -1.0
        axial = vec3(0.0, 0.0, side)
        over_r = rho - (shape[1] - shape[3])
        over_z = side * y[2] - (shape[2] - shape[3])
        core = vec3(0.0, 0.0, 0.0)
        active = lang.Matrix.zero(lang.f64, 3, 3)
        hoop = lang.Matrix.zero(lang.f64, 3, 3)
        if over_z > 0.0:
            core += over_z * axial
            active += axial.outer_product(axial)
        if over_r > 0.0:
            core += over_r * radial
            active += radial.outer_product(radial)
            across = vec3(-radial[1], radial[0], 0.0)
            hoop = across.outer_product(across) * (over_r / rho)
        face = axial
        depth = over_z
        if over_r > over_z:
            face = radial
            depth = over_r
        distance, normal, second = _finish(core, depth, face, active, shape[3])
        length = core.norm()
        if length > 0.0:
            second += hoop / length
        elif over_r > over_z:
            across = vec3(-radial[1], radial[0], 0.0)
            second = across.outer_product(across) / rho
    return distance, normal, second
