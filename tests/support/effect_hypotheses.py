"""Hypotheses of a diagnosis, and outcomes of their refits, without a rig."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

from sim_core.effects import effect_by_name
from sysid.diagnosis.candidates import Amplitude, Hypothesis
from sysid.diagnosis.refits import Trial
from sysid.diagnosis.residual_analysis import Part, Structure
from sysid.solve.optimum import Fitted


def hypothesis(name: str) -> Hypothesis:
    """An effect with all its sizes at the first typical value."""
    effect = effect_by_name(name)
    sizes = [p for p in effect.parameters if p.vanishing is not None]
    return Hypothesis(name, effect, {}, tuple(Amplitude(p, p.vanishing or 0.0, p.typical[0]) for p in sizes))


def structure(per_score: float, excess: float, own: float) -> Structure:
    """Structured misfit of one quantity beside the discretisation error ``own``."""
    return Structure((Part(excess, round(excess / (per_score - 1.0)), own),))


def trial(
    names: str,
    gain: float,
    explained: float = 0.95,
    held_out: float | None = 0.3,
    left: Structure | None = None,
    there: float | None = None,
) -> Trial:
    """A refit of one effect or of several, whose names are separated by blanks."""
    return Trial(
        tuple(hypothesis(name) for name in names.split()),
        cast(Fitted, SimpleNamespace(converged=True)),
        gain,
        explained,
        there,
        left or structure(1.1, 100, 1e3),
        held_out,
        9.0,
        None,
    )
