"""A bonded disc by another method: axisymmetric linear elasticity, elements of high degree on a mesh that is graded
towards the rim's corners, where stress is singular."""

import itertools

import numpy as np
import scipy.sparse as sp
from numpy.polynomial import legendre
from scipy.sparse.linalg import spsolve


def _shapes(degree, points):
    """Lagrange polynomials on Lobatto points, and derivatives, at ``points`` in [-1, 1]."""
    inner = legendre.Legendre.basis(degree).deriv().roots()
    knots = np.concatenate([[-1.0], np.sort(inner.real), [1.0]])
    vandermonde = legendre.legvander(knots, degree)
    inverse = np.linalg.inv(vandermonde)
    slope = np.column_stack(
        [legendre.Legendre.basis(k).deriv()(points) if k else 0.0 * points for k in range(degree + 1)]
    )
    return legendre.legvander(points, degree) @ inverse, slope @ inverse


def bonded_disc(nu, shape_factor, degree=8, layers=8, ratio=0.25):
    """Apparent modulus over E of a disc of radius 1 whose plane faces are bonded to rigid plates; half its height.
    ``shape_factor``: R / (2 t)."""
    half = 0.25 / shape_factor
    grade = np.concatenate([[0.0], ratio ** np.arange(layers, -1, -1)])
    r_lines = np.unique(np.concatenate([np.linspace(0.0, 1.0 - half, 4)[:-1], 1.0 - half * grade]))
    z_lines = np.sort(half * (1.0 - grade))
    lam, mu = nu / (1 + nu) / (1 - 2 * nu), 0.5 / (1 + nu)
    c = np.array([[lam + 2 * mu, lam, lam, 0], [lam, lam + 2 * mu, lam, 0], [lam, lam, lam + 2 * mu, 0], [0, 0, 0, mu]])
    points, weights = legendre.leggauss(degree + 2)
    n, dn = _shapes(degree, points)
    nr, nz = (len(r_lines) - 1) * degree + 1, (len(z_lines) - 1) * degree + 1
    rows, columns, values = [], [], []
    for i, (r0, r1) in enumerate(itertools.pairwise(r_lines)):
        for j, (z0, z1) in enumerate(itertools.pairwise(z_lines)):
            r = 0.5 * (r0 + r1) + 0.5 * (r1 - r0) * points
            value = np.einsum("pa,qb->pqab", n, n).reshape(len(points), len(points), -1)
            by_r = np.einsum("pa,qb->pqab", dn, n).reshape(value.shape) * 2.0 / (r1 - r0)
            by_z = np.einsum("pa,qb->pqab", n, dn).reshape(value.shape) * 2.0 / (z1 - z0)
            zero = np.zeros_like(value)
            strain = np.stack(
                [
                    np.concatenate([by_r, zero], axis=-1),
                    np.concatenate([value / r[:, None, None], zero], axis=-1),
                    np.concatenate([zero, by_z], axis=-1),
                    np.concatenate([by_z, by_r], axis=-1),
                ],
                axis=2,
            )
            area = np.outer(weights * r, weights) * 0.25 * (r1 - r0) * (z1 - z0)
            local = np.einsum("pq,pqik,ij,pqjl->kl", area, strain, c, strain, optimize=True)
            a = (i * degree + np.arange(degree + 1))[:, None] * nz + j * degree + np.arange(degree + 1)
            dofs = np.concatenate([a.ravel(), nr * nz + a.ravel()])
            rows.append(np.repeat(dofs, len(dofs)))
            columns.append(np.tile(dofs, len(dofs)))
            values.append(local.ravel())
    size = 2 * nr * nz
    stiffness = sp.coo_matrix(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size)
    ).tocsr()
    node_r, node_z = np.divmod(np.arange(nr * nz), nz)
    top, middle, axis = node_z == nz - 1, node_z == 0, node_r == 0
    u, fixed = np.zeros(size), np.concatenate([axis | top, middle | top])
    u[nr * nz :][top] = -half  # unit strain
    free = ~fixed
    u[free] = spsolve(stiffness[free][:, free].tocsc(), -(stiffness[free][:, fixed] @ u[fixed]))
    force = -float((stiffness @ u)[nr * nz :][top].sum())
    return force / 0.5  # over pi R^2 / (2 pi)
