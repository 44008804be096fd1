"""Gels that are pressed beyond what their law holds.

The law of gels (:mod:`sim_core.energies.neo_hookean`) is a polynomial in F that lets an element turn inside out at a
finite force; behind that, forces fall to a fraction and mean nothing. A step after which, or on the way to which, the
volume of a gel is gone somewhere is refused. Before that the law gets too soft: with c = 1 - 2 nu, the force of a
uniaxial test is (J / s^2 - s) mu at the stretch s, with J = 1 - c (1 - s) / s, and stops to rise at the s for which
s^4 + 2 (1 + c) s = 3 c: at J = 0.37 for nu = 0.45, 1/3 for nu near 1/2 and 0.48 for nu = 0.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq

from sim_core.energies.element_volume import least_volumes
from sim_core.energies.neo_hookean import NeoHookean
from sim_core.errors import ConvergenceError
from sim_core.scene.scene import Scene


class ElementInverted(ConvergenceError):
    """A gel would turn inside out."""


@dataclass(frozen=True)
class LeastVolume:
    """The least share ``ratio`` that was left of the volume at rest at any point of a ``body``: at ``time`` [s], in the
    element around ``place`` [m] ``(3,)`` of its own coordinates. ``softening``: the share from which on the force of a
    uniaxial test falls."""

    body: str
    ratio: float
    time: float
    place: tuple[float, float, float]
    softening: float

    @property
    def sentence(self) -> str:
        """That the law was near its end."""
        return (
            f"{self.body} is pressed to {100.0 * self.ratio:.0f} % of its volume near {self._where} at "
            f"{self.time:.4g} s; below {100.0 * self.softening:.0f} % its law gets softer than any gel, and at 0 the "
            "simulation stops."
        )

    @property
    def _where(self) -> str:
        return "x = {:.4g} m, y = {:.4g} m, z = {:.4g} m of its own coordinates".format(*self.place)

    def refused(self) -> ElementInverted:
        """What is said of a step after which nothing, or less, would be left."""
        return ElementInverted(
            f"From t = {self.time:.4f} s on, {self.body} would turn inside out near {self._where}: nothing would be "
            "left of its volume there.",
            "End the motion there: the gel is pressed deeper than its law and its cells can follow. Finer cells, and a "
            "nu nearer to 0.5, hold longer.",
        )


@cache
def softening_volume(nu: float) -> float:
    """Share of the volume at rest at which the force of a uniaxial test stops to rise."""
    c = 1.0 - 2.0 * nu
    s = float(brentq(lambda stretch: stretch**4 + 2.0 * (1.0 + c) * stretch - 3.0 * c, 0.0, 1.0))
    return 1.0 - c * (1.0 - s) / s


def volumes_left(scene: Scene, path: np.ndarray, times: np.ndarray) -> list[LeastVolume]:
    """What is left of each gel's volume where that is least along a ``path`` of the nodes [m] ``(t, n, 3)``, straight
    from each place to the next; ``times`` [s] ``(t - 1,)``: at which it is at each place but the last."""
    found = []
    for name, body in scene.bodies.items():
        for term in body.terms:
            if isinstance(term, NeoHookean):
                least = least_volumes(term, path)
                step, worst = np.unravel_index(int(np.argmin(least)), least.shape)
                corners = term.tets[worst, :4] - int(body.nodes[0])
                x, y, z = body.local[corners].mean(axis=0).tolist()
                softening = softening_volume(float(np.max(term.poisson_ratios)))
                found.append(LeastVolume(name, float(least[step, worst]), float(times[step]), (x, y, z), softening))
    return found
