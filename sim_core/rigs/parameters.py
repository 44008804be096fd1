"""The numbers of a rig that can be changed or fitted, by name.

Names: ``gravity.x_m_s2``, ``<body>.<quantity>`` (``card.E_pa``), ``<load>.<number>`` (``pull.force_x_n``),
``contacts.<body>-<body>.<quantity>``, ``<end effector or camera>.offset_x_m``, ``<sensor or camera>.latency_s``,
``<camera>.<intrinsic>``, ``effects.<effect>.<parameter>``. The unit suffix may be left out (``card.E``), the two bodies
of a contact may be in any order, and where a rig has one body of a type the type may stand for it (``sheet.E``).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, get_args

import annotated_types

from sim_core.effects.registry import active_effects
from sim_core.errors import ConfigError
from sim_core.rigs.fields import Strict, split_unit, unit_of
from sim_core.rigs.loads import Load
from sim_core.rigs.pose_offset import OFFSETS
from sim_core.rigs.schema import Rig
from sim_core.rigs.yamlfile import validate

_INTRINSICS = ("fx_px", "fy_px", "cx_px", "cy_px", "scale_m_per_px")

OF_END_EFFECTORS = " of the end effector's own frame, as its poses tell it"
OF_CAMERAS = " of the camera's own frame, as 'pose' in the rig tells it"
"""Whose axes offsets are along and about."""

Path = tuple[str | int, ...]


@dataclass(frozen=True)
class Parameter:
    """One number of a rig.

    ``lower`` and ``upper`` are the bounds of the rig's schema (infinite where it has none); ``value``
    is in ``unit``, or None where the rig leaves the choice to the simulator.
    """

    name: str
    value: float | None
    unit: str
    lower: float
    upper: float
    description: str


def list_parameters(rig: Rig) -> tuple[Parameter, ...]:
    """All parameters of a rig, in the order of the rig file."""
    return tuple(parameter for _, parameter in _walk(rig))


def resolve_name(rig: Rig, name: str) -> str:
    """Full name of a parameter from the name that a user writes."""
    known = [parameter.name for parameter in list_parameters(rig)]
    if name.strip() in known:
        return name.strip()
    spellings: dict[str, set[str]] = {}
    for full in known:
        for spelling in _spellings(rig, full):
            spellings.setdefault(spelling, set()).add(full)
    matches = spellings.get(name.strip(), set())
    if len(matches) == 1:
        return next(iter(matches))
    if matches:
        raise ConfigError(
            f"The parameter {name!r} is not unique in the rig {rig.name!r}.",
            f"Write one of: {', '.join(sorted(matches))}.",
        )
    raise ConfigError(f"The rig {rig.name!r} has no parameter {name!r}.", nearest_names(name, spellings))


def nearest_names(name: str, spellings: Mapping[str, Collection[str]]) -> str:
    """Remedy for the name of a quantity that is not known: the nearest one, sought by owner first and then by quantity.

    ``spellings``: the full names that each spelling ``owner.quantity`` may stand for.
    """
    owner, _, quantity = name.strip().lower().rpartition(".")
    owned: dict[str, dict[str, set[str]]] = {}
    for spelling, full in spellings.items():
        holder, _, key = spelling.lower().rpartition(".")
        owned.setdefault(holder, {}).setdefault(key, set()).update(full)
    if not owner and quantity in owned:
        return _choice(set().union(*owned[quantity].values()))
    holders = ([owner] if owner in owned else get_close_matches(owner, owned, n=1)) or list(owned)
    near: set[str] = set().union(*(owned[h][key] for h in holders for key in _near(quantity, owned[h])))
    if near:
        return f"Did you mean {min(near)!r}?" if len(near) == 1 else _choice(near)
    return _choice(set().union(*(full for h in holders for full in owned[h].values())))


def _near(word: str, known: Collection[str]) -> list[str]:
    """The known word that is nearest, if one is near; of a single letter, another one."""
    return get_close_matches(word, known, n=1) or [k for k in known if len(k) == len(word) == 1]


def _choice(names: Collection[str]) -> str:
    return f"Write one of: {', '.join(sorted(names))}."


def with_parameters(rig: Rig, values: Mapping[str, float]) -> Rig:
    """A new rig with some values changed; names and bounds are checked. ``effects.KEY.PARAMETER`` adds the effect where
    the rig does not name it."""
    if not values:
        return rig
    rig = _with_effects(rig, values)
    places = {parameter.name: path for path, parameter in _walk(rig)}
    data: dict[str, Any] = rig.model_dump()
    given: dict[str, str] = {}
    for name, value in values.items():
        full = name if name in places else resolve_name(rig, name)
        if full in given:
            raise ConfigError(
                f"The parameter {full} is given twice, as {given[full]!r} and {name!r}.",
                "Keep one of the two.",
            )
        given[full] = name
        target: Any = data
        *parents, last = places[full]
        for step in parents:
            if isinstance(target[step], tuple):
                target[step] = list(target[step])
            target = target[step]
        target[last] = float(value)
    return validate(Rig, data, f"rig {rig.name!r} with {', '.join(given)} changed")


def _with_effects(rig: Rig, values: Mapping[str, float]) -> Rig:
    """The rig with the effects that ``values`` set and that it does not name."""
    added: dict[str, dict[str, float]] = {}
    for name, value in values.items():
        prefix, _, rest = name.strip().partition(".")
        key, _, parameter = rest.rpartition(".")
        if prefix == "effects" and key and key not in rig.effects:
            added.setdefault(key, {})[parameter] = float(value)
    return rig.model_copy(update={"effects": {**rig.effects, **added}}) if added else rig


@functools.cache
def bounds_of(model: type[Strict], key: str) -> tuple[float, float]:
    """Bounds that a model's schema sets on a number."""
    lower, upper = -math.inf, math.inf
    field = model.model_fields[key]
    metadata = [
        *field.metadata,
        *(item for kind in get_args(field.annotation) for item in get_args(kind)[1:]),
    ]
    for item in _constraints(metadata):
        if isinstance(item, annotated_types.Gt):
            lower = float(item.gt)  # type: ignore[arg-type]
        elif isinstance(item, annotated_types.Ge):
            lower = float(item.ge)  # type: ignore[arg-type]
        elif isinstance(item, annotated_types.Lt):
            upper = float(item.lt)  # type: ignore[arg-type]
        elif isinstance(item, annotated_types.Le):
            upper = float(item.le)  # type: ignore[arg-type]
    return lower, upper


def _constraints(metadata: list[Any]) -> Iterator[Any]:
    for item in metadata:
        if hasattr(item, "metadata"):
            yield from _constraints(item.metadata)
        else:
            yield item


def _walk(rig: Rig) -> Iterator[tuple[Path, Parameter]]:
    for index, axis in enumerate("xyz"):
        name = f"gravity.{axis}_m_s2"
        found = Parameter(name, rig.gravity_m_s2[index], "m/s^2", -math.inf, math.inf, f"weight per mass along {axis}")
        yield ("gravity_m_s2", index), found
    for name, body in rig.bodies.items():
        if body.type != "rigid":
            fixed = ("nu",) if body.type == "sheet" and body.law == "neo_hookean" else ()
            for key in (k for k in body.material.quantities if k not in fixed):
                yield ("bodies", name, "material", key), _parameter(f"{name}.{key}", body.material, key)
    for index, load in enumerate(rig.loads):
        yield from _of_load(("loads", index, load.number), load)
    for index, contact in enumerate(rig.contacts):
        for key in ("friction", "stiffness_pa_per_m"):
            yield ("contacts", index, key), _parameter(f"contacts.{contact.name}.{key}", contact, key)
    for name, effector in rig.end_effectors.items():
        for key in OFFSETS:
            yield ("end_effectors", name, key), _parameter(f"{name}.{key}", effector, key, OF_END_EFFECTORS)
    for name, sensor in rig.sensors.items():
        yield ("sensors", name, "latency_s"), _parameter(f"{name}.latency_s", sensor, "latency_s")
    for name, camera in rig.cameras.items():
        for key in ("latency_s", *_INTRINSICS, *OFFSETS):
            if key in type(camera).model_fields:
                frame = OF_CAMERAS if key in OFFSETS else ""
                yield ("cameras", name, key), _parameter(f"{name}.{key}", camera, key, frame)
    for instance in active_effects(rig):
        for p in instance.effect.parameters:
            label, value = f"effects.{instance.key}.{p.name}", instance.values[p.name]
            yield ("effects", instance.key, p.name), Parameter(label, value, p.unit, p.lower, p.upper, p.words)


def _of_load(path: Path, load: Load) -> Iterator[tuple[Path, Parameter]]:
    """The number of a load, or each component of it: ``pull.force_x_n``."""
    value, (stem, unit) = getattr(load, load.number), split_unit(load.number)
    if not isinstance(value, tuple):
        yield path, _parameter(f"{load.name}.{load.number}", load, load.number)
        return
    lower, upper = bounds_of(type(load), load.number)
    for axis, component in enumerate(value):
        name, meaning = f"{load.name}.{stem}_{'xyz'[axis]}_{unit}", type(load).model_fields[load.number].description
        yield (*path, axis), Parameter(name, component, unit_of(load.number), lower, upper, meaning or "")


def _parameter(name: str, owner: Strict, key: str, frame: str = "") -> Parameter:
    lower, upper = bounds_of(type(owner), key)
    meaning = type(owner).model_fields[key].description or ""
    return Parameter(name, getattr(owner, key), unit_of(key), lower, upper, meaning + frame)


def _spellings(rig: Rig, full: str) -> Iterator[str]:
    owner, key = full.rsplit(".", 1)
    owners = [owner]
    if owner.startswith("contacts."):
        first, second = owner.removeprefix("contacts.").split("-")
        pairs = (f"{first}-{second}", f"{second}-{first}")
        owners = [prefix + pair for pair in pairs for prefix in ("contacts.", "contact.", "")]
    elif owner in rig.bodies:
        kind = rig.bodies[owner].type
        if kind not in rig.bodies and sum(body.type == kind for body in rig.bodies.values()) == 1:
            owners.append(kind)
    for spelling in owners:
        yield f"{spelling}.{key}"
        yield f"{spelling}.{split_unit(key)[0]}"
