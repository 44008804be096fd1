"""What the posterior says: the verdict, in sets of causes with probabilities.

The most probable set of causes is the answer (:mod:`sysid.comparison.posterior`); where it is less than sure, all sets
as large that belong to the 95 % are. No other limit has a part in it. What the error of mesh and time step may be is
asked again with twice its width: where that makes nothing missing the more probable, finer cells are the answer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from sim_core.effects import effect_by_name
from sysid.comparison.explanations import UNKNOWN
from sysid.comparison.ledger import Ledger
from sysid.comparison.posterior import Posterior, posterior
from sysid.discretisation.refinement import MESH, TIME_STEP
from sysid.settings.diagnosis import DIAGNOSIS

WHERE = {
    "gel": "in the gel",
    "sheet": "in the sheet",
    "contact": "at a contact",
    "robot": "in the motion of the hand",
    "environment": "in what acts on the bodies from outside",
    "wrench": "in a wrench sensor",
    "camera": "in a camera",
    "markers": "in the markers",
    "clock": "in a clock",
}
"""Places of the model in words."""


@dataclass(frozen=True)
class ProbableSet:
    """Causes that are missing together. ``causes``: names of effects, and 'unknown: ' with a place; ``words``."""

    causes: tuple[str, ...]
    words: str
    probability: float

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the library among them."""
        return tuple(c for c in self.causes if not c.startswith(UNKNOWN))

    @property
    def unknown(self) -> tuple[str, ...]:
        """Places with unknown physics among them."""
        return tuple(c.removeprefix(UNKNOWN) for c in self.causes if c.startswith(UNKNOWN))


@dataclass(frozen=True)
class Verdict:
    """``kind``: as in :data:`sysid.diagnosis.result.VERDICTS`; ``sets``: of the answer, most probable first;
    ``nothing``, ``unknown``: probabilities that nothing is missing, and that something is that no effect of the library
    describes; ``effects``, ``places``: probability by effect, and of each place of the model that something is missing
    there, largest first."""

    kind: str
    sets: tuple[ProbableSet, ...]
    nothing: float
    unknown: float
    effects: dict[str, float]
    places: dict[str, float]

    @property
    def answer(self) -> tuple[str, ...]:
        """Effects that are said to be missing, or to be one of those that are."""
        chosen = self.sets if self.kind == "one_of" else self.sets[:1]
        return tuple(dict.fromkeys(e for s in chosen for e in s.effects))


def verdict_of(found: Posterior) -> Verdict:
    """What a posterior says."""
    best, sure = found.models[0], DIAGNOSIS.sure_probability
    sets = tuple(
        ProbableSet(m.effects, words_of(m.effects), m.probability) for m in found.credible()[: DIAGNOSIS.sets_shown]
    )
    first = sets[0]
    kind = "nothing_missing" if not first.causes else "named" if not first.unknown else "unknown"
    if kind == "unknown" and first.effects:
        kind = "partly"
    if kind == "named" and best.probability < sure:
        sets = tuple(s for s in sets if len(s.causes) == len(first.causes) and not s.unknown)
        kind = "one_of" if len(sets) > 1 else kind
    else:
        sets = sets[:1]
    known = {e: p for e, p in found.inclusion.items() if not e.startswith(UNKNOWN)}
    return Verdict(kind, sets, found.nothing, found.unknown, known, found.in_place)


def hidden_by_mesh(ledger: Ledger) -> bool:
    """Whether nothing is missing more probably than not where the error of mesh and time step may be off by twice as
    much as is thought."""
    return posterior(_wider(ledger), bags=0).nothing > 0.5


def _wider(ledger: Ledger) -> Ledger:
    columns = tuple(
        replace(c, prior_sd=2.0 * c.prior_sd) if c.kind == "approximation" and c.owner in (MESH, TIME_STEP) else c
        for c in ledger.columns
    )
    return replace(ledger, columns=columns, amended=tuple(_wider(one) for one in ledger.amended))


def words_of(causes: Sequence[str]) -> str:
    """Causes in words, as clauses."""
    parts = []
    for cause in causes:
        if cause.startswith(UNKNOWN):
            place = cause.removeprefix(UNKNOWN)
            parts.append(f"something that no known effect describes is missing {WHERE.get(place, place)}")
        else:
            parts.append(effect_by_name(cause).title)
    return " and ".join(parts) or "nothing is missing"


def in_percent(probability: float) -> str:
    """A probability in words."""
    if probability < 0.01:
        return "less than 1 %"
    return "more than 99 %" if probability > 0.99 else f"{100.0 * probability:.0f} %"
