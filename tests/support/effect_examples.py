"""One value of every effect that shows on the small rig."""

from __future__ import annotations

from sim_core.effects import all_effects

TYPICAL: dict[str, dict[str, float]] = {name: dict(effect.example) for name, effect in all_effects().items()}
