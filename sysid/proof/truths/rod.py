"""Planar geometrically exact rod without stretch and shear, clamped to a moving hand, in its tangent angles.

Unknowns are the angles theta_k of ``n`` straight elements of the length l; they and the hand give positions

    r_j = r_hand + l sum_{k <= j} (cos theta_k, sin theta_k),

so the rod can neither stretch nor shear (Antman, Nonlinear Problems of Elasticity, 2005, ch. 4: the elastica). With the
consistent mass matrix m of linear elements, the forces f at the nodes and n_k = (-sin theta_k, cos theta_k),

    l n_k . sum_{j >= k} (m a - f)_j + M_k - M_{k+1} = 0,

where M_k is the moment at the vertex before element k (:mod:`sysid.proof.truths.rod_laws`), of the curvature
(theta_k - theta_{k-1}) / l, at the clamp (theta_1 - theta_hand) / (l / 2). Time: BDF2 of the positions,
a = 9 / (4 dt^2) (r - r*). Newton's method on dense matrices, since n is about 80.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from sysid.proof.truths.rod_laws import Bending, Table

Array = np.ndarray

AIR_DENSITY_KG_M3 = 1.2
MOST_ITERATIONS = 80
TOLERANCE = 1e-7
"""Greatest residual of the moments, over B / L."""


class RodError(RuntimeError):
    """A step has no solution that Newton's method finds."""


@dataclass(frozen=True)
class RodShape:
    """Sizes of a strip bent in one plane: free length L and width [m], mass per length [kg/m] and bending stiffness
    E I [N m^2] as functions of the arc length s / L."""

    length: float
    width: float
    mass: Callable[[Array], Array]
    stiffness: Callable[[Array], Array]
    elements: int = 80


@dataclass(frozen=True)
class RodState:
    """What sensors may see at one instant: node positions [m] ``(n + 1, 2)``, velocities, the force [N] and the moment
    about the hand [N m] that the rod exerts on the hand, and the greatest contact force [N]."""

    position: Array
    angle: Array
    velocity: Array
    force: Array
    moment: float
    contact: float


class _Residual(NamedTuple):
    """Moments [N m] out of balance, force beyond each element [N], slopes of the moments by curvature, normals of the
    elements, derivatives of the nodal forces."""

    moments: Array
    tail: Array
    tangent: Array
    normal: Array
    slope: Array | None


class Rod:
    """A rod in motion. ``hand``: (x, z, angle) at a time [s]; ``gravity``: (g_x, g_z); ``air``: pressure factor C_D;
    ``cushion``: viscosity times a geometric factor [N s m] of a squeezed air film, outside any library; ``table``:
    None where nothing is to be touched."""

    def __init__(
        self,
        shape: RodShape,
        bending: Callable[[Array], Bending],
        hand: Callable[[float], Array],
        *,
        gravity: tuple[float, float] = (0.0, -9.81),
        table: Table | None = None,
        air: float = 0.0,
        cushion: float = 0.0,
    ) -> None:
        n = shape.elements
        self.shape, self.hand, self.table, self.air, self.cushion = shape, hand, table, air, cushion
        self.gravity = np.array(gravity)
        self.piece = shape.length / n
        middle = (np.arange(n) + 0.5) / n
        vertex = np.arange(n) / n
        self.bending = bending(shape.stiffness(vertex))
        self._spans = np.full(n, self.piece)
        self._spans[0] = self.piece / 2
        m = shape.mass(middle) * self.piece
        self._mass = np.zeros((n + 1, n + 1))
        k = np.arange(n)
        for a, b, share in ((0, 0, 3), (1, 1, 3), (0, 1, 6), (1, 0, 6)):
            self._mass[k + a, k + b] += m / share
        tail = np.cumsum(np.cumsum(self._mass[::-1, ::-1], axis=0), axis=1)[::-1, ::-1]
        self._tails = tail[1:, 1:]
        self._later = np.maximum.outer(k, k)
        self._area = shape.width * self.piece * np.r_[0.5, np.ones(n - 1), 0.5]
        self._weight = self._mass @ np.tile(self.gravity, (n + 1, 1))
        self._scale = float(self.bending.stiffness.max()) / shape.length

    def settle(self, t: float = 0.0, load_steps: int = 8) -> RodState:
        """Equilibrium under gravity with the hand held, away from the table; the history begins there."""
        hand = np.asarray(self.hand(t), dtype=float)
        self._angle, self._hand_angle = np.full(self.shape.elements, hand[2]), float(hand[2])
        self._r = self._place(self._angle, hand[:2])
        self._kappa = self._curvature(self._angle, hand[2])
        if self.table is not None:
            self.table.start(self._r[:, 0])
        for step in range(load_steps):
            self._angle = self._solve(hand, 0.0, self._r, (step + 1) / load_steps)
        self._r = self._r_before = self._place(self._angle, hand[:2])
        self._v = self._v_before = np.zeros_like(self._r)
        self._kappa = self._kappa_before = self._curvature(self._angle, hand[2])
        return self._accept(self._r, self._kappa, self._v, 0.0)

    def step(self, t: float, dt: float) -> RodState:
        """Go to the time ``t`` [s] by one step of ``dt``; all steps of a run are equally long."""
        hand = np.asarray(self.hand(t), dtype=float)
        guess = (4 * self._r - self._r_before) / 3 + 2 * dt / 9 * (4 * self._v - self._v_before)
        angle = self._solve(hand, dt, guess, 1.0)
        r, kappa = self._place(angle, hand[:2]), self._curvature(angle, hand[2])
        v = (3 * r - 4 * self._r + self._r_before) / (2 * dt)
        state = self._accept(r, kappa, 9 / (4 * dt * dt) * (r - guess), dt)
        self._angle, self._hand_angle = angle, float(hand[2])
        self._r_before, self._r = self._r, r
        self._v_before, self._v = self._v, v
        self._kappa_before, self._kappa = self._kappa, kappa
        return replace(state, angle=angle, velocity=v)

    def _place(self, angle: Array, at: Array) -> Array:
        r = np.empty((len(angle) + 1, 2))
        r[0] = at
        r[1:, 0] = at[0] + self.piece * np.cumsum(np.cos(angle))
        r[1:, 1] = at[1] + self.piece * np.cumsum(np.sin(angle))
        return r

    def _curvature(self, angle: Array, hand_angle: float) -> Array:
        return np.asarray(np.diff(angle, prepend=hand_angle) / self._spans)

    def _solve(self, hand: Array, dt: float, guess: Array, load: float) -> Array:
        """Newton's method with a line search on the norm of the residual."""
        angle = self._angle.copy()
        if dt:
            angle += hand[2] - self._hand_angle
        value = self._residual(angle, hand, dt, guess, load)
        norm = float(np.linalg.norm(value.moments))
        for _ in range(MOST_ITERATIONS):
            if np.abs(value.moments).max() < TOLERANCE * self._scale:
                break
            direction = lu_solve(lu_factor(self._jacobian(value, angle, dt), check_finite=False), -value.moments)
            share = min(1.0, 0.5 / max(float(np.abs(direction).max()), 1e-30))
            for _ in range(12):
                trial = angle + share * direction
                new = self._residual(trial, hand, dt, guess, load)
                new_norm = float(np.linalg.norm(new.moments))
                if new_norm < (1.0 - 1e-4 * share) * norm:
                    break
                share *= 0.5
            angle, value, norm = trial, new, new_norm
        else:
            left = np.abs(value.moments).max() / self._scale
            if left > 1e2 * TOLERANCE:
                raise RodError(f"residual {left:.1e} after {MOST_ITERATIONS} iterations")
        return np.asarray(angle)

    def _forces(self, r: Array, dt: float) -> tuple[Array, Array | None, float]:
        """Forces of contact and air on the nodes, their derivatives by the positions, and the greatest contact."""
        force, slope, most = np.zeros_like(r), None, 0.0
        if self.table is not None and r[:, 1].min() < self.table.height:
            force, slope = self.table.force(r[:, 0], r[:, 1])
            force[0] = slope[0] = 0.0
            most = float(force[:, 1].max())
        if dt and (self.air or self.cushion):
            v = (3 * r - 4 * self._r + self._r_before) / (2 * dt)
            slope = np.zeros((len(r), 2, 2)) if slope is None else slope
            if self.air:
                along = np.gradient(self._r, axis=0)
                normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
                speed = np.einsum("ij,ij->i", v, normal)
                c = 0.5 * AIR_DENSITY_KG_M3 * self.air * self._area
                force = force - (c * np.abs(speed) * speed)[:, None] * normal
                slope = slope - (2 * c * np.abs(speed) * 1.5 / dt)[:, None, None] * (
                    normal[:, :, None] * normal[:, None, :]
                )
            if self.cushion and self.table is not None:
                gap = np.maximum(self._r[:, 1] - self.table.height, 3e-4)
                c = self.cushion * self._area / gap**3 * (gap < 0.05)
                force[:, 1] -= c * v[:, 1]
                slope[:, 1, 1] -= c * 1.5 / dt
        return force, slope, most

    def _residual(self, angle: Array, hand: Array, dt: float, guess: Array, load: float) -> _Residual:
        r = self._place(angle, hand[:2])
        force, slope, _ = self._forces(r, dt)
        net = -force - load * self._weight
        if dt:
            net = net + 9 / (4 * dt * dt) * (self._mass @ (r - guess))
        tail = np.cumsum(net[:0:-1], axis=0)[::-1]
        curvature = self._curvature(angle, hand[2])
        if dt:
            rate = (3 * curvature - 4 * self._kappa + self._kappa_before) / (2 * dt)
        else:
            rate = np.zeros_like(curvature)
        moment, tangent = self.bending.moment(curvature, rate, dt, rate_slope=1.5 / dt if dt else 0.0)
        normal = np.column_stack([-np.sin(angle), np.cos(angle)])
        out = self.piece * np.einsum("ij,ij->i", normal, tail) + moment
        out[:-1] -= moment[1:]
        return _Residual(out, tail, tangent, normal, slope)

    def _jacobian(self, value: _Residual, angle: Array, dt: float) -> Array:
        _, tail, tangent, normal, slope = value
        h = np.zeros((len(angle), len(angle)))
        if dt:
            h += (9 / (4 * dt * dt) * self.piece**2) * self._tails * (normal @ normal.T)
        if slope is not None:
            later = np.cumsum(slope[:0:-1], axis=0)[::-1]
            for a in range(2):
                for b in range(2):
                    h -= self.piece**2 * np.outer(normal[:, a], normal[:, b]) * later[self._later, a, b]
        k = np.arange(len(angle))
        h[k, k] -= self.piece * (np.cos(angle) * tail[:, 0] + np.sin(angle) * tail[:, 1])
        stiff = tangent / self._spans
        h[k, k] += stiff
        h[k[:-1], k[:-1]] += stiff[1:]
        h[k[1:], k[:-1]] -= stiff[1:]
        h[k[:-1], k[1:]] -= stiff[1:]
        return h

    def _accept(self, r: Array, curvature: Array, acceleration: Array, dt: float) -> RodState:
        """Forces at the end of a step; the memories of the laws go on from it."""
        force, _, most = self._forces(r, dt)
        net = self._weight - self._mass @ acceleration + force
        arm = r - r[0]
        moment = float(np.sum(arm[:, 0] * net[:, 1] - arm[:, 1] * net[:, 0]))
        self.bending.advance(curvature, dt)
        if self.table is not None:
            self.table.advance(r[:, 0], r[:, 1])
        return RodState(r, self._angle, np.zeros_like(r), net.sum(axis=0), moment, most)


def cantilever_frequency(stiffness: float, mass: float, length: float) -> float:
    """First natural frequency [Hz] of a cantilever: (1.8751)^2 / (2 pi L^2) sqrt(B / m)."""
    return 1.875104068711961**2 / (2 * math.pi * length**2) * math.sqrt(stiffness / mass)
