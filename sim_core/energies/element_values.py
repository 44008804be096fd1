"""What the elements of a body have for themselves, in addition to the numbers of its material.

With the factor f of an element, those g of effects that grade the body from place to place and in time, and what an
element has in addition to the body's Poisson's ratio and stiffness damping,

    stiffness_e = f_e g_e stiffness,    nu_e = nu + dnu_e,    beta_e = beta + dbeta_e.

All of the energy of an element, damping included, is linear in its stiffness: factors weigh its area or volume.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from sim_core.energies.grading import Grading
from sim_core.energies.term import counted


class ElementValues(ABC):
    """The part of an elastic term that knows them. ``sizes``: area [m^2] ``(m,)`` of the elements, or volumes [m^3] of
    their quadrature points ``(m, k)``."""

    grading: Grading | None = None
    """Of effects that scale its stiffness from place to place."""

    def __init__(self, sizes: np.ndarray) -> None:
        count = len(sizes)
        self._whole_size: np.ndarray = sizes
        self._size: np.ndarray = sizes.copy()
        """Weighed by the factors; changed in place, since kernels hold it."""
        self._factors = np.ones(count)
        self._nu_shift, self._nu = np.zeros(count), np.zeros(count)
        self._damping, self._more_damping = np.zeros(count), np.zeros(count)
        self._given: dict[str, float] = {}

    @abstractmethod
    def configure(self, parameters: Mapping[str, float]) -> None:
        """As of any term."""

    @counted
    def scale(self, factors: np.ndarray) -> None:
        """Let each element have ``factors`` ``(m,)`` times the stiffness that is configured, and of its damping."""
        self._factors[:] = factors
        self._weigh()

    def grade(self, grading: Grading) -> None:
        """Let effects scale the stiffness of elements."""
        self.grading = grading

    def shift_nu(self, shift: np.ndarray) -> None:
        """Add ``shift`` ``(m,)`` to the configured Poisson's ratio, element by element."""
        self._nu_shift[:] = shift
        self.configure(self._given)

    def shift_damping(self, more: np.ndarray) -> None:
        """Let each element have ``more`` ``(m,)`` [s] more stiffness damping than configured."""
        self._more_damping[:] = more
        self.configure(self._given)

    @property
    def sizes(self) -> np.ndarray:
        """Areas of triangles [m^2] ``(m,)``, or volumes of quadrature points [m^3] ``(m, k)``, times the factors of
        their stiffness; changed in place."""
        return self._size

    @property
    def whole_sizes(self) -> np.ndarray:
        """The same without the factors."""
        return self._whole_size

    @property
    def damping(self) -> np.ndarray:
        """Damping by the rate of strain of the elements, beta [s] ``(m,)``."""
        return self._damping

    def _configure_grading(self, parameters: Mapping[str, float]) -> None:
        if self.grading is not None:
            self.grading.configure(parameters)
            self._weigh()

    def grade_at(self, time: float) -> None:
        """Take the factors of effects at a time [s]."""
        if self.grading is not None and self.grading.go_to(time):
            self._weigh()

    def _weigh(self) -> None:
        factors = self._factors if self.grading is None else self._factors * self.grading.factor
        self._size[:] = (self._whole_size.T * factors).T
