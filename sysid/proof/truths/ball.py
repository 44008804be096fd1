"""A rigid ball pressed on and slid over a bonded layer, with Coulomb friction, step by step, quasi-static.

Unknown at every point of the patch: the pressure p >= 0 and the friction q, |q| <= mu p, on the gel. With the ball's
slope s = grad z_b, forces act along its normal and in its tangent plane, and gaps are taken where points have come to:

    t = p (s_x, s_y, -1) + (q_x, q_y, q . s) + relaxation,    g = z_b(x + u_t) - u_z,
    0 <= p, 0 <= g, p g = 0;    q along the slip v of the ball over the gel where |q| = mu p, else v = 0.

The step is a fixed point of the projections p <- max(0, p - r g), q <- disc(q + r v) (Alart & Curnier, Comput. Methods
Appl. Mech. Eng. 92, 1991), found with Nesterov's acceleration restarted where it overshoots (O'Donoghue & Candes,
Found. Comput. Math. 15, 2015); the layer responds by :class:`sysid.proof.truths.layer.Surface`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from sysid.proof.truths.layer import Surface

Array = np.ndarray

MOST_ITERATIONS = 3000


class BallError(RuntimeError):
    """A step has no solution that the iteration finds."""


@dataclass(frozen=True)
class BallLaws:
    """``friction`` at the pressure ``at_pa``, times (p / at_pa)^-``fade``; ``excess``: static over kinetic, less one;
    ``branches``: share and time constant of stress that fades; ``work_j_m2``, ``range_m``: adhesion, attraction
    6 w / d s (1 - s) at the gap s d; ``stiffening``: relative rise of the modulus a depth of one thickness;
    ``soft``: relative extra compliance of a spot (x, y, radius [m]) of the surface, besides that of the layer."""

    friction: float
    fade: float = 0.0
    at_pa: float = 2e4
    excess: float = 0.0
    branches: tuple[tuple[float, float], ...] = ()
    work_j_m2: float = 0.0
    range_m: float = 1e-4
    stiffening: float = 0.0
    soft: float = 0.0
    spot: tuple[float, float, float] = (0.0, 0.0, 1e-3)


@dataclass
class Ball:
    """State of the contact between steps; positions of the ball are those of its lowest point, from the middle of the
    patch. ``compliance``: motion of the ball by the force on it [m/N]."""

    surface: Surface
    radius: float
    laws: BallLaws
    compliance: Array = field(default_factory=lambda: np.zeros((3, 3)))
    tolerance: float = 2e-5
    _p: Array = field(init=False)
    _q: Array = field(init=False)
    _u: Array = field(init=False)
    _springs: list[Array] = field(init=False)
    _held: Array = field(init=False)
    _at: Array | None = None
    pulled: Array = field(init=False)

    def __post_init__(self) -> None:
        n = self.surface.points
        self._p, self._q, self._u = np.zeros((n, n)), np.zeros((2, n, n)), np.zeros((3, n, n))
        self._springs = [np.zeros((3, n, n)) for _ in self.laws.branches]
        self._held = np.ones((n, n), dtype=bool)
        self.pulled = np.zeros((3, n, n))
        x, y, radius = self.laws.spot
        spot = np.exp(-((self.surface.x - x) ** 2 + (self.surface.y - y) ** 2) / radius**2)
        self._extra = self.laws.soft * spot * radius / self.surface.layer.shear

    def step(self, at: Array, dt: float) -> Array:
        """Move the ball to ``at`` (x, y, z) [m] in ``dt`` [s]; returns the tractions on the gel [Pa] ``(3, n, n)``.
        :attr:`pulled` then has the tractions of the elastic layer with this displacement."""
        at = np.asarray(at, dtype=float)
        self._at = at if self._at is None else self._at
        keep, gone = self._relaxing(dt)
        stiffer = 1.0 + self.laws.stiffening * max(-at[2], 0.0) / self.surface.layer.thickness
        scale = 1.0 / (keep * stiffer)
        gives = float(np.abs(self.compliance).max()) * (self.surface.points * self.surface.pitch) ** 2
        rate = 1.6 / ((self.surface.softest + float(np.abs(self._extra).max())) * scale + gives)
        p, q = self._p, self._q
        yp, yq, momentum = p, q, 1.0
        size = max(self.surface.layer.shear * abs(at[2]) / self.surface.layer.thickness, 1.0)
        for _ in range(MOST_ITERATIONS):
            _, _, _, gap, slip = self._respond(yp, yq, at, scale, gone)
            new_p = np.maximum(0.0, yp - rate * gap)
            new_q = self._disc(yq + rate * slip, new_p)
            change = max(float(np.abs(new_p - yp).max()), float(np.abs(new_q - yq).max()))
            if change < self.tolerance * max(float(new_p.max()), size):
                break
            uphill = np.vdot(yp - new_p, new_p - p) + np.vdot(yq - new_q, new_q - q)
            following = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * momentum**2)) if uphill <= 0.0 else 1.0
            weight = (momentum - 1.0) / following if uphill <= 0.0 else 0.0
            yp, yq = new_p + weight * (new_p - p), new_q + weight * (new_q - q)
            p, q, momentum = new_p, new_q, following
        else:
            raise BallError(f"change of {change:.2g} Pa after {MOST_ITERATIONS} iterations")
        traction, u, there, *_ = self._respond(new_p, new_q, at, scale, gone)
        self._advance(new_p, new_q, u, traction, gone, scale, dt, there)
        return traction

    def _relaxing(self, dt: float) -> tuple[float, Array]:
        """Share of the elastic stress that the step leaves, and the stress that has faded already."""
        keep, gone = 1.0, np.zeros_like(self._u)
        for (share, tau), spring in zip(self.laws.branches, self._springs, strict=True):
            ratio = dt / tau
            keep -= share * ratio / (1.0 + ratio)
            gone += share * spring / (1.0 + ratio)
        return keep, gone

    def _respond(
        self, p: Array, q: Array, at: Array, scale: float, gone: Array
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Tractions, displacements, place of the ball, gaps and slips for pressures and frictions."""
        x, y = self.surface.x + self._u[0] - at[0], self.surface.y + self._u[1] - at[1]
        depth = np.sqrt(np.maximum(self.radius**2 - x * x - y * y, (0.2 * self.radius) ** 2))
        sx, sy = x / depth, y / depth
        traction = np.stack([p * sx + q[0], p * sy + q[1], -p + q[0] * sx + q[1] * sy])
        if self.laws.work_j_m2:
            s = np.clip(self._gap(self._u, at) / self.laws.range_m, 0.0, 1.0)
            traction[2] += 6.0 * self.laws.work_j_m2 / self.laws.range_m * s * (1.0 - s)
        elastic = (traction + gone) * scale
        u = self.surface.displacement(elastic) + self._extra * elastic
        assert self._at is not None
        there = at - self.compliance @ (traction.sum(axis=(1, 2)) * self.surface.pitch**2)
        slip = (there - self._at)[:2, None, None] - (u[:2] - self._u[:2])
        return traction, u, there, self._gap(u, there), slip

    def _gap(self, u: Array, at: Array) -> Array:
        x, y = self.surface.x + u[0] - at[0], self.surface.y + u[1] - at[1]
        inside = np.maximum(self.radius**2 - x * x - y * y, 0.0)
        return np.asarray(at[2] + self.radius - np.sqrt(inside) - u[2])

    def _bound(self, p: Array) -> Array:
        bound = self.laws.friction * p
        if self.laws.fade:
            bound = bound * np.maximum(p / self.laws.at_pa, 1e-2) ** -self.laws.fade
        return np.asarray(bound * np.where(self._held, 1.0 + self.laws.excess, 1.0))

    def _disc(self, q: Array, p: Array) -> Array:
        length = np.hypot(q[0], q[1])
        return np.asarray(q * np.minimum(1.0, self._bound(p) / np.maximum(length, 1e-12)))

    def _advance(
        self, p: Array, q: Array, u: Array, traction: Array, gone: Array, scale: float, dt: float, at: Array
    ) -> None:
        full = np.hypot(q[0], q[1]) >= self._bound(p) * (1.0 - 1e-6)
        self._held = ~(full & (p > 0.0))
        self.pulled = (traction + gone) * scale
        for k, (_, tau) in enumerate(self.laws.branches):
            ratio = dt / tau
            self._springs[k] = (self._springs[k] + ratio * self.pulled) / (1.0 + ratio)
        self._p, self._q, self._u, self._at = p, q, u, at
