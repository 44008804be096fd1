"""Plastic flow of a triangle of a sheet within a step: the return mapping and its derivatives.

With the norm |kappa|_D = sqrt(kappa^T D kappa / D_11), in curvature, so that the mesh does not decide, a triangle is
elastic while n = |kappa_e|_D, kappa_e = kappa - kappa^p, stays below s = k_Y + H a. Beyond, with linear hardening H and
the accumulated plastic curvature a [1/m], a step that ends at kappa flows by

    g = (n - s) / (1 + H),    kappa^p' = kappa^p + g kappa_e / n,    a' = a + g,    m = D kappa_e (1 - g / n)

which is the least of D_11 [(n - g)^2 / 2 + s g + H g^2 / 2] over g >= 0: what is stored, and lost in the flow. The
least itself is the energy that the step minimises,

    W(kappa) = D_11 [n^2 / 2 - (n - s)_+^2 / (2 (1 + H))],    dW/dkappa = m,

convex and once continuously differentiable: the moment is on the yield surface at the end of every step, however
long it is. With H = 0 the moment stays at yield and nothing says where along a sheet it bends on. Ortiz & Stainier,
Comput. Methods Appl. Mech. Eng. 171, 1999; Simo & Hughes, Computational Inelasticity, box 3.1, written for moment and
curvature.
"""

from __future__ import annotations

import numpy as np

from sim_core.materials.elastic import applied

AT_YIELD = 1e-12
"""A triangle that is no further beyond s than this share of it is at yield, but for round-off: its derivatives are
those of going on elastically."""


class PlasticFlow:
    """Flow of all triangles. ``elastic``: kappa - kappa^p before it [1/m] ``(m, 3)``; ``onset``: s ``(m,)``;
    ``hardening``: H ``(m,)``; ``d``: D [N m], one of all ``(3, 3)`` or one each ``(m, 3, 3)``."""

    def __init__(self, elastic: np.ndarray, onset: np.ndarray, hardening: np.ndarray, d: np.ndarray) -> None:
        self._elastic, self._d, self._hardening = elastic, d, hardening
        moment = applied(d, elastic)
        norm = np.sqrt((elastic * moment).sum(axis=1) / d[..., 0, 0])
        excess = norm - onset
        self._far = np.where(norm > 0.0, norm, 1.0)
        self._flows = excess > AT_YIELD * onset
        self.amount = np.maximum(excess, 0.0) / (1.0 + hardening)
        """g [1/m] ``(m,)``."""
        self.direction = elastic / self._far[:, None]
        """kappa_e / n ``(m, 3)``."""
        self.slope = moment / (d[..., 0, 0] * self._far)[:, None]
        """dn/dkappa ``(m, 3)``."""
        self.rate = np.where(self._flows, 1.0 / (1.0 + hardening), 0.0)
        """dg/dn ``(m,)``."""
        self.left = elastic - self.amount[:, None] * self.direction
        """Elastic curvature after the flow [1/m] ``(m, 3)``."""

    def by_curvature(self) -> np.ndarray:
        """Derivative of the plastic curvature by kappa, ``(m, 3, 3)``."""
        outer = self.direction[:, :, None] * self.slope[:, None, :]
        turn = (self.amount / self._far)[:, None, None] * (np.eye(3) - outer)
        return np.asarray(self.rate[:, None, None] * outer + turn)

    def by_law(self, d: np.ndarray, onset: np.ndarray, hardening: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of plastic ``(m, 3)`` and accumulated curvature ``(m,)`` [1/m] along derivatives of D, of
        its shape, of s ``(m,)`` and of H ``(m,)``."""
        first, change = (matrix[..., :1, :1] for matrix in (self._d, d))
        metric = (d - self._d * change / first) / first
        grown = 0.5 * (self._elastic * applied(metric, self._elastic)).sum(axis=1) / self._far
        later = onset + hardening * self.amount
        rise = np.where(self._flows, grown - later, 0.0) / (1.0 + self._hardening)
        turned = (rise - self.amount * grown / self._far)[:, None] * self.direction
        return turned, rise
