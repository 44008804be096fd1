"""Settings: numbers by which results are decided, each with its unit, its meaning and how it was chosen.

A room of the code has one frozen dataclass of settings, whose fields are made by :func:`setting`. They are no options:
they are the same for everybody, results record them, and ``thinshell settings`` lists them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import Any, Literal

Chosen = Literal["statistics", "measured", "convention", "cost", "judgement"]

CHOSEN: Mapping[str, str] = MappingProxyType(
    {
        "statistics": "follows from a distribution and a level of false alarms",
        "measured": "was measured on simulations or recordings, as its meaning says",
        "convention": "is customary in the field",
        "cost": "bounds time or memory",
        "judgement": "was set by hand with development recordings in sight, and has no derivation",
    }
)
"""How a setting was chosen, in words."""


@dataclass(frozen=True)
class Described:
    """One setting. ``unit``: "1" without; ``meaning``: a sentence; ``chosen``: a key of :data:`CHOSEN`."""

    name: str
    value: Any
    unit: str
    meaning: str
    chosen: Chosen


def setting(value: Any, unit: str, meaning: str, chosen: Chosen) -> Any:
    """A field of a dataclass of settings with its default. A mapping becomes read-only."""
    metadata = {"unit": unit, "meaning": meaning, "chosen": chosen}
    if isinstance(value, Mapping):
        return field(default_factory=lambda: MappingProxyType(dict(value)), metadata=metadata)
    return field(default=value, metadata=metadata)


def described(settings: Any) -> list[Described]:
    """All settings of a room, in the order of its dataclass."""
    return [Described(f.name, getattr(settings, f.name), **f.metadata) for f in fields(settings)]


def values(settings: Any) -> dict[str, Any]:
    """Settings of a room by name, as JSON has them."""
    return {d.name: dict(d.value) if isinstance(d.value, Mapping) else d.value for d in described(settings)}
