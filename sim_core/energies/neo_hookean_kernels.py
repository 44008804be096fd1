"""Kernels of :mod:`sim_core.energies.neo_hookean`: strain, energy, forces, Hessian as it is and made positive."""

import taichi as ti

from sim_core.energies.neo_hookean_moduli import BULK, MU, OWN
from sim_core.energies.projection import negative_modes
from sim_core.kernels import F1, F2, F3, I2, mat3, vec3

HISTORY_J = 0.1
"""S_dev grows like 1/J; the memory of a point crushed below this J is taken as if it were at this J."""

REGULAR_J = 0.05
"""Least J at all points of an element for which its Hessian is formed with a division by J."""

# Places in the rows of constants that the kernels read, one an element: factors on W_dev and on the bulk energy, and a
# switch.
SHARE, BULK_SHARE, REMEMBERS = range(3)


@ti.func
def _displacement_gradient(x: ti.template(), rest: ti.template(), tets: ti.template(), grad: ti.template(), p):
    """G = F - 1 at quadrature point ``p``, from displacements so that small strains keep their digits."""
    g = mat3(0.0)
    for a in range(10):
        n = tets[p // 4, a]
        for i in ti.static(range(3)):
            u = x[n, i] - rest[n, i]
            for j in ti.static(range(3)):
                g[i, j] += u * grad[p, a, j]
    return g


@ti.func
def _cofactor(f: mat3):
    c = mat3(0.0)
    for i, j in ti.static(ti.ndrange(3, 3)):
        i1, i2, j1, j2 = ti.static((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3)
        c[i, j] = f[i1, j1] * f[i2, j2] - f[i1, j2] * f[i2, j1]
    return c


@ti.func
def _bilinear(g: mat3):
    """det(1 + G) - 1 - tr G, computed without cancellation."""
    return _cofactor(g).trace() + g.determinant()


@ti.func
def _memory(history: ti.template(), p):
    """H at quadrature point ``p`` from its components 11, 22, 33, 23, 13, 12 (a seventh is the memory of pressure)."""
    return mat3(
        [history[p, 0], history[p, 5], history[p, 4]],
        [history[p, 5], history[p, 1], history[p, 3]],
        [history[p, 4], history[p, 3], history[p, 2]],
    )


@ti.kernel
def deform(x: F2, rest: F2, tets: I2, grad: F3, weight: F2, moduli: F2, deformation: F3, dilatation: F1):
    """G at each quadrature point, and the J - 1 that the bulk modulus sees there."""
    ti.loop_config(serialize=True)
    for e in range(tets.shape[0]):
        own, mean, whole = moduli[e, OWN], 0.0, 0.0
        for q in range(4):
            p = 4 * e + q
            g = _displacement_gradient(x, rest, tets, grad, p)
            for i, j in ti.static(ti.ndrange(3, 3)):
                deformation[p, i, j] = g[i, j]
            dilatation[p] = g.trace() + _bilinear(g)
            mean += weight[e, q] * dilatation[p]
            whole += weight[e, q]
        for q in range(4):
            dilatation[4 * e + q] = own * dilatation[4 * e + q] + (1.0 - own) * mean / whole


@ti.func
def _load(deformation: ti.template(), p):
    g = mat3(0.0)
    for i, j in ti.static(ti.ndrange(3, 3)):
        g[i, j] = deformation[p, i, j]
    return g


@ti.func
def energy_density(g: mat3, shear, pressure, memory: mat3):
    """Energy per volume at rest [Pa] at F = 1 + ``g``, with ``shear`` in place of mu, and the energy J - 1 times
    ``pressure`` and H : C / 2 of the ``memory`` H [Pa], but for its value at rest."""
    bilinear = _bilinear(g)
    theta = g.trace() + bilinear
    strain = g + g.transpose() + g.transpose() @ g
    density = shear * (0.5 * g.norm_sqr() - bilinear + theta * theta / 6.0)
    return density + pressure * theta + 0.5 * (memory * strain).sum()


@ti.func
def first_piola(g: mat3, shear, pressure, memory: mat3):
    """First Piola-Kirchhoff stress [Pa] at F = 1 + ``g``, with ``shear`` in place of mu, from the derivative
    ``pressure`` by J of all else and the ``memory`` H [Pa]."""
    one = ti.Matrix.identity(ti.f64, 3)
    f = one + g
    cof_g = _cofactor(g)
    theta = g.trace() + cof_g.trace() + g.determinant()
    # F - cof F = G + G^T - tr(G) 1 - cof G, which is small when G is.
    stress = shear * (g + g.transpose() - g.trace() * one - cof_g)
    return stress + (shear / 3.0 * theta + pressure) * _cofactor(f) + f @ memory


@ti.func
def _memory_at(history: ti.template(), constants: ti.template(), p):
    """H at quadrature point ``p``, zero where nothing is remembered."""
    memory = mat3(0.0)
    if constants[p // 4, REMEMBERS] > 0.0:
        memory = _memory(history, p)
    return memory


@ti.kernel
def add_energy(deformation: F3, dilatation: F1, history: F2, weight: F2, moduli: F2, constants: F2, out: F1):
    ti.loop_config(serialize=True)
    for e in range(weight.shape[0]):
        bulk, total = constants[e, BULK_SHARE] * moduli[e, BULK], 0.0
        shear = constants[e, SHARE] * moduli[e, MU]
        for q in range(4):
            p = 4 * e + q
            pressure = 0.5 * bulk * dilatation[p] + history[p, 6]
            density = energy_density(_load(deformation, p), shear, pressure, _memory_at(history, constants, p))
            total += weight[e, q] * density
        out[0] = out[0] + total


@ti.func
def _piola(
    deformation: ti.template(), dilatation: ti.template(), history: ti.template(), moduli: ti.template(),
    constants: ti.template(), p: ti.i32,
):  # fmt: skip
    """First Piola-Kirchhoff stress at quadrature point ``p`` [Pa]."""
    e = p // 4
    pressure = constants[e, BULK_SHARE] * moduli[e, BULK] * dilatation[p] + history[p, 6]
    shear = constants[e, SHARE] * moduli[e, MU]
    return first_piola(_load(deformation, p), shear, pressure, _memory_at(history, constants, p))


@ti.kernel
def add_gradient(
    deformation: F3, dilatation: F1, history: F2, tets: I2, grad: F3, weight: F2, moduli: F2, constants: F2, out: F2
):
    ti.loop_config(serialize=True)
    for p in range(grad.shape[0]):
        stress = _piola(deformation, dilatation, history, moduli, constants, p) * weight[p // 4, p % 4]
        for a in range(10):
            n = tets[p // 4, a]
            for i in ti.static(range(3)):
                force = stress[i, 0] * grad[p, a, 0] + stress[i, 1] * grad[p, a, 1] + stress[i, 2] * grad[p, a, 2]
                out[n, i] = out[n, i] + force


@ti.kernel
def along(deformation: F3, tets: I2, grad: F3, weight: F2, vectors: F2, works: F2, virtual: F2):
    """Derivatives along nodal vectors of each element's W_dev / mu, and of (J - 1)^2 / 2 point by point and of its mean
    ``works``; and w sym(F^T V), off the diagonal doubled, and w cof F : V at the points ``virtual``."""
    ti.loop_config(serialize=True)
    for e in range(tets.shape[0]):
        sheared, own, mean, swelling, whole = 0.0, 0.0, 0.0, 0.0, 0.0
        for q in range(4):
            p = 4 * e + q
            slope = mat3(0.0)
            for a in range(10):
                for i, j in ti.static(ti.ndrange(3, 3)):
                    slope[i, j] += vectors[tets[e, a], i] * grad[p, a, j]
            slope *= weight[e, q]
            g = _load(deformation, p)
            cof_g = _cofactor(g)
            f = ti.Matrix.identity(ti.f64, 3) + g
            theta = g.trace() + cof_g.trace() + g.determinant()
            swell = (_cofactor(f) * slope).sum()
            shear = g + g.transpose() - g.trace() * ti.Matrix.identity(ti.f64, 3) - cof_g
            sheared += (shear * slope).sum() + theta / 3.0 * swell
            own += theta * swell
            mean += weight[e, q] * theta
            swelling += swell
            whole += weight[e, q]
            strain = f.transpose() @ slope
            for k, i, j in ti.static(((0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 1, 2), (4, 0, 2), (5, 0, 1))):
                if ti.static(i == j):
                    virtual[p, k] = strain[i, i]
                else:
                    virtual[p, k] = strain[i, j] + strain[j, i]
            virtual[p, 6] = swell
        works[e, 0] = sheared
        works[e, 1] = own
        works[e, 2] = mean / whole * swelling


@ti.kernel
def along_then(x: F2, rest: F2, tets: I2, grad: F3, weight: F2, virtual: F2, works: F2):
    """What S_dev / mu and J - 1 at other positions ``x``, point by point and its mean, do along ``virtual`` strains of
    :func:`along`."""
    ti.loop_config(serialize=True)
    for e in range(tets.shape[0]):
        sheared, own, mean, swelling, whole = 0.0, 0.0, 0.0, 0.0, 0.0
        for q in range(4):
            p = 4 * e + q
            g = _displacement_gradient(x, rest, tets, grad, p)
            theta = g.trace() + _bilinear(g)
            s = deviatoric(g)
            for k, i, j in ti.static(((0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 1, 2), (4, 0, 2), (5, 0, 1))):
                sheared += virtual[p, k] * s[i, j]
            own += theta * virtual[p, 6]
            mean += weight[e, q] * theta
            swelling += virtual[p, 6]
            whole += weight[e, q]
        works[e, 0] = sheared
        works[e, 1] = own
        works[e, 2] = mean / whole * swelling


@ti.func
def deviatoric(g: mat3):
    """S_dev / mu = 1 + ((J - 1) / 3 - 1) cof(C) / J = f (1 + B) - B, with B = cof(C) - 1 and f = 4/3 (J - 1) / J, both
    of which are small when G is."""
    cof_g = _cofactor(g)
    theta = g.trace() + cof_g.trace() + g.determinant()
    one = ti.Matrix.identity(ti.f64, 3)
    change = g.trace() * one - g.transpose() + cof_g
    b = change + change.transpose() + change.transpose() @ change
    f = 4.0 / 3.0 * theta / (1.0 + theta)
    if 1.0 + theta < HISTORY_J:
        f = 1.0 + (theta / 3.0 - 1.0) / HISTORY_J
    return f * (one + b) - b


@ti.kernel
def projected_tangent(deformation: F3, dilatation: F1, history: F2, moduli: F2, constants: F2, modes: F2, out: F3):
    """Second derivative of the energy density by F (row by row) at each quadrature point [Pa].

    alpha 1(x)1 + 1(x)H + f'' dJ(x)dJ + f' d2J, less its negative eigenvalues.
    """
    ti.loop_config(serialize=True)
    for p in range(deformation.shape[0]):
        e = p // 4
        mu, bulk, share = moduli[e, MU], constants[e, BULK_SHARE] * moduli[e, BULK], constants[e, SHARE]
        g = _load(deformation, p)
        f = ti.Matrix.identity(ti.f64, 3) + g
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
                same = ti.select(i == k, 1.0, 0.0)
                for j, n in ti.static(ti.ndrange(3, 3)):
                    value = curvature * cof[i, j] * cof[k, n] + same * memory[j, n]
                    if ti.static(j == n):
                        value += same * alpha
                    else:
                        value += turn * ti.static((n - j) * (3 - n - 2 * j) * (3 - 2 * n - j) // 2) * f[m, 3 - j - n]
                    out[p, 3 * i + j, 3 * k + n] = value
        negative_modes(modes, f, alpha, slope, curvature, memory, constants[e, REMEMBERS] > 0.0)
        for m in range(9):
            if modes[m, 9] < 0.0:
                mode = ti.Vector.zero(ti.f64, 9)
                for c in ti.static(range(9)):
                    mode[c] = modes[m, c]
                for r in range(9):
                    factor = modes[m, 9] * modes[m, r]
                    for c in ti.static(range(9)):
                        out[p, r, c] = out[p, r, c] - factor * mode[c]


@ti.kernel
def add_projected(
    tangent: F3,
    deformation: F3,
    grad: F3,
    weight: F2,
    moduli: F2,
    constants: F2,
    slots: I2,
    columns: F2,
    volume: F1,
    local: F1,
    out: F1,
):
    """Add w B^T tangent B of each element, and of its mean dilatation, to the kept entries."""
    ti.loop_config(serialize=True)
    for e in range(weight.shape[0]):
        for q in range(4):
            p = 4 * e + q
            for r in range(9):
                row = ti.Vector.zero(ti.f64, 9)
                for c in ti.static(range(9)):
                    row[c] = weight[e, q] * tangent[p, r, c]
                for b in range(10):
                    b0, b1, b2 = grad[p, b, 0], grad[p, b, 1], grad[p, b, 2]
                    for k in ti.static(range(3)):
                        columns[3 * b + k, 9 * q + r] = row[3 * k] * b0 + row[3 * k + 1] * b1 + row[3 * k + 2] * b2
        for c in range(30):
            volume[c] = 0.0
        whole = 0.0
        for q in range(4):
            p = 4 * e + q
            cof = _cofactor(ti.Matrix.identity(ti.f64, 3) + _load(deformation, p)) * weight[e, q]
            whole += weight[e, q]
            for a in range(10):
                for i in ti.static(range(3)):
                    v = cof[i, 0] * grad[p, a, 0] + cof[i, 1] * grad[p, a, 1] + cof[i, 2] * grad[p, a, 2]
                    volume[3 * a + i] = volume[3 * a + i] + v
        stiffness = (1.0 - moduli[e, OWN]) * (constants[e, BULK_SHARE] * moduli[e, BULK]) / whole
        for a in range(10):
            ga = ti.Matrix.zero(ti.f64, 4, 3)
            for q, j in ti.static(ti.ndrange(4, 3)):
                ga[q, j] = grad[4 * e + q, a, j]
            va = stiffness * vec3(volume[3 * a], volume[3 * a + 1], volume[3 * a + 2])
            for c in range(3 * a, 30):
                entry = va * volume[c]
                for q in ti.static(range(4)):
                    for i, j in ti.static(ti.ndrange(3, 3)):
                        entry[i] += ga[q, j] * columns[c, 9 * q + 3 * i + j]
                for i in ti.static(range(3)):
                    local[30 * (3 * a + i) + c] = entry[i]
        block = 0
        for a in range(10):
            for b in range(a, 10):
                for i, k in ti.static(ti.ndrange(3, 3)):
                    at = slots[e, 9 * block + 3 * i + k]
                    if at >= 0:
                        out[at] = out[at] + local[90 * a + 30 * i + 3 * b + k]
                block += 1


@ti.kernel
def isotropic(history: F2, grad: F3, weight: F2, moduli: F2, constants: F2, out: F2):
    """Part of each block (a <= b) of an element's Hessian that is a multiple of 1: alpha ga.gb + ga.H gb [N/m].

    It does not depend on the positions, so it is kept until parameters or memory change.
    """
    ti.loop_config(serialize=True)
    for e in range(weight.shape[0]):
        alpha = constants[e, SHARE] * moduli[e, MU]
        block = 0
        for a in range(10):
            for b in range(a, 10):
                total = 0.0
                for q in ti.static(range(4)):
                    p = 4 * e + q
                    ga = vec3(grad[p, a, 0], grad[p, a, 1], grad[p, a, 2])
                    gb = vec3(grad[p, b, 0], grad[p, b, 1], grad[p, b, 2])
                    value = alpha * ga.dot(gb)
                    if constants[e, REMEMBERS] > 0.0:
                        value += ga.dot(_memory(history, p) @ gb)
                    total += weight[e, q] * value
                out[e, block] = total
                block += 1


@ti.kernel
def exact_hessian(
    deformation: F3, dilatation: F1, history: F2, grad: F3, weight: F2, moduli: F2, constants: F2, isotropic_part: F2,
    slots: I2, volume: F2, out: F1,
):  # fmt: skip
    """Add the unprojected Hessian of each element, block by block, to the kept entries.

    With v_a = cof(F) g_a the block of J's second derivative is the skew matrix of F (g_a x g_b) = v_a x v_b / J.
    ``slots``: place of each entry of each block a <= b, -1 where nobody needs it; ``volume``: scratch, v_a at the
    four points and its mean.
    """
    ti.loop_config(serialize=True)
    for e in range(weight.shape[0]):
        mu, bulk, own = moduli[e, MU], constants[e, BULK_SHARE] * moduli[e, BULK], moduli[e, OWN]
        share = constants[e, SHARE]
        curvature = ti.Vector.zero(ti.f64, 5)
        twist = ti.Vector.zero(ti.f64, 4)
        whole, least = 0.0, REGULAR_J
        for c in range(30):
            volume[4, c] = 0.0
        for q in ti.static(range(4)):
            p = 4 * e + q
            g = _load(deformation, p)
            cof = _cofactor(ti.Matrix.identity(ti.f64, 3) + g)
            theta = g.trace() + _bilinear(g)
            least = ti.min(least, 1.0 + theta)
            curvature[q] = weight[e, q] * (share * mu / 3.0 + bulk * own)
            twist[q] = weight[e, q] * (share * mu * (theta / 3.0 - 1.0) + bulk * dilatation[p] + history[p, 6])
            whole += weight[e, q]
            for a in range(10):
                v = cof @ vec3(grad[p, a, 0], grad[p, a, 1], grad[p, a, 2])
                for i in ti.static(range(3)):
                    volume[q, 3 * a + i] = v[i]
                    volume[4, 3 * a + i] += weight[e, q] * v[i]
        regular = least >= REGULAR_J
        if regular:
            for q in ti.static(range(4)):
                p = 4 * e + q
                g = _load(deformation, p)
                twist[q] /= 1.0 + g.trace() + _bilinear(g)
        curvature[4] = (1.0 - own) * bulk / whole
        block = 0
        for a in range(10):
            for b in range(a, 10):
                m = mat3(0.0)
                w = vec3(0.0)
                for q in ti.static(range(5)):
                    va = vec3(volume[q, 3 * a], volume[q, 3 * a + 1], volume[q, 3 * a + 2])
                    vb = vec3(volume[q, 3 * b], volume[q, 3 * b + 1], volume[q, 3 * b + 2])
                    scaled = curvature[q] * va
                    for i, k in ti.static(ti.ndrange(3, 3)):
                        m[i, k] += scaled[i] * vb[k]
                    if ti.static(q < 4):
                        if regular:
                            w += twist[q] * va.cross(vb)
                if not regular:
                    w = _twist(deformation, grad, twist, e, a, b)
                for i in ti.static(range(3)):
                    m[i, i] += isotropic_part[e, block]
                    j, k = ti.static((i + 1) % 3, (i + 2) % 3)
                    m[j, k] += w[i]
                    m[k, j] -= w[i]
                for i, k in ti.static(ti.ndrange(3, 3)):
                    at = slots[e, 9 * block + 3 * i + k]
                    if at >= 0:
                        out[at] = out[at] + m[i, k]
                block += 1


@ti.func
def _twist(deformation: ti.template(), grad: ti.template(), twist, e, a, b):
    """Sum of f' F (g_a x g_b) over the points of an element that is crushed or inside out."""
    w = vec3(0.0)
    for q in ti.static(range(4)):
        p = 4 * e + q
        ga = vec3(grad[p, a, 0], grad[p, a, 1], grad[p, a, 2])
        gb = vec3(grad[p, b, 0], grad[p, b, 1], grad[p, b, 2])
        w += twist[q] * ((ti.Matrix.identity(ti.f64, 3) + _load(deformation, p)) @ ga.cross(gb))
    return w


@ti.kernel
def deviatoric_stress(deformation: F3, moduli: F2, out: F2):
    """S_dev at each quadrature point [Pa]."""
    ti.loop_config(serialize=True)
    for p in range(deformation.shape[0]):
        s = moduli[p // 4, MU] * deviatoric(_load(deformation, p))
        for k, i, j in ti.static(((0, 0, 0), (1, 1, 1), (2, 2, 2), (3, 1, 2), (4, 0, 2), (5, 0, 1))):
            out[p, k] = s[i, j]
