"""What effects of finite size would change in the readings of a run, one column an effect, without fitting anything.

How an effect is looked at follows from the interfaces that it acts through: sensors on the readings that are there,
exactly, clocks on these to first order; laws along the frozen path of the rollout
(:mod:`sim_core.gradients.frozen_path`); numbers and commands by what they change in the rig and in poses, to first
order in what that does; what would need another mesh by a rollout of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sim_core.effects.base import split_key
from sim_core.effects.hooks import (
    BodyForce,
    ClockMap,
    CommandMap,
    FieldMap,
    FrictionLaw,
    MaterialLaw,
    MechanicsMap,
    NormalLaw,
    ReadingMap,
    RigMap,
)
from sim_core.effects.registry import effect_by_name
from sim_core.rigs import Rig


@dataclass(frozen=True, eq=False)
class Modulated:
    """A parameter of the rig that changes in time: by the ``values`` ``(n,)`` at the ``times`` [s] ``(n,)``, linearly
    between them, and as at the first and the last one before and after. ``others``: parameters that change along with
    it, in the same column."""

    parameter: str
    times: np.ndarray
    values: np.ndarray
    others: tuple[Modulated, ...] = ()

    def course(self, t: np.ndarray) -> np.ndarray:
        """How much of the change there is at times [s], ``(n,)`` or one."""
        return np.asarray(np.interp(t, self.times, self.values))

    @property
    def parts(self) -> tuple[Modulated, ...]:
        """It and the others."""
        return (self, *self.others)


Way = Literal["clock", "reading", "law", "numbers", "rollout"]

SizedEffects = Mapping[str, Mapping[str, float]]
"""Effects of a rig with their parameters, by key."""


def with_effects(rig: Rig, effects: SizedEffects) -> Rig:
    """The rig with these effects in addition to its own."""
    return rig.model_copy(update={"effects": {**rig.effects, **{k: dict(v) for k, v in effects.items()}}})


def way_of(rig: Rig, effects: SizedEffects, geometry: Callable[[Rig], object]) -> Way:
    """How the response to some effects is found. ``geometry``: what a scene is built from, to be compared."""
    kinds = [type(effect_by_name(split_key(key)[0])) for key in effects]

    def all_are(*wanted: type) -> bool:
        return all(issubclass(kind, wanted) for kind in kinds)

    if all_are(ClockMap):
        return "clock"
    if all_are(ReadingMap, ClockMap):
        return "reading"
    if all_are(BodyForce, FieldMap, FrictionLaw, MaterialLaw, MechanicsMap, NormalLaw):
        return "law"
    if all_are(RigMap, CommandMap):
        bare = with_effects(rig, effects)
        kept = {k: v for k, v in bare.effects.items() if k not in effects or _changes_rig(k)}
        if geometry(bare.model_copy(update={"effects": kept})) == geometry(rig):
            return "numbers"
    return "rollout"


def _changes_rig(key: str) -> bool:
    return isinstance(effect_by_name(split_key(key)[0]), RigMap)


def change(now: Mapping[str, np.ndarray], before: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Change of readings by channel ``(n, m)``; 0 where a point is out of sight in either."""
    return {c: np.nan_to_num(now[c] - v) for c, v in before.items()}
