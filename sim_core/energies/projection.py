"""The nearest positive semidefinite form of the second derivative of a solid's energy density.

For W = alpha/2 tr(F^T F) + f(J) + 1/2 H:C the second derivative by F is

    alpha 1 (x) 1 + 1 (x) H + f'' (dJ/dF)(dJ/dF)^T + f' d2J/dF2

In the frames of F = U S V^T it falls apart into three 2 x 2 blocks (the twist and flip modes) and one
3 x 3 block (the scaling modes): Smith, de Goes and Kim, ACM Trans. Graph. 37, 2018, and ACM
Trans. Graph. 38, 2019. A memory stress H that does not share the axes V adds an off-diagonal part O;
|O|_2 <= rho = sqrt(2/3) |O|_F since O is symmetric with zero trace, so the blocks are formed with
alpha - rho and 1 (x) (O + rho 1), which is positive semidefinite, is left as it is.
"""

from sim_core.core import language as lang
from sim_core.core.language import mat3, vec3

_PAIRS = ((0, 1), (0, 2), (1, 2))


@lang.func
def symmetric_eigen(matrix: mat3):
    """Eigenvalues and eigenvectors (columns, right-handed) of a symmetric matrix, by Jacobi rotations."""
    a = matrix
    v = lang.Matrix.identity(lang.f64, 3)
    small = 1e-33 * a.norm_sqr()
    sweep = 0
    while sweep < 15 and a[0, 1] ** 2 + a[0, 2] ** 2 + a[1, 2] ** 2 > small:
        sweep += 1
        for p, r in lang.static(_PAIRS):
            k = lang.static(3 - p - r)
            if a[p, r] != 0.0:
                theta = 0.5 * (a[r, r] - a[p, p]) / a[p, r]
                t = 1.0 / (lang.abs(theta) + lang.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / lang.sqrt(t * t + 1.0)
                s = t * c
                a[p, p] -= t * a[p, r]
                a[r, r] += t * a[p, r]
                a[p, r] = 0.0
                a[r, p] = 0.0
                kp, kr = a[k, p], a[k, r]
                a[k, p] = c * kp - s * kr
                a[p, k] = a[k, p]
                a[k, r] = s * kp + c * kr
                a[r, k] = a[k, r]
                for i in lang.static(range(3)):
                    vp, vr = v[i, p], v[i, r]
                    v[i, p] = c * vp - s * vr
                    v[i, r] = s * vp + c * vr
    return vec3(a[0, 0], a[1, 1], a[2, 2]), v


@lang.func
def _perpendicular(u: vec3):
    """Some unit vector perpendicular to the unit vector ``u``."""
    axis = vec3(1.0, 0.0, 0.0)
    if lang.abs(u[0]) > 0.6:
        axis = vec3(0.0, 1.0, 0.0)
    return (axis - axis.dot(u) * u).normalized()


@lang.func
def rotation_variant_svd(f: mat3):
    """F = U diag(s) V^T with rotations U, V; the smallest of ``s`` carries the sign of det F."""
    length, axes = symmetric_eigen(f.transpose() @ f)
    first = 0
    for k in lang.static(range(3)):
        if length[k] > length[first]:
            first = k
    last = (first + 1) % 3
    if length[(first + 2) % 3] < length[last]:
        last = (first + 2) % 3
    second = 3 - first - last
    v0 = vec3(axes[0, first], axes[1, first], axes[2, first])
    v1 = vec3(axes[0, second], axes[1, second], axes[2, second])
    v2 = v0.cross(v1)
    f0, f1, f2 = f @ v0, f @ v1, f @ v2
    u0 = vec3(1.0, 0.0, 0.0)
    if f0.norm_sqr() > 0.0:
        u0 = f0.normalized()
    f1 -= f1.dot(u0) * u0
    u1 = _perpendicular(u0)
    if f1.norm() > 1e-12 * f0.norm():
        u1 = f1.normalized()
    u2 = u0.cross(u1)
    s = vec3(u0.dot(f0), u1.dot(f1), u2.dot(f2))
    return lang.Matrix.cols([u0, u1, u2]), s, lang.Matrix.cols([v0, v1, v2])


@lang.func
def negative_modes(modes: lang.template(), f: mat3, alpha, slope, curvature, memory: mat3, relaxing):
    """Find the negative eigenvalues and unit eigenvectors of the second derivative.

    ``slope``, ``curvature``: f'(J) and f''(J) [Pa]. ``memory``: H [Pa], not read unless ``relaxing``.
    ``modes``: rows of a unit eigenvector (9 entries, row by row of F) and its eigenvalue, or zero if
    that is not negative.
    """
    u, s, v = rotation_variant_svd(f)
    stiffness = vec3(alpha, alpha, alpha)
    if relaxing:
        h = v.transpose() @ memory @ v
        rho = lang.sqrt(4.0 / 3.0 * (h[0, 1] ** 2 + h[0, 2] ** 2 + h[1, 2] ** 2))
        for i in lang.static(range(3)):
            stiffness[i] += h[i, i] - rho
    for k in range(3):
        i, j = (k + 1) % 3, (k + 2) % 3
        mean = 0.5 * (stiffness[i] + stiffness[j])
        half = 0.5 * (stiffness[j] - stiffness[i])
        cross = -slope * s[k]
        radius = lang.sqrt(half * half + cross * cross)
        x, y = 1.0, 0.0
        if radius > 0.0:
            x, y = half - radius, cross
            if half >= 0.0:
                x, y = -cross, half + radius
            length = lang.sqrt(x * x + y * y)
            x /= length
            y /= length
        modes[2 * k, 9] = lang.min(mean - radius, 0.0)
        modes[2 * k + 1, 9] = lang.min(mean + radius, 0.0)
        for r, c in lang.static(lang.ndrange(3, 3)):
            ij, ji = u[r, i] * v[c, j], u[r, j] * v[c, i]
            modes[2 * k, 3 * r + c] = x * ij + y * ji
            modes[2 * k + 1, 3 * r + c] = x * ji - y * ij
        modes[6 + k, 9] = 0.0
    scaling = mat3(0.0)
    for i in lang.static(range(3)):
        g = s[(i + 1) % 3] * s[(i + 2) % 3]
        scaling[i, i] = stiffness[i] + curvature * g * g
    for i, j in lang.static(_PAIRS):
        k = lang.static(3 - i - j)
        scaling[i, j] = s[k] * (slope + curvature * s[0] * s[1] * s[2])
        scaling[j, i] = scaling[i, j]
    minor = scaling[0, 0] * scaling[1, 1] - scaling[0, 1] ** 2
    if not (scaling[0, 0] > 0.0 and minor > 0.0 and scaling.determinant() > 0.0):
        values, vectors = symmetric_eigen(scaling)
        for k in range(3):
            modes[6 + k, 9] = lang.min(values[k], 0.0)
            for r, c in lang.static(lang.ndrange(3, 3)):
                modes[6 + k, 3 * r + c] = (
                    vectors[0, k] * u[r, 0] * v[c, 0]
                    + vectors[1, k] * u[r, 1] * v[c, 1]
                    + vectors[2, k] * u[r, 2] * v[c, 2]
                )
