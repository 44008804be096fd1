"""Laws that effects add to one contact term (:class:`sim_core.effects.hooks.NormalLaw`, ``FrictionLaw``).

With the pressure p_0 of :mod:`sim_core.contact.pressure_and_friction` and the pressures p_i and factors f_i of the
effects,

    p = p_0 + sum_i p_i,    friction bound = mu lambda_n prod_i f_i(lambda_n / A, slip speed),    lambda_n = A p_0

p_i of a law that bonds counts where the surfaces have touched and were not torn off since.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from sim_core.core.pointwise import Law
from sim_core.effects.hooks import FrictionLaw, NormalLaw

if TYPE_CHECKING:
    from sim_core.effects.base import Effect


@dataclass(frozen=True)
class Formula:
    """A law as its formula, with its numbers in the order of the arguments: their names among those of the term, and
    their values."""

    kind: Literal["pressure", "bond", "friction"]
    law: Law
    numbers: tuple[str, ...]
    values: tuple[float, ...]


class AddedLaws:
    """The laws of one term, with their numbers. ``bears``: whether the term's points bear the contact; others carry no
    pressure that effects add."""

    def __init__(self, bears: bool = True) -> None:
        self._bears = bears
        self._normal: dict[str, NormalLaw] = {}
        self._friction: dict[str, FrictionLaw] = {}
        self._values: dict[str, dict[str, float]] = {}

    def add(self, key: str, effect: Effect) -> None:
        """Take a law whose numbers are called ``<key>.<parameter>``."""
        if isinstance(effect, NormalLaw) and self._bears:
            self._normal[key] = effect
        if isinstance(effect, FrictionLaw):
            self._friction[key] = effect

    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take the numbers from those of the term."""
        for key, effect in (*self._normal.items(), *self._friction.items()):
            self._values[key] = {p.name: parameters[f"{key}.{p.name}"] for p in effect.parameters}

    @property
    def amended(self) -> bool:
        """Whether there is any law."""
        return bool(self._normal or self._friction)

    @property
    def formulas(self) -> list[Formula]:
        """The laws one by one."""

        def formula(kind: Literal["pressure", "bond", "friction"], key: str, law: Law, given: int) -> Formula:
            names, values = law.arguments[given:], self._values[key]
            return Formula(kind, law, tuple(f"{key}.{n}" for n in names), tuple(values[n] for n in names))

        pressures = [
            formula("bond" if effect.bonds else "pressure", key, effect.energy, 1)
            for key, effect in self._normal.items()
        ]
        return pressures + [formula("friction", key, effect.factor, 2) for key, effect in self._friction.items()]

    def reach(self) -> float:
        """Gap [m] from which on no added pressure acts."""
        return max((law.reach(self._values[key]) for key, law in self._normal.items()), default=0.0)

    @property
    def bonds(self) -> bool:
        """Whether any law acts only where surfaces have touched."""
        return any(law.bonds for law in self._normal.values())

    @property
    def bond_reach(self) -> float:
        """Gap [m] up to which bonds last."""
        return max((law.reach(self._values[key]) for key, law in self._normal.items() if law.bonds), default=0.0)
