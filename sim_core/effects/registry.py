"""Effects found by discovery: every module of this package, and what other packages offer.

Another package adds effects by an entry point of the group ``thinshell_ros.effects`` that names a module (or a class);
nothing here is a list to be kept. Modules are imported when the first effect is asked for, so that rigs and scenes can
import this registry without importing what effects are made of.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import entry_points
from math import isfinite
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from sim_core.effects.base import Effect, Instance, split_key
from sim_core.effects.hooks import MechanicsMap, RigMap
from sim_core.errors import ConfigError, nearest_match

if TYPE_CHECKING:
    from sim_core.rigs import Rig

GROUP = "thinshell_ros.effects"
"""Group of the entry points by which other packages add effects."""


@cache
def all_effects() -> Mapping[str, Effect]:
    """Every known effect by name, in the order of names. Raises ``ConfigError`` where two have one name, where a class
    lacks a value or a derivative that its interface asks for, or where its words are not complete."""
    found: dict[str, Effect] = {}
    for where, kind in sorted(_classes(), key=lambda pair: pair[1].name):
        if kind.name in found and type(found[kind.name]) is not kind:
            raise ConfigError(
                f"Two effects are called {kind.name!r}: one of {type(found[kind.name]).__module__}, one of {where}.",
                "Give one of them another name, or uninstall the package that adds it.",
            )
        found[kind.name] = checked(kind)
    return MappingProxyType(found)


def checked(kind: type[Effect]) -> Effect:
    """An instance of a class of effects. Raises ``ConfigError`` that names what the class lacks."""
    lacking = sorted(getattr(kind, "__abstractmethods__", ()))
    if lacking:
        raise ConfigError(
            f"The effect {kind.name} lacks {', '.join(lacking)}, which {_interface(kind)} asks for.",
            "Write every value and every derivative of the interface (sim_core/effects/hooks.py).",
        )
    for field in ("title", "words", "slot", "scope", "parameters"):
        if not getattr(kind, field, None):
            raise ConfigError(f"The effect {kind.name} has no {field}.", "Fill it in; see sim_core/effects/base.py.")
    if set(kind.example) != {p.name for p in kind.parameters}:
        raise ConfigError(
            f"The example of the effect {kind.name} does not give each of its parameters a value.",
            "Write one value for each parameter, at which the effect shows.",
        )
    if not any(p.vanishing is not None for p in kind.parameters):
        raise ConfigError(
            f"No parameter of the effect {kind.name} has a value at which the effect vanishes.",
            "Give one parameter a vanishing value, so that the baseline is contained in the amended model.",
        )
    return kind()


def _interface(kind: type[Effect]) -> str:
    return next((c.__name__ for c in kind.__mro__[1:] if c.__module__.endswith("effects.hooks")), "its interface")


def _classes() -> Iterator[tuple[str, type[Effect]]]:
    """All classes of effects and where they are from."""
    package = importlib.import_module("sim_core.effects")
    for module in pkgutil.iter_modules(package.__path__, "sim_core.effects."):
        yield from _of(importlib.import_module(module.name), module.name)
    for point in entry_points(group=GROUP):
        try:
            loaded = point.load()
        except Exception as error:  # whatever another package does must not stop this one
            raise ConfigError(
                f"The entry point {point.name!r} ({point.value}), which is to add effects, cannot be loaded: {error}.",
                "Mend or uninstall the package that declares it.",
            ) from error
        if inspect.isclass(loaded) and issubclass(loaded, Effect):
            yield point.value, loaded
        else:
            yield from _of(loaded, point.value)


def _of(module: Any, where: str) -> Iterator[tuple[str, type[Effect]]]:
    for _, kind in inspect.getmembers(module, inspect.isclass):
        if issubclass(kind, Effect) and kind.name and kind.__module__ == module.__name__:
            yield where, kind


def effect_by_name(name: str) -> Effect:
    """The effect of that name, or of a key that names it. Raises ``ConfigError`` with the nearest known name."""
    known = all_effects()
    stem = split_key(name)[0]
    if stem not in known:
        raise ConfigError(f"No effect is called {stem!r}.", nearest_match(stem, list(known)))
    return known[stem]


def active_effects(rig: Rig) -> list[Instance]:
    """The effects that a rig names, checked; amplitudes that it leaves out are at their vanishing values. Raises
    ``ConfigError`` where one is unknown, acts on nothing in the rig, lacks a parameter that has no such value, or has a
    value out of bounds."""
    found: list[Instance] = []
    for key, given in rig.effects.items():
        effect = effect_by_name(key)
        values = _complete(effect, key, given)
        found.append(Instance(key, effect, _scope(rig, effect, key), values))
    _check_numbers(found)
    _check_shares(found)
    return found


def active(rig: Rig, kind: Any) -> list[Instance]:
    """Those of them that implement one interface of :mod:`sim_core.effects.hooks`."""
    return [instance for instance in active_effects(rig) if isinstance(instance.effect, kind)]


def amended(rig: Rig) -> Rig:
    """The rig with the amendments of its numbers made, and without the effects that made them; the very same rig where
    there are none. Made a second time, nothing changes."""
    maps = active(rig, RigMap) if rig.effects else []
    if not maps:
        return rig
    for instance in maps:
        rig = instance.effect.amend_rig(rig, instance.targets, instance.values)
    done = {instance.key for instance in maps}
    return rig.model_copy(update={"effects": {k: v for k, v in rig.effects.items() if k not in done}})


def _scope(rig: Rig, effect: Effect, key: str) -> tuple[str, ...]:
    """What an effect acts on in a rig by its key."""
    _, target, _ = split_key(key)
    possible = effect.targets(rig)
    if not possible:
        raise ConfigError(
            f"The effect {key} acts on nothing in the rig {rig.name!r}: it needs {effect.scope.needs}.",
            "Remove it from the rig's effects, or add what it needs.",
        )
    if target is None:
        return possible
    if target not in possible:
        raise ConfigError(
            f"The effect {key} cannot act on {target!r} in the rig {rig.name!r}: it needs {effect.scope.needs}.",
            nearest_match(target, list(possible)),
        )
    return (target,)


def _check_shares(found: list[Instance]) -> None:
    """Refuse instances that together take all of something of which each takes a share."""
    totals: dict[tuple[str, str], float] = {}
    for instance in found:
        effect = instance.effect
        for target in instance.targets if effect.share_of_one else ():
            at = effect.name, target
            totals[at] = totals.get(at, 0.0) + instance.values[effect.share_of_one]
            if totals[at] >= 1.0:
                raise ConfigError(
                    f"The effects {effect.name} of {target} have together the {effect.share_of_one} {totals[at]:g}, "
                    "which is not below 1.",
                    "Lower their shares, or remove one of them.",
                )


def _check_numbers(found: list[Instance]) -> None:
    """Refuse two instances that would set the same numbers of one target, of which only the last would count."""
    taken: dict[tuple[str, str], str] = {}
    for instance in found:
        for target in instance.targets if isinstance(instance.effect, MechanicsMap) else ():
            other = taken.setdefault((instance.effect.name, target), instance.key)
            if other != instance.key:
                raise ConfigError(
                    f"The effects {other} and {instance.key} set the same numbers of {target}, of which there is one.",
                    "Remove one of them; several branches of one law are effects of the interface MaterialLaw.",
                )


def _complete(effect: Effect, key: str, given: Mapping[str, float]) -> dict[str, float]:
    """Values of all parameters of an effect, in their order."""
    known = {p.name: p for p in effect.parameters}
    for name, value in given.items():
        if name not in known:
            raise ConfigError(f"The effect {key} has no parameter {name!r}.", nearest_match(name, list(known)))
        p = known[name]
        if not p.lower <= value <= p.upper and value != p.vanishing:
            raise ConfigError(
                f"effects.{key}.{name} is {value:g} {p.unit}, outside of {p.lower:g} to {p.upper:g}.",
                "Choose a value within the bounds.",
            )
    absent = {name: p.vanishing for name, p in known.items() if p.vanishing is not None and isfinite(p.vanishing)}
    missing = [name for name in known if name not in given and name not in absent]
    if missing:
        raise ConfigError(
            f"The effect {key} needs the parameter {missing[0]!r}.",
            f"Add it to the rig's effects, or give it with --set effects.{key}.{missing[0]}=VALUE.",
        )
    return {name: given[name] if name in given else absent[name] for name in known}
