"""Laws that effects add to one contact term (:class:`sim_core.effects.hooks.NormalLaw`, ``FrictionLaw``).

With the pressure p_0 of :mod:`sim_core.contact.pressure_and_friction` and the pressures p_i and factors f_i of the
effects,

    p = p_0 + sum_i p_i,    friction bound = mu lambda_n prod_i f_i(lambda_n / A, slip speed),    lambda_n = A p_0

p_i of a law that bonds counts where the surfaces have touched (:attr:`AddedLaws.bonded`). Each is evaluated in numpy at
the gaps and loads that the kernels have measured, and handed to them as numbers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sim_core.contact.pressure_and_friction import MU
from sim_core.effects.hooks import FrictionFactor, FrictionLaw, NormalLaw, Sliding

if TYPE_CHECKING:
    from sim_core.effects.base import Effect


@dataclass(frozen=True)
class Bound:
    """Friction bound [N] of n points and its derivatives by load, by slip speed [N s/m], by area [N/m^2], and by each
    number."""

    value: np.ndarray
    by_load: np.ndarray
    by_speed: np.ndarray
    by_area: np.ndarray
    by_number: Mapping[str, np.ndarray]


class AddedLaws:
    """The laws of one term, with their numbers. ``bears``: whether the term's points bear the contact; others carry no
    pressure that effects add."""

    def __init__(self, bears: bool = True) -> None:
        self._bears = bears
        self._normal: dict[str, NormalLaw] = {}
        self._friction: dict[str, FrictionLaw] = {}
        self._values: dict[str, dict[str, float]] = {}
        self.bonded: np.ndarray | None = None
        """Which points have touched and were not torn off since, 0 or 1 ``(n,)``; None where nothing is remembered."""

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
    def presses(self) -> bool:
        """Whether any law adds pressure."""
        return bool(self._normal)

    def reach(self) -> float:
        """Gap [m] from which on no added pressure acts."""
        return max((law.reach(self._values[key]) for key, law in self._normal.items()), default=0.0)

    @property
    def bonds(self) -> bool:
        """Whether any law acts only where surfaces have touched."""
        return any(law.bonds for law in self._normal.values())

    def bonded_after(self, gap: np.ndarray, touching: np.ndarray) -> np.ndarray:
        """Which points are bonded when a step has ended at gaps [m] ``(n,)``, and which of them touch."""
        held = np.zeros_like(gap) if self.bonded is None else self.bonded
        reach = max((law.reach(self._values[key]) for key, law in self._normal.items() if law.bonds), default=0.0)
        return np.where(touching, 1.0, np.where(gap < reach, held, 0.0))

    def _share(self, law: NormalLaw, some: np.ndarray | slice) -> np.ndarray | float:
        """How much of a law counts at some points."""
        return self.bonded[some] if law.bonds and self.bonded is not None else 1.0

    def write_normal(self, gap: np.ndarray, out: np.ndarray, some: np.ndarray | slice = slice(None)) -> None:
        """Write added energy [J/m^2], pressure [Pa] and slope [Pa/m] at gaps [m] ``(n,)`` into ``out`` ``(n, 3)``;
        ``some``: numbers of these points among those of the term."""
        out[:] = 0.0
        for key, law in self._normal.items():
            found, share = law.normal(gap, self._values[key]), self._share(law, some)
            out[:, 0] += share * found.energy
            out[:, 1] += share * found.pressure
            out[:, 2] += share * found.slope

    def normal_by(self, gap: np.ndarray, some: np.ndarray | slice = slice(None)) -> dict[str, np.ndarray]:
        """Derivatives of the added pressure by the numbers of its laws ``(n,)``; ``some``: as above."""
        return {
            f"{key}.{name}": np.asarray(self._share(law, some) * by)
            for key, law in self._normal.items()
            for name, by in law.normal_by(gap, self._values[key]).items()
        }

    def bound(self, c: np.ndarray, load: np.ndarray, area: np.ndarray, speed: np.ndarray) -> Bound:
        """Friction bound of points that carried ``load`` [N] on ``area`` [m^2] and slid at ``speed`` [m/s]."""
        whole = np.ones_like(load)
        if not self._friction:
            value = c[MU] * load
            none = np.zeros_like(load)
            return Bound(value, c[MU] * whole, none, none, {"friction": load})
        pressure = load / np.where(area > 0.0, area, 1.0)
        at = Sliding(pressure, speed)
        factors = {key: law.friction(at, self._values[key]) for key, law in self._friction.items()}
        for factor in factors.values():
            whole = whole * factor.value
        by_pressure, by_speed = (
            sum((self._rest(factors, key) * getattr(f, by) for key, f in factors.items()), np.zeros_like(load))
            for by in ("by_pressure", "by_speed")
        )
        numbers = {
            f"{key}.{name}": c[MU] * load * self._rest(factors, key) * by
            for key, factor in factors.items()
            for name, by in factor.by_parameter.items()
        }
        numbers["friction"] = load * whole
        return Bound(
            c[MU] * load * whole,
            c[MU] * (whole + pressure * by_pressure),
            c[MU] * load * by_speed,
            -c[MU] * pressure**2 * by_pressure,
            numbers,
        )

    @staticmethod
    def _rest(factors: Mapping[str, FrictionFactor], but: str) -> np.ndarray | float:
        """Product of all factors but one."""
        out: np.ndarray | float = 1.0
        for key, factor in factors.items():
            if key != but:
                out = out * factor.value
        return out
