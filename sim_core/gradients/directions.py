"""Along what rollouts are differentiated: parameters of a rig as directions in the numbers that the mechanics take.

The mechanics depend on :class:`sim_core.scene.scene.Values`: numbers of terms, densities, gravity, compliances. A
parameter of the rig changes some of them, mostly one or two terms' worth. Derivatives of a step are taken by these
numbers and combined with their slopes along the parameter, which are the same all through a rollout. So are the small
motions of the mounts in their own frames that offsets of end effectors amount to.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim_core.commands import Frames, driven_frames, motion_between
from sim_core.effects.hooks import CommandMap
from sim_core.effects.registry import active, amended
from sim_core.errors import ConfigError
from sim_core.rigs import Rig, list_parameters, resolve_name, with_parameters
from sim_core.scene.offset import offset_motion, with_offsets
from sim_core.scene.scene import Scene, Values

RELATIVE_STEP = 1e-5
"""Half width of the difference that gives a slope, as a share of the value."""

FROM_ZERO = 1e-6
"""Step of a value that is zero: a friction, an angle, a delay [s], an offset."""

Key = tuple[str, str, str]
"""One number of the mechanics: (``terms``, term, quantity), (``density``, body, ''), (``gravity``, '', axis) or
(``compliance``, end effector, axis)."""


@dataclass(frozen=True)
class Direction:
    """A parameter: rigs with a little less and a little more of it, ``width`` apart in its unit (or in the scale in
    which derivatives are wanted), with the amendments of their numbers made. One of the two may be the rig itself, at a
    bound."""

    name: str
    low: Rig
    high: Rig
    width: float

    def __post_init__(self) -> None:
        for end in ("low", "high"):
            object.__setattr__(self, end, amended(getattr(self, end)))


def directions(rig: Rig, names: Sequence[str]) -> list[Direction]:
    """Directions of parameters by the names that a user writes, in the parameters' own units."""
    known = {p.name: p for p in list_parameters(rig)}
    found = []
    for name in names:
        parameter = known[resolve_name(rig, name)]
        value = 0.0 if parameter.value is None else parameter.value
        step = RELATIVE_STEP * abs(value) or FROM_ZERO
        low = value - step if value - step > parameter.lower else value
        high = value + step if value + step < parameter.upper else value
        rigs = [with_parameters(rig, {parameter.name: v}) for v in (low, high)]
        found.append(Direction(parameter.name, rigs[0], rigs[1], high - low))
    return found


def checked(along: Sequence[Direction]) -> list[Direction]:
    """The same. Raises ``ConfigError`` where one is something else, a name for one."""
    for given in along:
        if not isinstance(given, Direction):
            raise ConfigError(
                f"{given!r} is not a direction to differentiate along.",
                "Make directions of parameters from their names: directions(rig, names).",
            )
    return list(along)


def numbers(values: Values) -> dict[Key, float]:
    """All numbers of the mechanics by key."""
    out: dict[Key, float] = {}
    for term, given in values.terms.items():
        out.update({("terms", term, quantity): value for quantity, value in given.items()})
    out.update({("density", body, ""): value for body, value in values.density.items()})
    out.update({("gravity", "", a): float(g) for a, g in zip("xyz", values.gravity, strict=True)})
    for mount, given_way in values.compliance.items():
        out.update({("compliance", mount, a): float(c) for a, c in zip("xyz", given_way, strict=True)})
    return out


def slopes(scene: Scene, along: Sequence[Direction]) -> tuple[list[Key], np.ndarray]:
    """Numbers that the parameters change, and their derivatives by them, ``(n_keys, n_parameters)``."""
    pairs = [(numbers(scene.values(d.low)), numbers(scene.values(d.high))) for d in along]
    keys = list(dict.fromkeys(k for low, high in pairs for k in high if low.get(k) != high[k]))
    table = np.zeros((len(keys), len(along)))
    for column, (direction, (low, high)) in enumerate(zip(along, pairs, strict=True)):
        for row, key in enumerate(keys):
            table[row, column] = (high[key] - low[key]) / direction.width
    return keys, table


def motions(rig: Rig, along: Sequence[Direction]) -> dict[str, np.ndarray]:
    """Motion of each end effector in its own true frame, translation [m] and turn [rad], by the parameters that shift
    or turn it against its poses, ``(6, n_parameters)``; others are left out."""
    found = {}
    for name, effector in rig.end_effectors.items():
        ends = [(d.high.end_effectors[name].offset(), d.low.end_effectors[name].offset(), d.width) for d in along]
        slopes = np.array([(high - low) / width for high, low, width in ends]).reshape(-1, 6).T
        if slopes.any():
            found[name] = offset_motion(effector) @ slopes
    return found


def command_motions(
    rig: Rig, along: Sequence[Direction], commanded: Sequence[Frames], times: np.ndarray
) -> list[dict[str, np.ndarray]]:
    """Motion of each end effector in its own true frame at all ``times`` by the parameters that change what becomes of
    its ``commanded`` frames, ``(6, n_parameters)``; others are left out. Empty where no parameter does."""
    plain = [rig.model_copy(update={"effects": d.low.effects}) for d in along]
    changed = [rig.model_copy(update={"effects": d.high.effects}) for d in along]
    acting = [k for k, d in enumerate(along) if d.low.effects != d.high.effects and _commands(d)]
    if not acting:
        return []
    out: list[dict[str, np.ndarray]] = [{} for _ in times]
    for k in acting:
        ends = [driven_frames(r, commanded, times) for r in (plain[k], changed[k])]
        for at, (low, high) in enumerate(zip(*ends, strict=True)):
            true = [with_offsets(rig, frames) for frames in (low, high)]
            for name in low:
                motion = motion_between(true[0][name], true[1][name]) / along[k].width
                if motion.any():
                    out[at].setdefault(name, np.zeros((6, len(along))))[:, k] = motion
    return out


def _commands(direction: Direction) -> bool:
    """Whether the rigs of a direction differ in effects on commands."""
    ends = [[(m.key, dict(m.values)) for m in active(r, CommandMap)] for r in (direction.low, direction.high)]
    return ends[0] != ends[1]


def together(one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Sums of motions by mount, where one or both have some."""
    return {name: np.asarray(one.get(name, 0.0) + other.get(name, 0.0)) for name in (*one, *other)}
