"""Kernels of :mod:`sim_core.energies.neo_hookean`: strain, energy, forces, Hessian as it is and made positive."""

from sim_core.core import language as lang
from sim_core.core.language import F1, F2, F3, mat3
from sim_core.energies.neo_hookean_moduli import BULK, MU, OWN
from sim_core.energies.projection import negative_modes

HISTORY_J = 0.1
"""S_dev grows like 1/J; the memory of a point crushed below this J is taken as if it were at this J."""

# Places in the rows of constants that the kernels read, one an element: factors on W_dev and on the bulk energy, and a
# switch.
SHARE, BULK_SHARE, REMEMBERS = range(3)


@lang.func
def _cofactor(f: mat3):
    c = mat3(0.0)
    for i, j in lang.static(lang.ndrange(3, 3)):
        i1, i2, j1, j2 = lang.static((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3)
        c[i, j] = f[i1, j1] * f[i2, j2] - f[i1, j2] * f[i2, j1]
    return c


@lang.func
def _bilinear(g: mat3):
    """det(1 + G) - 1 - tr G, computed without cancellation."""
    return _cofactor(g).trace() + g.determinant()


@lang.func
def _memory(history: lang.template(), p):
    """H at quadrature point ``p`` from its components 11, 22, 33, 23, 13, 12 (a seventh is the memory of pressure)."""
    return mat3(
        [history[p, 0], history[p, 5], history[p, 4]],
        [history[p, 5], history[p, 1], history[p, 3]],
        [history[p, 4], history[p, 3], history[p, 2]],
    )


@lang.func
def _load(deformation: lang.template(), p):
    g = mat3(0.0)
    for i, j in lang.static(lang.ndrange(3, 3)):
        g[i, j] = deformation[p, i, j]
    return g


@lang.func
def energy_density(g: mat3, shear, pressure, memory: mat3):
    """Energy per volume at rest [Pa] at F = 1 + ``g``, with ``shear`` in place of mu, and the energy J - 1 times
    ``pressure`` and H : C / 2 of the ``memory`` H [Pa], but for its value at rest."""
    bilinear = _bilinear(g)
    theta = g.trace() + bilinear
    strain = g + g.transpose() + g.transpose() @ g
    density = shear * (0.5 * g.norm_sqr() - bilinear + theta * theta / 6.0)
    return density + pressure * theta + 0.5 * (memory * strain).sum()


@lang.func
def first_piola(g: mat3, shear, pressure, memory: mat3):
    """First Piola-Kirchhoff stress [Pa] at F = 1 + ``g``, with ``shear`` in place of mu, from the derivative
    ``pressure`` by J of all else and the ``memory`` H [Pa]."""
    one = lang.Matrix.identity(lang.f64, 3)
    f = one + g
    cof_g = _cofactor(g)
    theta = g.trace() + cof_g.trace() + g.determinant()
    # F - cof F = G + G^T - tr(G) 1 - cof G, which is small when G is.
    stress = shear * (g + g.transpose() - g.trace() * one - cof_g)
    return stress + (shear / 3.0 * theta + pressure) * _cofactor(f) + f @ memory


@lang.func
def _memory_at(history: lang.template(), constants: lang.template(), p):
    """H at quadrature point ``p``, zero where nothing is remembered."""
    memory = mat3(0.0)
    if constants[p // 4, REMEMBERS] > 0.0:
        memory = _memory(history, p)
    return memory


@lang.func
def deviatoric(g: mat3):
    """S_dev / mu = 1 + ((J - 1) / 3 - 1) cof(C) / J = f (1 + B) - B, with B = cof(C) - 1 and f = 4/3 (J - 1) / J, both
    of which are small when G is."""
    cof_g = _cofactor(g)
    theta = g.trace() + cof_g.trace() + g.determinant()
    one = lang.Matrix.identity(lang.f64, 3)
    change = g.trace() * one - g.transpose() + cof_g
    b = change + change.transpose() + change.transpose() @ change
    f = 4.0 / 3.0 * theta / (1.0 + theta)
    if 1.0 + theta < HISTORY_J:
        f = 1.0 + (theta / 3.0 - 1.0) / HISTORY_J
    return f * (one + b) - b


@lang.kernel
def projected_tangent(deformation: F3, dilatation: F1, history: F2, moduli: F2, constants: F2, modes: F2, out: F3):
    """Second derivative of the energy density by F (row by row) at each quadrature point [Pa].

    alpha 1(x)1 + 1(x)H + f'' dJ(x)dJ + f' d2J, less its negative eigenvalues.
    """
    lang.loop_config(serialize=True)
    for p in range(deformation.shape[0]):
        e = p // 4
        mu, bulk, share = moduli[e, MU], constants[e, BULK_SHARE] * moduli[e, BULK], constants[e, SHARE]
        g = _load(deformation, p)
        f = lang.Matrix.identity(lang.f64, 3) + g
        cof = _cofactor(f)
        alpha = share * mu
        slope = share * mu * ((g.trace() + _bilinear(g)) / 3.0 - 1.0) + bulk * dilatation[p] + history[p, 6]
        curvature = share * mu / 3.0 + bulk * moduli[e, OWN]
        memory = _memory_at(history, constants, p)
        for i in range(3):
            for k in range(3):
                # Block (i, k) of d2J is the skew matrix of row m of F, with the sign of (i, k, m).
                m = (6 - i - k) % 3
                turn = slope * (k - i) * (m - i) * (m - k) * 0.5
                same = lang.select(i == k, 1.0, 0.0)
                for j, n in lang.static(lang.ndrange(3, 3)):
                    value = curvature * cof[i, j] * cof[k, n] + same * memory[j, n]
                    if lang.static(j == n):
                        value += same * alpha
                    else:
                        value += turn * lang.static((n - j) * (3 - n - 2 * j) * (3 - 2 * n - j) // 2) * f[m, 3 - j - n]
                    out[p, 3 * i + j, 3 * k + n] = value
        negative_modes(modes, f, alpha, slope, curvature, memory, constants[e, REMEMBERS] > 0.0)
        for m in range(9):
            if modes[m, 9] < 0.0:
                mode = lang.Vector.zero(lang.f64, 9)
                for c in lang.static(range(9)):
                    mode[c] = modes[m, c]
                for r in range(9):
                    factor = modes[m, 9] * modes[m, r]
                    for c in lang.static(range(9)):
                        out[p, r, c] = out[p, r, c] - factor * mode[c]
