"""Physics that a baseline model leaves out, one effect a file, found by discovery."""

from sim_core.effects.base import Effect, EffectParameter, Instance, Nuisance, RecordingScales, joined_key, split_key
from sim_core.effects.registry import active, active_effects, all_effects, amended, effect_by_name

__all__ = [
    "Effect",
    "EffectParameter",
    "Instance",
    "Nuisance",
    "RecordingScales",
    "active",
    "active_effects",
    "all_effects",
    "amended",
    "effect_by_name",
    "joined_key",
    "split_key",
]
