"""Laws of a planar rod: bending moment over curvature with memory, and contact with a table.

Each law is evaluated at the end of an implicit step of length dt and returns value and tangent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

Array = np.ndarray


@dataclass
class Bending:
    """Moment M of a rod with the stiffness B = E I [N m^2] at every vertex.

        M = B (kappa - kappa_0 - kappa_p + t_d dkappa/dt + sum_i g_i z_i)

    - plastic curvature kappa_p: |M_e - h B kappa_p| <= B kappa_y with M_e = B (kappa - kappa_0 - kappa_p), linear
      hardening of the ratio h (Simo & Hughes, Computational Inelasticity, 1998, box 1.5);
    - Maxwell branches: dz_i/dt = dkappa/dt - z_i / tau_i, so that B is the stiffness in slow motion;
    - Kelvin-Voigt damping with the time t_d.

    ``softening_per_m``: curvature kappa_s with which the elastic part turns into M_e = B kappa / sqrt(1 + (kappa /
    kappa_s)^2), a law that no library of effects has to know.
    """

    stiffness: Array
    damping_s: float = 0.0
    rest: Array | float = 0.0
    yield_per_m: float = math.inf
    hardening: float = 0.2
    branches: tuple[tuple[float, float], ...] = ()
    softening_per_m: float = math.inf
    plastic: Array = field(init=False)
    springs: list[Array] = field(init=False)
    _curvature: Array = field(init=False)

    def __post_init__(self) -> None:
        self.plastic = np.zeros_like(self.stiffness)
        self.springs = [np.zeros_like(self.stiffness) for _ in self.branches]
        self._curvature = np.zeros_like(self.stiffness)

    def _flow(self, curvature: Array) -> tuple[Array, Array]:
        """Plastic curvature at the end of the step, and its derivative by the curvature."""
        if math.isinf(self.yield_per_m):
            return self.plastic, np.zeros_like(curvature)
        excess = curvature - self.rest - (1.0 + self.hardening) * self.plastic
        over = np.maximum(np.abs(excess) - self.yield_per_m, 0.0)
        slope = np.where(over > 0.0, 1.0 / (1.0 + self.hardening), 0.0)
        return self.plastic + np.sign(excess) * over * slope, slope

    def moment(self, curvature: Array, rate: Array, dt: float, *, rate_slope: float) -> tuple[Array, Array]:
        """Moment [N m] and its derivative by the curvature; ``rate_slope``: derivative of the rate by it."""
        plastic, flow = self._flow(curvature)
        elastic = curvature - self.rest - plastic
        slope = 1.0 - flow
        if not math.isinf(self.softening_per_m):
            root = np.sqrt(1.0 + (elastic / self.softening_per_m) ** 2)
            elastic, slope = elastic / root, slope / root**3
        total, slope = elastic + self.damping_s * rate, slope + self.damping_s * rate_slope
        for (share, tau), spring in zip(self.branches, self.springs, strict=True):
            keep = 1.0 / (1.0 + dt / tau) if dt else 1.0
            part = 0.0 if not dt else keep
            total = total + share * (keep * spring + part * (curvature - self._curvature))
            slope = slope + share * part
        return self.stiffness * total, self.stiffness * slope

    def advance(self, curvature: Array, dt: float) -> None:
        """Accept the end of a step (``dt`` of 0: an equilibrium reached in infinite time)."""
        self.plastic = self._flow(curvature)[0].copy()
        for k, (_, tau) in enumerate(self.branches):
            keep = 1.0 / (1.0 + dt / tau) if dt else 0.0
            self.springs[k] = keep * (self.springs[k] + curvature - self._curvature)
        self._curvature = curvature.copy()


@dataclass
class Table:
    """Contact of nodes with the plane z = ``height`` and dry friction with true stick.

    Normal force k max(0, height - z); tangential force -k (x - x_stick), at most mu N. A node that held at the end of
    the last step may hold up to (1 + ``excess``) mu N. The stiffness k [N/m] is far above that of the rod.
    """

    friction: float
    excess: float = 0.0
    height: float = 0.0
    stiffness: float = 2e4
    _stick: Array | None = None
    _held: Array | None = None

    def start(self, x: Array) -> None:
        """Forget all contact; every node would stick where it is."""
        self._stick = x.copy()
        self._held = np.ones(len(x), dtype=bool)

    def force(self, x: Array, z: Array) -> tuple[Array, Array]:
        """Forces on the nodes [N], shape ``(n, 2)``, and their derivatives by the positions, ``(n, 2, 2)``."""
        assert self._stick is not None and self._held is not None
        depth = np.maximum(self.height - z, 0.0)
        touching = depth > 0.0
        normal = self.stiffness * depth
        mu = self.friction * np.where(self._held, 1.0 + self.excess, 1.0)
        trial = -self.stiffness * (x - self._stick)
        slides = np.abs(trial) > mu * normal
        tangential = np.where(slides, np.sign(trial) * mu * normal, trial)
        force = np.column_stack([np.where(touching, tangential, 0.0), normal])
        slope = np.zeros((len(x), 2, 2))
        slope[:, 1, 1] = -self.stiffness * touching
        slope[:, 0, 0] = -self.stiffness * (touching & ~slides)
        slope[:, 0, 1] = np.where(touching & slides, -np.sign(trial) * mu * self.stiffness, 0.0)
        return force, slope

    def advance(self, x: Array, z: Array) -> None:
        """Accept the end of a step: nodes that slid stick from where they came to be."""
        assert self._stick is not None and self._held is not None
        force, _ = self.force(x, z)
        touching = z < self.height
        mu = self.friction * np.where(self._held, 1.0 + self.excess, 1.0)
        slid = touching & (np.abs(force[:, 0]) >= mu * force[:, 1] * (1.0 - 1e-9))
        self._stick = np.where(touching, x + force[:, 0] / self.stiffness, x)
        self._held = ~slid
