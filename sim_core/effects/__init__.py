"""Physics that a baseline model leaves out, one effect a file, found by name."""

from __future__ import annotations

from collections.abc import Mapping

from sim_core.effects.air_drag import AirDrag
from sim_core.effects.bending_plasticity import BendingPlasticity
from sim_core.effects.effect import Effect, EffectParameter
from sim_core.effects.end_effector_compliance import EndEffectorCompliance
from sim_core.effects.gel_relaxation import GelRelaxation
from sim_core.effects.sheet_orthotropy import SheetOrthotropy
from sim_core.effects.static_friction import StaticFriction
from sim_core.effects.stream_delay import StreamDelay
from sim_core.effects.wrench_offset import WrenchOffset
from sim_core.errors import ConfigError, nearest_match
from sim_core.rigs import Rig

EFFECTS: tuple[Effect, ...] = (
    GelRelaxation(),
    SheetOrthotropy(),
    BendingPlasticity(),
    AirDrag(),
    StaticFriction(),
    EndEffectorCompliance(),
    WrenchOffset(),
    StreamDelay(),
)

__all__ = ["EFFECTS", "Effect", "EffectParameter", "active_effects", "effect_by_name"]


def effect_by_name(name: str) -> Effect:
    """The registered effect of that name."""
    for effect in EFFECTS:
        if effect.name == name:
            return effect
    raise ConfigError(f"No effect is called {name!r}.", nearest_match(name, [e.name for e in EFFECTS]))


def active_effects(rig: Rig) -> list[tuple[Effect, Mapping[str, float]]]:
    """Effects that a rig names, with their parameters checked."""
    found: list[tuple[Effect, Mapping[str, float]]] = []
    for name, given in rig.effects.items():
        effect = effect_by_name(name)
        known = {p.name: p for p in effect.parameters}
        for key, value in given.items():
            if key not in known:
                raise ConfigError(f"The effect {name} has no parameter {key!r}.", nearest_match(key, known))
            p = known[key]
            if not p.lower <= value <= p.upper and value != p.vanishing:
                raise ConfigError(
                    f"effects.{name}.{key} is {value:g} {p.unit}, outside of {p.lower:g} to {p.upper:g}.",
                    "Choose a value within the bounds.",
                )
        missing = set(known) - set(given)
        if missing:
            raise ConfigError(
                f"The effect {name} needs the parameter {sorted(missing)[0]!r}.",
                "Add it to the rig's effects.",
            )
        found.append((effect, given))
    return found
