"""A fabric disc that hangs over a round table, by another method: a thin shell of splines along the radius and Fourier
series around it.

Positions x(r, t) of a flat disc, held where r <= b, with n equal folds: displacements along the radius and upwards are
series of cos(m n t), around it of sin(m n t), with B-splines of r as coefficients. The energy per area at rest is
that of Koiter (Kirchhoff & Love), strain E = (x,a . x,b - I) / 2 and curvature K = m . x,ab with the normal m,

    C / 2 ((E_rr + E_tt)^2 - 2 (1 - nu) det E) + D / 2 ((K_rr + K_tt)^2 - 2 (1 - nu) det K) + w z,
    C = 12 D / h^2,    w the weight per area

and its minimum is found by Newton's method, with negative curvatures of the energy taken as positive.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline


@dataclass(frozen=True)
class Draped:
    """``energy`` [J]; ``rim``: r and z of the rim [m] at angles from a crest of the folds to the next valley, ``(2,
    k)``; ``coefficient``: shadow of what hangs over, over its area; ``stable``: whether no fold of the same number
    takes energy out."""

    energy: float
    rim: np.ndarray
    coefficient: float
    stable: bool


def energy_slopes(q, law):
    """Energy per area and its derivatives by q ``(15, k)``: x,r  x,t / r  x,rr  x,rt / r  x,tt / r^2, as vectors."""
    bending, thickness, nu = law
    stretching = 12.0 * bending / thickness**2
    a, b, aa, ab, bb = q.reshape(5, 3, -1)
    normal = np.cross(a, b, axis=0)
    size = np.sqrt((normal**2).sum(axis=0))
    normal = normal / size
    e = [0.5 * ((a * a).sum(axis=0) - 1.0), 0.5 * ((b * b).sum(axis=0) - 1.0), 0.5 * (a * b).sum(axis=0)]
    k = [(normal * c).sum(axis=0) for c in (aa, bb, ab)]
    force, moment = (
        [c * (s[0] + nu * s[1]), c * (s[1] + nu * s[0]), 2.0 * c * (1.0 - nu) * s[2]]
        for c, s in ((stretching, e), (bending, k))
    )
    energy = 0.5 * sum(f * s for f, s in zip([*force, *moment], [*e, *k], strict=True))
    # By the normal: what is along it does not count, and it turns as a and b do.
    by_normal = moment[0] * aa + moment[1] * bb + moment[2] * ab
    by_normal = (by_normal - normal * (normal * by_normal).sum(axis=0)) / size
    by_a = force[0] * a + 0.5 * force[2] * b + np.cross(b, by_normal, axis=0)
    by_b = force[1] * b + 0.5 * force[2] * a + np.cross(by_normal, a, axis=0)
    return energy, np.stack([by_a, by_b, moment[0] * normal, moment[2] * normal, moment[1] * normal]).reshape(15, -1)


class Disc:
    """``law``: bending stiffness [N m], thickness [m], Poisson's ratio; ``weight``: per area [N/m^2]; ``radii``: of the
    table and of the disc [m]; ``folds``: their number; ``elements`` along the radius and ``waves`` around."""

    def __init__(self, law, weight, radii, folds, elements=8, waves=8, degree=5):
        self.law, self.weight, self.radii, self.folds = law, weight, radii, folds
        inner, outer = radii
        knots = np.concatenate([[inner] * degree, np.linspace(inner, outer, elements + 1), [outer] * degree])
        self.count = elements + degree
        points, by_r = np.polynomial.legendre.leggauss(degree + 1)
        lines = np.linspace(inner, outer, elements + 1)
        r = (0.5 * (lines[1:] + lines[:-1])[:, None] + 0.5 * np.diff(lines)[:, None] * points).ravel()
        by_r = (0.5 * np.diff(lines)[:, None] * by_r).ravel()
        around = 3 * waves + 4
        t = np.pi * (np.arange(around) + 0.5) / around / folds
        spline = BSpline(knots, np.eye(self.count), degree)
        self.r, self.t = (part.ravel() for part in np.meshgrid(r, t, indexing="ij"))
        self.area = np.repeat(by_r * r, around) * 2.0 * np.pi / around
        radial = np.stack([np.repeat(spline(r, order), around, axis=0) for order in range(3)])
        self.edge = spline(outer)
        self.matrix, self.height, self.fields = self._matrix(radial, waves)
        self.rest = self._rest()
        # Held: the first two splines have value and slope at the table.
        self.free = np.array([k >= 2 for _, _, k in self.fields])

    def _wave(self, part, order, t):
        """Derivative of an order of cos (part 0, 2) or sin (part 1) of m n t."""
        name, m = part
        w = m * self.folds
        return w**order * (np.sin if name == 1 else np.cos)(w * t + 0.5 * np.pi * order)

    def _matrix(self, radial, waves):
        """q as a linear function of the coefficients ``(15, k, n)``, height likewise, and what the coefficients are."""
        fields = [(p, m, k) for p in range(3) for m in range(p == 1, waves + 1) for k in range(self.count)]
        c, s, r = np.cos(self.t), np.sin(self.t), self.r
        zero = np.zeros_like(c)
        frame = {0: (np.array([c, s, zero]), np.array([-s, c, zero]), np.array([-c, -s, zero]))}
        frame[1] = (frame[0][1], frame[0][2], -frame[0][1])
        up = np.array([zero, zero, zero + 1.0])
        frame[2] = (up, 0.0 * up, 0.0 * up)
        rows, heights = [], []
        for part, m, k in fields:
            wave = [self._wave((part, m), order, self.t) for order in range(3)]
            v, dv, ddv = frame[part]
            one = v * wave[0]
            two = v * wave[1] + dv * wave[0]
            three = v * wave[2] + 2.0 * dv * wave[1] + ddv * wave[0]
            f = radial[:, :, k]
            rows.append(np.stack([f[1] * one, f[0] * two / r, f[2] * one, f[1] * two / r, f[0] * three / r**2]))
            heights.append(f[0] * one[2])
        return np.stack(rows, axis=-1).reshape(15, len(r), -1), np.stack(heights, axis=-1), fields

    def _rest(self):
        """q of the flat disc ``(15, k)``."""
        c, s = np.cos(self.t), np.sin(self.t)
        zero = np.zeros_like(c)
        e, f = np.array([c, s, zero]), np.array([-s, c, zero])
        return np.stack([e, f, 0.0 * e, f / self.r, -e / self.r]).reshape(15, -1)

    def evaluate(self, unknowns):
        """Energy [J], gradient and Hessian by the unknowns."""
        matrix, height = self.matrix[:, :, self.free], self.height[:, self.free]
        q = self.rest + matrix @ unknowns
        energy, slopes = energy_slopes(q, self.law)
        step = 1e-30
        bend = np.empty((15, *q.shape))
        for k in range(15):
            turned = q.astype(complex)
            turned[k] += 1j * step
            bend[k] = energy_slopes(turned, self.law)[1].imag / step
        total = self.area @ (energy + self.weight * (height @ unknowns))
        gradient = np.einsum("k,ik,ikn->n", self.area, slopes, matrix, optimize=True)
        gradient += self.weight * (self.area @ height)
        half = np.einsum("jik,k,ikn->kjn", bend, self.area, matrix, optimize=True)
        flat = matrix.transpose(1, 0, 2).reshape(-1, matrix.shape[2])
        return float(total), gradient, flat.T @ half.reshape(flat.shape)

    def drape(self, seed=0.02, most=200):
        """The minimum that is reached from a disc with folds of the height ``seed`` [m] at its rim."""
        inner, outer = self.radii
        greville = inner + (outer - inner) * np.linspace(0.0, 1.0, self.count)
        share = ((greville - inner) / (outer - inner)) ** 2
        unknowns = np.array(
            [
                -1.5 * seed * share[k] if (p, m) == (2, 0) else seed * share[k] if (p, m) == (2, 1) else 0.0
                for p, m, k in self.fields
            ]
        )[self.free]
        energy, gradient, hessian = self.evaluate(unknowns)
        reach = 0.01
        for _ in range(most):
            values, vectors = np.linalg.eigh(hessian)
            floor = 1e-9 * values.max()
            move = -vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), floor))
            fall = float(-gradient @ move)
            if values.min() > 0.0 and fall < 1e-13 * abs(energy):
                break
            move *= min(1.0, reach / np.abs(move).max())
            while True:
                tried = self.evaluate(unknowns + move)
                if tried[0] < energy + 1e-14 * abs(energy):
                    break
                move, reach = 0.5 * move, 0.5 * reach
                if np.abs(move).max() < 1e-12:
                    break
            reach = min(2.0 * max(reach, np.abs(move).max()), 0.02)
            unknowns = unknowns + move
            energy, gradient, hessian = tried
        return self._draped(unknowns, energy, bool(values.min() > 0.0))

    def _draped(self, unknowns, energy, stable):
        inner, outer = self.radii
        t = np.pi * np.linspace(0.0, 1.0, 201) / self.folds
        whole = np.zeros(len(self.fields))
        whole[self.free] = unknowns
        moved = np.zeros((3, len(t)))
        for value, (part, m, k) in zip(whole, self.fields, strict=True):
            moved[part] += value * self.edge[k] * self._wave((part, m), 0, t)
        r = np.hypot(outer + moved[0], moved[1])
        angle = t + np.arctan2(moved[1], outer + moved[0])
        shadow = 2.0 * self.folds * float(np.sum(0.25 * (r[1:] ** 2 + r[:-1] ** 2) * np.diff(angle)))
        flat = np.pi * (outer**2 - inner**2)
        return Draped(energy, np.stack([r, moved[2]]), (shadow - np.pi * inner**2) / flat, stable)
