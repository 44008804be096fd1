"""Work of a sheet's forces along nodal vectors, and what it and the sheet's memory know of its numbers.

With the strains e of a triangle (Green strains or curvatures), its area A, stiffness D and k = beta / tau,

    s = D e_e + k D (e - e_b),    work along v:  A s . de[v]

e_e is e, or what is left of it after plastic flow (:mod:`sim_core.energies.plastic_flow`), e_b from
:meth:`sim_core.energies.term.StepContext.base`. All derivatives are closed forms; those by numbers that act in the flow
have a part by the new internal variables, too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim_core.energies.linearised import places
from sim_core.energies.plastic_flow import PlasticFlow
from sim_core.energies.term import Internals
from sim_core.materials.elastic import applied


@dataclass(frozen=True)
class Flowing:
    """Plastic ``flow`` of the triangles in a step that began from ``internals``, with weights ``kept`` of the new
    internal variables, flattened."""

    flow: PlasticFlow
    internals: Internals
    kept: np.ndarray

    def weighted(self, turned: np.ndarray, rise: np.ndarray) -> np.ndarray:
        """Product, triangle by triangle ``(m,)``, of the weights with changes of the plastic ``(m, 3)`` and the
        accumulated curvature ``(m,)``."""
        place = places(self.internals)
        by_plastic = (self.kept[place["plastic_curvature"]] * turned).sum(axis=1)
        return np.asarray(by_plastic + self.kept[place["accumulated_curvature"]] * rise)


@dataclass(frozen=True)
class SheetAlong:
    """A step's end, of which the derivatives are by the values of the triangles, ``(m,)``. ``area`` [m^2] ``(m,)``;
    ``stiffness``: D ``(m, 3, 3)``, and ``slope``, which gives its derivative by nu; ``strain``: e, ``straining``: de
    along the vectors, and ``base``, which gives e_b, all ``(m, 3)``; ``damping``: beta [s] ``(m,)``; ``tau``: of the
    step [s]; ``flowing``: what flows (None: nothing can). Good for as long as the sheet does not go on: what is asked
    for is looked up then."""

    area: np.ndarray
    stiffness: np.ndarray
    slope: Callable[[], np.ndarray]
    strain: np.ndarray
    straining: np.ndarray
    base: Callable[[], np.ndarray]
    damping: np.ndarray
    tau: float
    flowing: Flowing | None = None
    law: np.ndarray | None = None
    """Stress of a law that is not D e, ``(m, 3)``: it is proportional to Young's modulus and knows no nu."""

    @cached_property
    def _since(self) -> np.ndarray:
        """e - e_b."""
        return np.asarray(self.strain - self.base())

    @cached_property
    def _stress(self) -> np.ndarray:
        """A D de[v] ``(m, 3)``, with which strains make work."""
        return np.asarray(self.area[:, None] * applied(self.stiffness, self.straining))

    @cached_property
    def _viscous(self) -> np.ndarray:
        """k (e - e_b), of which the triangles bear D times ``(m, 3)``."""
        if not self.damping.any():
            return np.zeros_like(self.strain)
        return np.asarray((self.damping / self.tau)[:, None] * self._since)

    @cached_property
    def _lasting(self) -> np.ndarray:
        """e_e + k (e - e_b), of which the triangles bear D times ``(m, 3)``; of another law the second part alone."""
        if self.law is not None:
            return self._viscous
        elastic = self.strain if self.flowing is None else self.flowing.flow.left
        return np.asarray(elastic + self._viscous)

    def work(self) -> np.ndarray:
        """Work of the forces dE/dx."""
        work = (self._stress * self._lasting).sum(axis=1)
        if self.law is not None:
            work += self.area * (self.law * self.straining).sum(axis=1)
        return np.asarray(work)

    def by(self, quantity: str) -> np.ndarray:
        """Derivative by a number, triangle by triangle."""
        ways = {
            "nu": self.by_nu,
            "stiffness_damping_s": self.by_damping,
            "yield_curvature_per_m": self.by_yield,
            "hardening_ratio": self.by_hardening,
        }
        return ways[quantity]()

    def by_nu(self) -> np.ndarray:
        """Derivative by Poisson's ratio of the work, and of the product of the new internal variables with their
        weights: by D, in the flow too."""
        slope = self.slope()
        found = self.area * (applied(slope, self.straining) * self._lasting).sum(axis=1)
        none = np.zeros(len(slope))
        return np.asarray(found + (0.0 if self.flowing is None else self._by_flow(slope, none, none)))

    def by_damping(self) -> np.ndarray:
        """Derivative by the stiffness damping [1/s] of the work: that of D (e - e_b) / tau."""
        return np.asarray((self._stress * self._since).sum(axis=1) / self.tau)

    def by_yield(self) -> np.ndarray:
        """Derivative by the curvature at which a triangle yields, of the same as by nu."""
        return self._by_flow(np.zeros_like(self.stiffness), np.ones(len(self.area)), np.zeros(len(self.area)))

    def by_hardening(self) -> np.ndarray:
        """Derivative by the hardening ratio, of the same."""
        assert self.flowing is not None, "nothing yields"
        accumulated = self.flowing.internals["accumulated_curvature"]
        return self._by_flow(np.zeros_like(self.stiffness), accumulated, np.ones(len(self.area)))

    def _by_flow(self, d: np.ndarray, later: np.ndarray, harder: np.ndarray) -> np.ndarray:
        """What flows more along derivatives of D in the norm, of the onset ``(m,)`` and of the hardening ``(m,)``."""
        assert self.flowing is not None, "nothing yields"
        turned, rise = self.flowing.flow.by_law(d, later, harder)
        return np.asarray(self.flowing.weighted(turned, rise) - (self._stress * turned).sum(axis=1))
