"""Host of the material laws that effects add to a body: from generalised strains to nodes, and back.

A law (:class:`sim_core.effects.hooks.MaterialLaw`) says what stress s it adds to an element of area A by the strain e
at the end of a step, the strain e_0 at its start and its internal variables z, and what these are then, z'. With the
strains e(x') and L = de/dx', the term of all laws of one strain measure is

    E = sum_T A_T w(e_T; e_0, z),    dE/dx' = L^T A s,    d2E/dx'^2 = L^T A (ds/de) L + A s . d2e/dx'^2

and its derivatives by anything else are those of the law and of the strains (:mod:`sim_core.energies.strain`). Without
``exact`` the tangents are made positive semidefinite one by one, so that any law may be added to any other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from sim_core.effects.hooks import MaterialLaw
from sim_core.energies.strain import Strain
from sim_core.energies.term import Internals, Quantity, counted

if TYPE_CHECKING:
    from sim_core.effects.base import Effect


class StrainLaws:
    """Term of all material laws of one strain ``measure`` of a body. Its numbers are those of the body's stiffness, and
    ``<key>.<parameter>`` of each law."""

    def __init__(self, name: str, measure: Strain) -> None:
        self.name, self.measure = name, measure
        self._laws: dict[str, MaterialLaw] = {}
        self._values: dict[str, dict[str, Any]] = {}
        self._shares: dict[str, np.ndarray] = {}
        self._given: dict[str, float] = {}

    def add(self, key: str, effect: Effect) -> None:
        """Take a law whose numbers are called ``<key>.<parameter>``."""
        if isinstance(effect, MaterialLaw):
            self._laws[key] = effect

    def numbers(self, body: Mapping[str, float], laws: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
        """What to configure the term with: of the numbers of the ``body``'s own term those of its stiffness, and the
        values of the laws by their keys."""
        graded = () if self.measure.own.grading is None else self.measure.own.grading.numbers
        own = {name: body[name] for name in (*(q.name for q in self.measure.quantities), *graded) if name in body}
        return {**own, **{f"{key}.{name}": value for key in self._laws for name, value in laws.get(key, {}).items()}}

    @property
    def laws(self) -> list[tuple[str, MaterialLaw, dict[str, Any]]]:
        """Keys, effects and the values of their parameters, numbers or ``(m,)``."""
        return [(key, law, self._values[key]) for key, law in self._laws.items()]

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What its elements differ in, and its other numbers."""
        laws = (
            Quantity(f"{key}.{p.name}", p.unit, shares=True) for key, law in self._laws.items() for p in law.parameters
        )
        graded = {} if self.measure.own.grading is None else self.measure.own.grading.numbers
        return (*self.measure.quantities, *(Quantity(name, unit) for name, unit in graded.items()), *laws)

    @counted
    def configure(self, parameters: Mapping[str, float]) -> None:
        self._given = dict(parameters)
        self._values = {
            key: {p.name: parameters[f"{key}.{p.name}"] * self.share(f"{key}.{p.name}") for p in law.parameters}
            for key, law in self._laws.items()
        }

    def scale_numbers(self, shares: Mapping[str, np.ndarray]) -> None:
        """Let each element have a share ``(m,)`` of what is configured, of some numbers of the laws."""
        self._shares = dict(shares)
        self.configure(self._given)

    def share(self, quantity: str) -> Any:
        """What its strains, or all of them, see of a number of the laws."""
        return self.measure.at_points(self._shares[quantity]) if quantity in self._shares else 1.0

    @property
    def lasting(self) -> tuple[str, ...]:
        """Names of the internal variables that last."""
        return tuple(f"{key}.{name}" for key, law in self._laws.items() for name in law.lasting)

    def initial_internals(self) -> Internals:
        count = len(self.measure.areas)
        return {
            f"{key}.{name}": np.zeros((count, *shape))
            for key, law in self._laws.items()
            for name, shape in law.state().items()
        }
