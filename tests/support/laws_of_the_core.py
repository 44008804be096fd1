"""Kernels of the laws that the core calls itself, so that they are compared as other kernels are."""

from sim_core.contact.continuous_collision import point_shape_way
from sim_core.contact.shapes import signed_distance
from sim_core.core import language as lang
from sim_core.core.language import F1, F2, F3, mat3
from sim_core.energies.dihedral import angle, angle_gradient, side_curvature
from sim_core.energies.membrane import green_strain, tension_of
from sim_core.energies.neo_hookean_kernels import deviatoric, energy_density, first_piola
from sim_core.energies.pressure import swept
from sim_core.kernels import row


@lang.func
def _square(x: lang.template(), i: lang.i32):
    """Three rows from the i-th on as a matrix."""
    return mat3(
        [x[i, 0], x[i, 1], x[i, 2]], [x[i + 1, 0], x[i + 1, 1], x[i + 1, 2]], [x[i + 2, 0], x[i + 2, 1], x[i + 2, 2]]
    )


@lang.kernel
def way_to_a_shape(x: F2, shape: F1, out: F1):
    out[0] = point_shape_way(row(x, 0), row(x, 1), shape, 0.01, 0.1)


@lang.kernel
def distance_to_a_shape(x: F2, shape: F1, out: F1, slope: F2):
    distance, normal, second = signed_distance(row(x, 0), shape)
    out[0] = distance
    for i in range(3):
        slope[3, i] = normal[i]
        for j in range(3):
            slope[i, j] = second[i, j]


@lang.kernel
def hinge(x: F2, out: F1):
    gradient = angle_gradient(row(x, 0), row(x, 1), row(x, 2), row(x, 3))
    out[0] = angle(row(x, 0), row(x, 1), row(x, 2), row(x, 3))
    for k in range(12):
        out[1 + k] = gradient[k]


@lang.kernel
def side(x: F2, turn: F1, normals: F2, slopes: F3):
    n, along, up, dc, dphi = side_curvature(row(x, 0), row(x, 1), row(x, 2), turn[0])
    for i in range(3):
        normals[0, i] = n[i]
        normals[1, i] = along[i]
        normals[2, i] = up[i]
        for j in range(6):
            slopes[0, i, j] = dc[i, j]
        for j in range(3):
            slopes[1, i, j] = dphi[i, j]


@lang.kernel
def stretched(x: F2, out: F2):
    strain = green_strain(row(x, 0), row(x, 1))
    tension = tension_of(row(x, 2))
    for i in range(3):
        out[0, i] = strain[i]
        out[1, i] = tension[i]


@lang.kernel
def solid(x: F2, numbers: F1, out: F1, stresses: F3):
    g = _square(x, 0)
    memory = _square(x, 3)
    out[0] = energy_density(g, numbers[0], numbers[1], memory)
    stress = first_piola(g, numbers[0], numbers[1], memory)
    own = deviatoric(g)
    for i in range(3):
        for j in range(3):
            stresses[0, i, j] = stress[i, j]
            stresses[1, i, j] = own[i, j]


@lang.kernel
def blown_up(x: F2, out: F1):
    out[0] = swept(row(x, 0), row(x, 1), row(x, 2), row(x, 3), row(x, 4))
