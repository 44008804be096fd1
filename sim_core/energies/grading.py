"""Factors on the stiffness of a term's elements that effects make, by where the elements are and by the time.

    E_element = f E_uniform,    f = prod_i f_i(X; t)

with the middles X of the elements where the rig has them, in the frame of the body: they stay with the material,
whatever shape the body is given at rest. The time t is that at the start of a step; nothing else in a step depends on
it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from sim_core.effects.hooks import FieldMap

if TYPE_CHECKING:
    from sim_core.effects.base import Effect


class Grading:
    """The field maps of one term, with their numbers. ``places``: middles of its elements [m] ``(m, 3)``."""

    def __init__(self, places: np.ndarray) -> None:
        self._places = places
        self._maps: dict[str, FieldMap] = {}
        self._values: dict[str, dict[str, float]] = {}
        self._time = 0.0
        self.factor = np.ones(len(places))
        """Of the elements ``(m,)``; another array whenever it changes."""

    def add(self, key: str, effect: Effect) -> None:
        """Take a map whose numbers are called ``<key>.<parameter>``."""
        if isinstance(effect, FieldMap):
            self._maps[key] = effect

    @property
    def numbers(self) -> dict[str, str]:
        """Units of its numbers by their names."""
        return {f"{key}.{p.name}": p.unit for key, effect in self._maps.items() for p in effect.parameters}

    @property
    def maps(self) -> list[tuple[str, FieldMap, dict[str, float]]]:
        """Keys, effects and the values of their parameters."""
        return [(key, effect, self._values[key]) for key, effect in self._maps.items()]

    @property
    def places(self) -> np.ndarray:
        """Middles of the elements [m] ``(m, 3)``."""
        return self._places

    @property
    def changes(self) -> bool:
        """Whether the factors change in time."""
        return any(effect.changes for effect in self._maps.values())

    def configure(self, parameters: Mapping[str, float]) -> None:
        """Take its numbers from those of the term."""
        self._values = {
            key: {p.name: parameters[f"{key}.{p.name}"] for p in effect.parameters}
            for key, effect in self._maps.items()
        }
        self._measure()

    def go_to(self, time: float) -> bool:
        """Let it be some time [s] since the start, below zero while bodies settle before it; True where factors
        changed."""
        time = max(time, 0.0)
        if time == self._time or not self.changes:
            return False
        self._time = time
        self._measure()
        return True

    def _measure(self) -> None:
        self.factor = np.ones(len(self._places))
        for key, effect in self._maps.items():
            self.factor = self.factor * effect.factor(self._places, self._time, self._values[key]).v

    def by(self, number: str) -> np.ndarray:
        """Derivative of the logarithm of the factors by one of its numbers ``(m,)``."""
        key, _, parameter = number.rpartition(".")
        effect, values = self._maps[key], self._values[key]
        slope = effect.factor_by(self._places, self._time, values)[parameter]
        return np.asarray(slope / effect.factor(self._places, self._time, values).v)
