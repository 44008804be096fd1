"""Hypotheses of a diagnosis without a rig."""

from __future__ import annotations

from sim_core.effects import effect_by_name
from sysid.diagnosis.candidates import Amplitude, Hypothesis


def hypothesis(name: str) -> Hypothesis:
    """An effect with all its sizes at the first typical value."""
    effect = effect_by_name(name)
    sizes = [p for p in effect.parameters if p.vanishing is not None]
    return Hypothesis(name, effect, {}, tuple(Amplitude(p, p.vanishing or 0.0, p.typical[0]) for p in sizes))
