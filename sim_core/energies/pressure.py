"""Pressure that follows a surface: force p n da on the area and along the normal as they are at the end of the step.

Over a face with shape functions N_a of the coordinates xi, eta, sides g = dx/dxi and h = dx/deta,

    f_a = p int N_a g x h dxi deta

The work of these forces depends on the way only through the rim of the loaded surface (Bufler, Acta Mechanica 49, 1983:
uniform pressure has a potential, p times the volume swept, where the rim is held or the surface closed). A step
minimises the negative of the work along the straight way from its start, x_s + t u with 0 <= t <= 1,

    E = -p int u . [(g_s x h_s + g x h) / 3 + (g_s x h + g x h_s) / 6] dxi deta,    u = sum_a N_a (x_a - x_s,a)

which is a polynomial of the nodes and has a symmetric Hessian. Away from a free rim its forces are f_a exactly. At
the nodes of a free rim the part that has no potential is taken where the step starts, as friction takes its pressure;
the forces there miss f_a by the order of p L |u|, L the length of the edges: first order in the step, and nothing once
the body rests.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.energies.dead_load import Schedule
from sim_core.energies.linearised import Linearised, axes_of, placed, skew
from sim_core.energies.term import Buffers, Internals, Memoryless, StepContext
from sim_core.geometry.faces import face_rule


class Pressure(Memoryless):
    """Term of one pressure. ``faces``: int ``(m, 3)``, triangles, or ``(m, 6)``, quadratic faces; ``sign``: 1 along
    their normals, -1 against. Parameter: ``pressure_pa``."""

    mirrored = False
    measured_at_rest = False

    def __init__(self, name: str, faces: np.ndarray, sign: float, schedule: Schedule) -> None:
        self.name = name
        self._faces, self._sign, self._schedule = np.asarray(faces), sign, schedule
        self._rule = face_rule(self._faces.shape[1])
        self._pressure, self._now = 0.0, 0.0

    def blocks(self) -> np.ndarray:
        count = self._faces.shape[1]
        a, b = np.divmod(np.arange(count**2), count)
        return np.stack([self._faces[:, a], self._faces[:, b]], axis=-1).reshape(-1, 2)

    def bind(self, buffers: Buffers, slots: np.ndarray) -> None:
        self._buffers, self._slots = buffers, slots
        self._start = buffers.x[self._faces]
        self._sides_at_start = self._rule.sides(self._start)

    def configure(self, parameters: Mapping[str, float]) -> None:
        self._pressure = self._sign * parameters["pressure_pa"]

    def begin_step(self, step: StepContext, internals: Internals) -> None:
        del internals
        self._now = self._schedule.at_end_of(step)
        self._start = step.x_start[self._faces]
        self._sides_at_start = self._rule.sides(self._start)

    def _parts(self) -> tuple[np.ndarray, ...]:
        """u, its bracket, and derivatives of the bracket by g and by h as vectors whose cross product they are:
        ``(m, q, 3)`` each."""
        corners = self._buffers.x[self._faces]
        u = np.einsum("qa,mai->mqi", self._rule.shape, corners - self._start)
        (g, h), (g_s, h_s) = self._rule.sides(corners), self._sides_at_start
        swept = (np.cross(g_s, h_s) + np.cross(g, h)) / 3.0 + (np.cross(g_s, h) + np.cross(g, h_s)) / 6.0
        return u, swept, h / 3.0 + h_s / 6.0, g / 3.0 + g_s / 6.0

    def add_energy(self) -> None:
        u, swept, _, _ = self._parts()
        work = np.einsum("q,mqi,mqi->", self._rule.weights, u, swept)
        self._buffers.energy[0] -= self._now * self._pressure * float(work)

    def add_gradient(self) -> None:
        u, swept, by_g, by_h = self._parts()
        # u . (dg x k) = dg . (k x u),  u . (k x dh) = dh . (u x k)
        first = np.einsum("q,qa,mqi->mai", self._rule.weights, self._rule.shape, swept)
        sides = np.stack([np.cross(by_g, u), np.cross(u, by_h)], axis=-1)
        second = np.einsum("q,qad,mqid->mai", self._rule.weights, self._rule.slopes, sides)
        np.add.at(self._buffers.gradient, self._faces, -self._now * self._pressure * (first + second))

    def add_hessian(self, exact: bool) -> None:
        """Positive and negative values alike: none of it unless ``exact``."""
        if not exact or self._pressure == 0.0:
            return
        u, _, by_g, by_h = self._parts()
        w, n, (d, e) = self._rule.weights, self._rule.shape, np.moveaxis(self._rule.slopes, -1, 0)
        # du . (dg x by_g) + du . (by_h x dh) + u . (dg x dh) / 3, and the same with the two changes exchanged.
        half = _blocks(w, n, d, -skew(by_g)) + _blocks(w, n, e, skew(by_h)) + _blocks(w, d, e, -skew(u) / 3.0)
        whole = -self._now * self._pressure * (half + half.transpose(0, 3, 4, 1, 2))
        np.add.at(self._buffers.hessian, self._slots, whole.transpose(0, 1, 3, 2, 4).reshape(-1, 9))

    def linearise(self, step: StepContext, internals: Internals, after: Internals) -> Linearised:
        """Derivatives of dE/dx by where the step started."""
        del step, internals, after
        u, _, by_g, by_h = self._parts()
        (g, h), (g_s, h_s) = self._rule.sides(self._buffers.x[self._faces]), self._sides_at_start
        w, n, (d, e) = self._rule.weights, self._rule.shape, np.moveaxis(self._rule.slopes, -1, 0)
        whole = _blocks(w, n, d, -skew(h_s / 3.0 + h / 6.0)) + _blocks(w, n, e, skew(g_s / 3.0 + g / 6.0))
        whole += _blocks(w, d, n, -skew(by_g)) + _blocks(w, e, n, skew(by_h))
        whole += _blocks(w, d, e, -skew(u) / 6.0) + _blocks(w, e, d, skew(u) / 6.0)
        size, axes = 3 * self._faces.shape[1], axes_of(self._faces)
        blocks = -self._now * self._pressure * whole.reshape(-1, size, size)
        return Linearised(force_start=placed((blocks, axes, axes), shape=(self._buffers.x.size,) * 2))


def _blocks(weights: np.ndarray, left: np.ndarray, right: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """sum_q w_q left_a right_b matrix_ij as ``(m, k, 3, k, 3)``; shape functions or slopes ``(q, k)``, matrices
    ``(m, q, 3, 3)``."""
    return np.asarray(np.einsum("q,qa,qb,mqij->maibj", weights, left, right, matrices, optimize=True))
